"""The small discrete filters of the controller: coefficients from rates in rad/s, so that no number is "per tick".

Source: dissertation (6.12) low-pass, (6.13) outer loop, (6.20) 6-tap derivative.
"""

import math

from mip_rt.compiled import njit

DERIVATIVE_TAPS = 6
# Least-squares slope of the last six samples, newest first, for samples one tick apart: [5, 3, 1, -1, -3, -5] / 35.
# At 200 Hz these are the (28.5714, 17.1429, 5.71429, ...) of (6.20). The delay is 2.5 ticks.
DERIVATIVE_WEIGHTS = (5.0 / 35.0, 3.0 / 35.0, 1.0 / 35.0, -1.0 / 35.0, -3.0 / 35.0, -5.0 / 35.0)


def pole_from_rate(rate_rad_s: float, dt_s: float) -> float:
    """Discrete pole exp(-rate dt) of a first-order filter; 0 (no filter) where the rate is 0 or infinite."""
    return math.exp(-rate_rad_s * dt_s) if 0.0 < rate_rad_s < math.inf else 0.0


@njit
def low_pass(previous, value, pole):
    """First-order low-pass y_k = a y_{k-1} + (1 - a) x_k, (6.12)."""
    return pole * previous + (1.0 - pole) * value


@njit
def derivative(history, value, rate_hz):
    """Slope of the last six samples, in units of value per second.

    Args:
        history: (6,) samples, newest first; shifted in place to take `value` in.
        value: newest sample.
        rate_hz: sample rate.
    """
    for i in range(DERIVATIVE_TAPS - 1, 0, -1):
        history[i] = history[i - 1]
    history[0] = value
    slope = (
        DERIVATIVE_WEIGHTS[0] * (history[0] - history[5])
        + DERIVATIVE_WEIGHTS[1] * (history[1] - history[4])
        + DERIVATIVE_WEIGHTS[2] * (history[2] - history[3])
    )
    return slope * rate_hz


@njit
def limit(value, bound):
    """value within [-bound, bound]; NaN stays NaN."""
    if value > bound:
        return bound
    if value < -bound:
        return -bound
    return value
