"""State feedback of the eduMIP with gains by yaw rate, and the yaw PD.

u_x = -K e with e = reference - estimate of lean, wheel angle against the ground, their rates, and the integral of the wheel angle's error. K comes from
`controllers.lqr` at several yaw rates (spinning, the centrifugal force on the leaning body changes the model) and is interpolated in between.
What holding a speed costs against the motors' back EMF is fed forward.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.controllers.filters import limit

GAINS = 5  # lean, wheel angle, lean rate, wheel rate, integral
SLOTS = 8

PARAMETERS = np.dtype(
    [
        ("dt_s", "f8"),
        ("slots", "i8"),
        ("at_rad_s", "f8", (SLOTS,)),
        ("gains", "f8", (SLOTS, GAINS)),
        ("speed_feedforward", "f8"),  # u_x a rad/s of the wheels
        ("yaw_feedforward", "f8"),  # u_z a rad/s of yaw
        ("integral_limit_rad_s", "f8"),
        ("yaw", "f8"),  # u_z a rad
        ("yaw_rate", "f8"),
    ],
    align=True,
)
STATE = np.dtype([("integral_rad_s", "f8"), ("gains", "f8", (GAINS,))], align=True)


@njit
def reset(s):
    """No memory."""
    s.integral_rad_s = 0.0


@njit
def yaw_command(p, error):
    """u_z of the PD on heading error[2] and yaw rate error[5]."""
    return p.yaw * error[2] + p.yaw_rate * error[5]


@njit
def _interpolate(p, rate, g):
    last = p.slots - 1
    if not rate > p.at_rad_s[0]:
        return p.gains[0, g]
    for slot in range(last):
        if rate <= p.at_rad_s[slot + 1]:
            share = (rate - p.at_rad_s[slot]) / (p.at_rad_s[slot + 1] - p.at_rad_s[slot])
            return p.gains[slot, g] + share * (p.gains[slot + 1, g] - p.gains[slot, g])
    return p.gains[last, g]


@njit
def step(p, s, error, wheel_rate_reference, yaw_rate_reference, command):
    """One tick.

    Args:
        error: (6,) reference - estimate: lean, wheel angle against the ground, yaw, and their rates.
        wheel_rate_reference, yaw_rate_reference: rad/s.
        command: (2,) out: u_x, u_z.
    """
    rate = abs(yaw_rate_reference)
    for g in range(GAINS):
        s.gains[g] = _interpolate(p, rate, g)
    s.integral_rad_s = limit(s.integral_rad_s + p.dt_s * error[1], p.integral_limit_rad_s)
    command[0] = p.speed_feedforward * wheel_rate_reference + (
        s.gains[0] * error[0] + s.gains[1] * error[1] + s.gains[2] * error[3] + s.gains[3] * error[4] + s.gains[4] * s.integral_rad_s
    )
    command[1] = p.yaw_feedforward * yaw_rate_reference + yaw_command(p, error)
