"""The dead-man: what is left of the remote's last command, by the age of its last frame. Compiled.

A remote that is silent for `timeout_s` is lost: its command goes to zero within `ramp_s`. An operating system may take half a minute to
notice a lost Bluetooth link, so only the age of the last valid frame counts.
"""

import math
import struct

import numpy as np

from mip_rt.compiled import entry, njit, records_at

STATE = np.dtype(
    [
        ("heard", "i8"),  # 1: there was a frame
        ("frame_ns", "i8"),  # when the newest came
        ("wanted", "f8", (3,)),  # what it says: velocity forward and left (m/s), yaw rate (rad/s)
        ("command", "f8", (3,)),  # what is left of it
        ("age_s", "f8"),  # of that frame; infinity before the first
        ("alive", "i8"),  # 1: a frame is recent, or there is no remote to lose
        ("losses", "i8"),
        ("timeout_s", "f8"),
        ("ramp_s", "f8"),
    ],
    align=True,
)
FRAME = struct.Struct("=qq3d")  # its first three fields


@njit
def step(s, now_ns):
    """The command at this time; s: record of STATE."""
    if s.heard == 0:
        return
    s.age_s = (now_ns - s.frame_ns) * 1e-9
    late = s.age_s - s.timeout_s
    rest = 1.0
    if late <= 0.0:
        s.alive = 1
    else:
        s.losses += s.alive
        s.alive = 0
        rest = max(0.0, 1.0 - late / s.ramp_s)
    for i in range(3):
        s.command[i] = rest * s.wanted[i]


@entry("uintp", "int64")
def step_at(state_at, now_ns):
    """`step` of the STATE at this address."""
    step(records_at(state_at, 1, STATE)[0], now_ns)


def fresh(alive: bool, timeout_s: float, ramp_s: float) -> np.ndarray:
    """(1,) STATE that has heard nothing."""
    state = np.zeros(1, STATE)
    state["alive"], state["timeout_s"], state["ramp_s"], state["age_s"] = alive, timeout_s, max(ramp_s, 1e-6), math.inf
    return state
