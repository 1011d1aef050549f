"""A motor's winding behind a switching bridge, event by event: what the averaged equations of `models.motor` are compared with.

Within a phase of the PWM period the speed is held, so that the current is an exponential; its zero crossing in the diodes is found in closed form.
Nothing is stepped, so the only error is rounding. Per unit as in `models.motor`; time in units of L/R.

Source: dissertation (4.4), (4.5), Fig. 4.2, with the diodes' behaviour beyond |omega_r| = 1 of section C of the equations.
"""

import math

import numpy as np

from mip_rt.compiled import njit


@njit
def _phase(current, target, span):
    """(integral of the current, current at the end) of an exponential towards `target`."""
    gone = math.exp(-span)
    return target * span + (current - target) * (1.0 - gone), target + (current - target) * gone


@njit
def coast_phase(current, omega_r, span, delta):
    """(integral, end) while the transistors are open: the current dies in the diodes, and stays dead unless the back EMF exceeds the supply."""
    total = 0.0
    if current != 0.0:
        target = (-1.0 if current > 0.0 else 1.0) * (1.0 + delta) - omega_r
        if current * target < 0.0:  # it will cross zero: at this moment the diodes block
            dies = math.log((current - target) / -target)
            if dies >= span:
                return _phase(current, target, span)
            part, _ = _phase(current, target, dies)
            total += part
            span -= dies
            current = 0.0
        else:
            return _phase(current, target, span)
    if abs(omega_r) > 1.0 + delta:
        part, current = _phase(0.0, math.copysign(1.0 + delta, omega_r) - omega_r, span)
        return total + part, current
    return total, current


@njit
def period(current, u, omega_r, t_r, delta, brake):
    """(average current, current at the end) of one PWM period that begins with `current`; `brake` 1: the winding is shorted between pulses."""
    on = abs(u) * t_r
    driven, current = _phase(current, (1.0 if u > 0.0 else -1.0) - omega_r, on)
    if brake == 1:
        rest, current = _phase(current, -omega_r, t_r - on)
    else:
        rest, current = coast_phase(current, omega_r, t_r - on, delta)
    return (driven + rest) / t_r, current


@njit
def dynamometer(u, sample_s, p, current_a, speed_rad_s):
    """A flywheel on a motor under duties u (n,), each held for sample_s: average current and mean speed of every sample into the two arrays.

    Args:
        p: (8,) supply V, resistance, inductance, torque constant, PWM period, diode drop, inertia, Coulomb friction N m.
    """
    volts, resistance, inductance, k, period_s, drop, inertia, coulomb = p
    stall = volts / resistance
    t_r = period_s * resistance / inductance
    delta = 2.0 * drop / volts
    pulses = max(1, int(round(sample_s / period_s)))
    current = 0.0
    omega = 0.0
    for n in range(len(u)):
        total = 0.0
        turned = 0.0
        for _ in range(pulses):
            average, current = period(current, u[n], k * omega / volts, t_r, delta, 0)
            total += average
            turned += omega
            omega += period_s / inertia * (k * stall * average - coulomb * math.tanh(omega / 0.5))
        current_a[n] = stall * total / pulses
        speed_rad_s[n] = turned / pulses


def settled(u: float, omega_r: float, t_r: float, delta: float = 0.0, brake: bool = False) -> float:
    """Average current i / i_s of the periodic cycle at a held speed."""
    current = before = np.inf
    average = 0.0
    current = 0.0
    while abs(current - before) > 1e-14:
        before = current
        average, current = period(current, u, omega_r, t_r, delta, int(brake))
    return average
