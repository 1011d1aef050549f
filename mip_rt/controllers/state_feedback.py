"""State feedback of the MBBR with its outer loop: from references and estimate to a body command.

Source: dissertation (6.7) to (6.13) with the sign of the outer loop corrected (errata item 6: a ball that is too slow needs a lean
*towards* the target). The low-pass and the outer loop act on signals that, in the yaw-rotated frame, rotate with the robot; there their lag
costs stability in proportion to the yaw rate. So they run on the inertial error by default, and their outputs are rotated; the
paper's own arrangement remains selectable.

Errors are reference - estimate, u = -K error. Frames: starred quantities are rotated by the yaw, phi* = Rt phi with
Rt = [[cos, sin], [-sin, cos]].
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.controllers.filters import limit, low_pass
from mip_rt.controllers.gain_schedule import C1, C2, C3, C4, C5, C6, LOW_PASS_POLE, OUTER_GAIN, OUTER_POLE

FILTER_FRAME_INERTIAL = 0
FILTER_FRAME_YAW = 1

LEAN_LIMITED = 1  # result bits of `step`
LEAN_RATE_LIMITED = 2

PARAMETERS = np.dtype(
    [
        ("dt_s", "f8"),
        ("filter_frame", "i8"),
        ("lean_limit_rad", "f8"),
        ("lean_rate_limit_rad_s", "f8"),
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("low_passed_rad_s", "f8", (2,)),  # in the filter frame
        ("lean_rad", "f8", (2,)),  # state of the outer loop, in the filter frame
        ("lean_rotated_rad", "f8", (2,)),  # lean reference of the previous tick, yaw frame
        ("first", "i8"),  # 1 until the first tick has given lean_rotated a value
    ],
    align=True,
)


def configure(p, dt_s, filter_frame, lean_limit_rad, lean_rate_limit_rad_s) -> None:
    """Derives the constants, once. `filter_frame` is "inertial" or "yaw"."""
    p.dt_s = dt_s
    p.filter_frame = {"inertial": FILTER_FRAME_INERTIAL, "yaw": FILTER_FRAME_YAW}[filter_frame]
    p.lean_limit_rad = lean_limit_rad
    p.lean_rate_limit_rad_s = lean_rate_limit_rad_s


@njit
def reset(s):
    """Fresh filters."""
    for i in range(2):
        s.low_passed_rad_s[i] = 0.0
        s.lean_rad[i] = 0.0
        s.lean_rotated_rad[i] = 0.0
    s.first = 1


@njit
def step(p, s, reference, gains, estimate, error, lean, command):
    """One tick of (6.7) to (6.13).

    Args:
        reference: record of reference.STATE.
        gains: (9,) gains in force, see gain_schedule.
        estimate: (10,) see robots.mbbr_frame.ESTIMATE_NAMES.
        error: (10,) out: tilt x, y, yaw, ball angle* x, y, their rates (tilt x, y, yaw, low-passed ball rate* x, y).
        lean: (4,) out: lean reference x, y and its rate x, y, yaw frame.
        command: (3,) out: body command u.

    Returns:
        LEAN_LIMITED and LEAN_RATE_LIMITED bits: that reference was at its limit.
    """
    cosine = math.cos(estimate[2])
    sine = math.sin(estimate[2])
    # Rate errors in both frames.
    inertial_x = reference.rate_rad_s[0] - (cosine * estimate[6] - sine * estimate[7])
    inertial_y = reference.rate_rad_s[1] - (sine * estimate[6] + cosine * estimate[7])
    rotated_x = cosine * inertial_x + sine * inertial_y
    rotated_y = -sine * inertial_x + cosine * inertial_y
    if p.filter_frame == FILTER_FRAME_INERTIAL:
        filter_x = inertial_x
        filter_y = inertial_y
    else:
        filter_x = rotated_x
        filter_y = rotated_y

    s.low_passed_rad_s[0] = low_pass(s.low_passed_rad_s[0], filter_x, gains[LOW_PASS_POLE])
    s.low_passed_rad_s[1] = low_pass(s.low_passed_rad_s[1], filter_y, gains[LOW_PASS_POLE])
    rate_x = s.low_passed_rad_s[0]
    rate_y = s.low_passed_rad_s[1]
    lean_x = s.lean_rad[0]
    lean_y = s.lean_rad[1]
    if p.filter_frame == FILTER_FRAME_INERTIAL:
        rate_x, rate_y = cosine * rate_x + sine * rate_y, -sine * rate_x + cosine * rate_y
        lean_x, lean_y = cosine * lean_x + sine * lean_y, -sine * lean_x + cosine * lean_y
    if s.first == 1:
        s.first = 0
        s.lean_rotated_rad[0] = lean_x
        s.lean_rotated_rad[1] = lean_y
    lean[0] = lean_x
    lean[1] = lean_y
    lean_rate_x = (lean_x - s.lean_rotated_rad[0]) / p.dt_s
    lean_rate_y = (lean_y - s.lean_rotated_rad[1]) / p.dt_s
    lean[2] = limit(lean_rate_x, p.lean_rate_limit_rad_s)
    lean[3] = limit(lean_rate_y, p.lean_rate_limit_rad_s)
    bits = LEAN_RATE_LIMITED if lean[2] != lean_rate_x or lean[3] != lean_rate_y else 0
    s.lean_rotated_rad[0] = lean_x
    s.lean_rotated_rad[1] = lean_y
    # The outer loop is fed with the unfiltered error (low-passed input loses stability) and acts from the next tick on.
    next_x = gains[OUTER_POLE] * s.lean_rad[0] + gains[OUTER_GAIN] * filter_x
    next_y = gains[OUTER_POLE] * s.lean_rad[1] + gains[OUTER_GAIN] * filter_y
    s.lean_rad[0] = limit(next_x, p.lean_limit_rad)
    s.lean_rad[1] = limit(next_y, p.lean_limit_rad)
    if s.lean_rad[0] != next_x or s.lean_rad[1] != next_y:
        bits |= LEAN_LIMITED

    angle_x = reference.angle_rad[0] - estimate[8]
    angle_y = reference.angle_rad[1] - estimate[9]
    error[0] = lean_x - estimate[0]
    error[1] = lean_y - estimate[1]
    error[2] = reference.yaw_rad - estimate[2]
    error[3] = cosine * angle_x + sine * angle_y
    error[4] = -sine * angle_x + cosine * angle_y
    error[5] = lean[2] - estimate[3]
    error[6] = lean[3] - estimate[4]
    error[7] = reference.yaw_rate_rad_s - estimate[5]
    error[8] = rate_x
    error[9] = rate_y

    command[0] = -(gains[C1] * error[0] + gains[C2] * error[3] + gains[C3] * error[5] + gains[C4] * error[8])
    command[1] = -(gains[C1] * error[1] + gains[C2] * error[4] + gains[C3] * error[6] + gains[C4] * error[9])
    command[2] = -(gains[C5] * error[2] + gains[C6] * error[7])
    return bits
