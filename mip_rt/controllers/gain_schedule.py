"""Gains by yaw rate, blended so that a change of the schedule's slot is never a step in the command.

Nine numbers are scheduled together: c1..c6 of the state feedback (6.10), the outer loop's gain and pole (6.13) and the low-pass's pole (6.12).
Between two slots they are interpolated over |yaw rate|; the result passes a first-order filter (the robot author's own
program blends with 6 rad/s).
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.controllers.filters import low_pass, pole_from_rate

GAINS = 9
C1, C2, C3, C4, C5, C6, OUTER_GAIN, OUTER_POLE, LOW_PASS_POLE = range(GAINS)
SLOTS = 8

# Coefficient of the published outer loop, (6.13); the published poles are those of a 200 Hz tick.
OUTER_COEFFICIENT = 0.000985
PUBLISHED_DT_S = 0.005

PARAMETERS = np.dtype(
    [
        ("slots", "i8"),  # how many rows of the two tables are used
        ("yaw_rate_rad_s", "f8", (SLOTS,)),  # ascending
        ("gains", "f8", (SLOTS, GAINS)),
        ("blend_pole", "f8"),
    ],
    align=True,
)
STATE = np.dtype([("gains", "f8", (GAINS,))], align=True)


def gain_row(gain_set, dt_s: float) -> list[float]:
    """The nine scheduled numbers of one named gain set for a tick of `dt_s`.

    The published pole and gain of the outer loop are per 5 ms: the pole is turned into a rate, and the gain keeps its value at
    zero frequency.

    Args:
        gain_set: object with c1..c6, slc_gain, slc_pole (per 5 ms tick) and lowpass_rad_s (0: no low-pass).
        dt_s: tick in seconds.
    """
    pole = gain_set.slc_pole ** (dt_s / PUBLISHED_DT_S)
    outer = gain_set.slc_gain * OUTER_COEFFICIENT * (1.0 - pole) / (1.0 - gain_set.slc_pole)
    c = [gain_set.c1, gain_set.c2, gain_set.c3, gain_set.c4, gain_set.c5, gain_set.c6]
    return [*c, outer, pole, pole_from_rate(gain_set.lowpass_rad_s, dt_s)]


def configure(p, schedule, blend_rad_s: float, dt_s: float) -> None:
    """Fills `p` (record of PARAMETERS) from [(yaw_rate_hz, gain set), ...] in ascending order, at most SLOTS of them."""
    if not 1 <= len(schedule) <= SLOTS:
        raise ValueError(f"a gain schedule has 1 to {SLOTS} slots, not {len(schedule)}")
    p.slots = len(schedule)
    for slot, (yaw_rate_hz, gain_set) in enumerate(schedule):
        p.yaw_rate_rad_s[slot] = 2.0 * math.pi * yaw_rate_hz
        p.gains[slot] = gain_row(gain_set, dt_s)
    p.blend_pole = pole_from_rate(blend_rad_s, dt_s)


@njit
def _target(p, g, rate):
    last = p.slots - 1
    if not rate > p.yaw_rate_rad_s[0]:
        return p.gains[0, g]
    for slot in range(last):
        low = p.yaw_rate_rad_s[slot]
        high = p.yaw_rate_rad_s[slot + 1]
        if rate <= high:
            share = (rate - low) / (high - low)
            return p.gains[slot, g] + share * (p.gains[slot + 1, g] - p.gains[slot, g])
    return p.gains[last, g]


@njit
def reset(p, s):
    """Starts with the gains of standing still."""
    for g in range(GAINS):
        s.gains[g] = p.gains[0, g]


@njit
def step(p, s, yaw_rate_rad_s):
    """Moves s.gains towards the gains of this (reference) yaw rate."""
    rate = abs(yaw_rate_rad_s)
    for g in range(GAINS):
        s.gains[g] = low_pass(s.gains[g], _target(p, g, rate), p.blend_pole)
