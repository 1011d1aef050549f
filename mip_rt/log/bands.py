"""Bands of a page: when which state and which limit was in force."""

import numpy as np

from mip_rt.log import events
from mip_rt.log.codes import Codes
from mip_rt.log.page import GREEN, GREY, VERMILLION, YELLOW, Band

STATE_COLOURS = {
    "BOOT": "#D9D9D9", "CALIBRATING": "#BFBFBF", "DISARMED": "#E8DFC8", "ARMING": YELLOW, "BALANCING": GREEN, "FAULT": VERMILLION,
}  # fmt: skip


def bands(frames, times_s, codes: Codes) -> list[Band]:
    """States, then missed ticks, IMU troubles and limits that occur in the rows."""
    step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.005
    states = frames["state"]
    edges = [0, *(np.flatnonzero(states[1:] != states[:-1]) + 1).tolist(), len(states)]
    spans = [
        (float(times_s[a]), float(times_s[b - 1]) + step_s, codes.state(states[a]), STATE_COLOURS.get(codes.state(states[a]), GREY))
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]
    found = [Band("state", spans)]
    for label, mask in _conditions(frames, codes):
        found.append(Band(label, [(a, b, label, VERMILLION) for a, b in _runs(mask, times_s, step_s)]))
    return found


def _conditions(frames, codes: Codes):
    if frames["missed"].any():
        yield "missed ticks", frames["missed"] > 0
    for field, words in (("imu_status", "IMU "), ("limits", ""), ("alarms", "alarm: ")):
        for name, entry in events.bits(frames, field, codes).items():
            yield words + name, frames[field] & entry["bit"] != 0


def _runs(mask, times_s, step_s: float) -> list[tuple]:
    """(begin, end) of each run of True."""
    padded = np.concatenate(([False], mask, [False]))
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return [(float(times_s[a]), float(times_s[b - 1]) + step_s) for a, b in zip(edges[::2], edges[1::2], strict=True)]
