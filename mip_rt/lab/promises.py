"""The promises, judged on what happened at the kernel boundary of one dry run.

Each is a function of an Observation and the configuration that returns the sample at which it was broken first, or None; a reaction is
allowed one sample more than its bound, because the boundary is looked at every 5 ms. While the loop is kept from running (`stalled`) it can promise
nothing: the guard takes over, which promises 0.1 s. The loop's own bounds begin anew when it runs again.
"""

import math
from typing import NamedTuple

import numpy as np

from mip_rt.supervisor import State

SAMPLE_S = 0.005
IMU_LOST = 10  # samples: 50 ms
TIPPED = 2
HUNG = 20  # 100 ms
REMOTE_SILENT = 100  # 0.5 s
FALLEN_RAD = math.radians(60.0)
LYING = 30  # samples within which a robot that truly lies must be off


class Broken(NamedTuple):
    """A promise that was not kept."""

    promise: str
    time_s: float
    sentence: str


def _first(where) -> int | None:
    found = np.flatnonzero(where)
    return int(found[0]) if len(found) else None


def _last_true(flags) -> np.ndarray:
    """(n,) index of the newest true entry before each place, 0 where there is none."""
    index = np.where(flags, np.arange(len(flags)), 0)
    return np.concatenate(([0], np.maximum.accumulate(index)[:-1]))


def _excused(seen, margin: int) -> np.ndarray:
    """(n,) true from the begin of each stall until `margin` samples after it, but no longer than the guard's bound."""
    excused = np.zeros(len(seen.enabled), bool)
    for begin, end in seen.stalled:
        excused[begin : min(end + margin, begin + HUNG) + 2] = True
    return excused


def off_without_imu(seen, config) -> int | None:
    """The motors are off within 50 ms of the last usable packet."""
    usable = seen.usable
    silent = np.arange(len(usable)) - _last_true(usable)
    return _first(seen.enabled & (silent > IMU_LOST + 1) & ~_excused(seen, IMU_LOST))


def off_when_tipped(seen, config) -> int | None:
    """The motors are off two ticks after a packet that says the robot leans beyond limits.tip_rad, and soon where it lies in truth."""
    tipped = seen.usable & (seen.measured_lean_rad > config.limits.tip_rad + 1e-3)
    late = np.zeros(len(tipped), bool)
    late[TIPPED + 1 :] = tipped[: -TIPPED - 1]
    lying = seen.lean_rad > FALLEN_RAD
    since = np.arange(len(lying)) - _last_true(~lying)
    excused = _excused(seen, TIPPED)
    first = [_first(seen.enabled & late & ~excused), _first(seen.enabled & (since > LYING) & ~_excused(seen, LYING))]
    return min((k for k in first if k is not None), default=None)


def still_without_remote(seen, config) -> int | None:
    """The remote's commands are zero 0.5 s after its last byte, and never beyond its levels."""
    rows = seen.rows
    velocity = np.hypot(*rows["remote_velocity_m_s"].T)
    spin = np.abs(rows["remote_yaw_rate_rad_s"])
    levels = config.remote.levels
    beyond = ~(velocity <= max(level.drive_limit_m_s for level in levels) + 1e-9)
    beyond |= ~(spin <= 2.0 * math.pi * max(abs(level.yaw_rate_hz) for level in levels) + 1e-9)
    heard = np.zeros(len(seen.enabled), bool)
    heard[seen.bytes_sent] = True
    for name, begin, end, _ in seen.injections:
        if name == "serial_error":
            heard[begin + 4 : end] = False
            heard[end] = True  # what waited in the port comes at once
    for begin, end in seen.stalled:  # likewise what came while the loop did not run, at one of its next looks
        if heard[max(0, begin - 4) : end + 1].any():
            heard[end : end + 5] = True
    silent = rows["sample"] - _last_true(heard)[rows["sample"]]
    broken = beyond | ((silent > REMOTE_SILENT + 1) & ((velocity != 0.0) | (spin != 0.0)))
    row = _first(broken)
    return None if row is None else int(rows["sample"][row])


def on_by_gesture_only(seen, config) -> int | None:
    """The enable line rises only after a press of the button since it fell; after a fault, after two."""
    enabled = seen.enabled
    faulted = np.zeros(len(enabled), bool)
    faulted[seen.rows["sample"][seen.rows["state"] == State.FAULT]] = True
    fell = 0
    for k in np.flatnonzero(enabled[1:] != enabled[:-1]) + 1:
        if not enabled[k]:
            fell = k
            continue
        # The loop reads a press some ticks after it was made; one made while the loop hung, before the guard drops the line, when it runs again.
        since = min([fell - 6, *(begin - 6 for begin, end in seen.stalled if begin <= fell <= end)])
        presses = np.count_nonzero((seen.presses >= since) & (seen.presses <= k))
        if presses < (2 if faulted[fell:k].any() else 1):
            return int(k)
    return None


def finite_and_limited(seen, config) -> int | None:
    """Every duty is finite and within limits.duty, in the log and at the motor drivers."""
    limit = config.limits.duty
    period_ns = 1e9 / config.motor.pwm_frequency_hz
    duty, applied = seen.rows["duty"], seen.rows["applied_ns"]
    bad = ~(np.abs(duty) <= limit + 1e-9).all(axis=1) | (np.abs(applied) > limit * period_ns + 1).any(axis=1)
    row = _first(bad)
    at_driver = _first(~(np.abs(seen.duty) <= limit + 1e-4).all(axis=1))
    found = [at_driver] + ([int(seen.rows["sample"][row])] if row is not None else [])
    return min((k for k in found if k is not None), default=None)


def off_unless_balancing(seen, config) -> int | None:
    """In every state but BALANCING the enable line is low and all duties are 0."""
    rows = seen.rows
    row = _first((seen.enabled & ~_excused(seen, 0))[rows["sample"]] & (rows["state"] != State.BALANCING))
    return None if row is None else int(rows["sample"][row])


def off_when_hung(seen, config) -> int | None:
    """The enable line is low 100 ms after the loop has stopped to run."""
    hung = np.zeros(len(seen.enabled), bool)
    for begin, end in seen.stalled:
        hung[begin + HUNG + 1 : end + 1] = True
    return _first(seen.enabled & hung)


PROMISES = {
    "hung": off_when_hung,
    "imu lost": off_without_imu,
    "tipped": off_when_tipped,
    "remote silent": still_without_remote,
    "gesture": on_by_gesture_only,
    "duty": finite_and_limited,
    "off": off_unless_balancing,
}


def broken(seen, config) -> list[Broken]:
    """Every promise that this run broke, at the first time it did."""
    found = []
    for name, promise in PROMISES.items():
        sample = promise(seen, config)
        if sample is not None:
            found.append(Broken(name, sample * SAMPLE_S, promise.__doc__.strip()))
    return found
