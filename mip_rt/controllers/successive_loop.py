"""Successive loop closure of the eduMIP: an inner loop from lean to command, an outer one from wheel angle to lean reference.

    u_x = D1 (1 + k yaw'^2) (lean_ref - lean),   lean_ref = D2 (wheel_ref - wheel)

D1 and D2 are second-order filters that their authors give as coefficients for one sample rate: the dissertation's (3.50), (3.51) for 200 Hz, the same
digits in the public eduMIP program for 100 Hz with gains of 1.05 and 0.9. Here they are data with the rate they were made for, and are carried over to
the rate in use through their bilinear (Tustin) continuous equivalent. D2 needs its five digits (with three its zeros turn complex and the robot falls), and
the sign of the outer loop is plus: a robot that is behind must lean forward (as printed it falls). A body that turns falls faster, because of the
centrifugal force on the leaning body; with k = 0, as in the papers, it falls from 15 to 20 rad/s on. With k the share of that force in the
lean's stiffness (d lean'' / d lean = (1 + k yaw'^2) times that at rest) the loop is as stable at any rate as at rest. Behind a limit a filter remembers the input that
would just have led to the limit (Hanus), so that nothing winds up there.

Source: dissertation (3.50) to (3.52), corrected as in section I.1 of the equations.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.controllers.filters import limit

FILTER = np.dtype([("b", "f8", (3,)), ("a", "f8", (3,)), ("limit", "f8")], align=True)
MEMORY = np.dtype([("x", "f8", (2,)), ("y", "f8", (2,))], align=True)
PARAMETERS = np.dtype([("inner", FILTER), ("outer", FILTER), ("spin_s2_rad2", "f8")], align=True)
STATE = np.dtype([("inner", MEMORY), ("outer", MEMORY)], align=True)


def resample(numerator, denominator, made_hz: float, used_hz: float):
    """(numerator, denominator) at `used_hz` of a filter given in powers of z (highest first) for `made_hz`, by the bilinear map both ways.

    z_made = (1 + k q) / (1 - k q) with q = (z - 1) / (z + 1) and k = used_hz / made_hz.
    """
    k = used_hz / made_hz
    up, down = np.array([1.0 + k, 1.0 - k]), np.array([1.0 - k, 1.0 + k])  # in powers of z

    def through(coefficients):
        order = len(coefficients) - 1
        total = np.zeros(order + 1)
        for power, coefficient in enumerate(reversed(coefficients)):
            term = np.array([1.0])
            for _ in range(power):
                term = np.convolve(term, up)
            for _ in range(order - power):
                term = np.convolve(term, down)
            total += coefficient * term
        return total

    b, a = through(list(numerator)), through(list(denominator))
    return b / a[0], a / a[0]


def configure_filter(p, numerator, denominator, gain: float, largest: float, made_hz: float, used_hz: float) -> None:
    """Fills a record of FILTER, once."""
    b, a = resample(numerator, denominator, made_hz, used_hz)
    p.b[:], p.a[:], p.limit = gain * b, a, largest


@njit
def _reset(memory):
    for i in range(2):
        memory.x[i] = 0.0
        memory.y[i] = 0.0


@njit
def reset(s):
    """Fresh filters."""
    _reset(s.inner)
    _reset(s.outer)


@njit
def _filter(p, s, value):
    out = p.b[0] * value + p.b[1] * s.x[0] + p.b[2] * s.x[1] - p.a[1] * s.y[0] - p.a[2] * s.y[1]
    limited = limit(out, p.limit)
    s.x[1] = s.x[0]
    s.x[0] = value + (limited - out) / p.b[0]
    s.y[1] = s.y[0]
    s.y[0] = limited
    return limited


@njit
def step(p, s, wheel_error, pitch, yaw_rate):
    """(u_x, lean reference) of one tick.

    Args:
        wheel_error: reference - estimate of the wheels' angle against the ground (phi + pitch), rad.
        pitch: estimated lean, rad.
        yaw_rate: reference, rad/s.
    """
    lean = _filter(p.outer, s.outer, wheel_error)
    return _filter(p.inner, s.inner, (1.0 + p.spin_s2_rad2 * yaw_rate * yaw_rate) * (lean - pitch)), lean
