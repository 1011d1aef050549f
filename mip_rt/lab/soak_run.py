"""One run of a campaign, in the process that calls it: dry run on virtual time, promises judged, reactions counted."""

import contextlib
import gc
import os
import threading
import traceback
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mip_rt import config as configuration
from mip_rt import session as runner
from mip_rt.errors import MipRtError
from mip_rt.fake import bench as fake_bench
from mip_rt.fake.faults import FAULTS
from mip_rt.fake.kernel import SAMPLE_NS
from mip_rt.faults import FAULT_BY_NUMBER
from mip_rt.frame import LIMITS
from mip_rt.lab.observation import Observation
from mip_rt.lab.promises import FALLEN_RAD, SAMPLE_S, Broken, broken
from mip_rt.log import open as open_log
from mip_rt.supervisor import State

AFTER = 200  # samples after a fault's end within which a reaction is put down to it
HARMLESS = ("serial", "clock", "disk", "file")  # whatever happens there, the robot balances on
EXPLAINED = 2000  # samples
PRESS_SEEN = 6  # samples within which the loop takes note of the button


@dataclass
class Reaction:
    """What followed one injection.

    Attributes:
        off_s: from the beginning to the enable line's fall; None where it stayed high or was low before.
        zero_s: from the beginning to commands of zero; None where they were zero or did not become so.
        codes: faults entered, and limits set that were not set before.
        lean_rad: largest true lean.
    """

    name: str
    at_s: float
    armed: bool
    off_s: float | None = None
    zero_s: float | None = None
    codes: list = field(default_factory=list)
    lean_rad: float = 0.0
    fell: bool = False


class _Rows:
    """Takes the summary's place in the session: keeps the rows, computes nothing."""

    def __init__(self, seen):
        self._seen = seen

    def absorb(self, rows, truth=None, fake_ns=None) -> None:
        """Takes rows in."""
        self._seen.take_rows(rows)

    def report(self, *_) -> dict:
        """Nothing to say."""
        return {}


def _descriptors() -> int:
    """How many are open; without sockets where other threads run, which are a cluster's and connect when they like."""
    links = []
    for name in os.listdir("/proc/self/fd"):
        with contextlib.suppress(FileNotFoundError):  # that of the list itself
            links.append(os.readlink(f"/proc/self/fd/{name}"))
    return len(links) if threading.active_count() == 1 else sum(not link.startswith("socket:") for link in links)


def observe(config, scenario, seed: int, duration_s: float, config_path=None):
    """(Observation, list of Broken): a whole run and what of its end was not clean."""
    found = []
    before = _descriptors()
    bench = fake_bench.build(config, scenario, seed, False, config_path=config_path)
    try:
        seen = Observation(bench, len(config.motors.channels), duration_s)
        session = None
        try:
            session = runner.Session(config, bench, bench.folder, bench.remote.device, seed, scenario.name)
            session.summary = _Rows(seen)
            session.run(duration_s, runner.Stop(), None, False)
        except MipRtError as error:
            found.append(Broken("clean exit", bench.world.samples * SAMPLE_S, f"the run ended with {error.code}: {error.sentence}"))
        except Exception:  # noqa: BLE001 - that nothing else comes out is the promise
            found.append(Broken("clean exit", bench.world.samples * SAMPLE_S, traceback.format_exc(limit=-3)))
        seen.finish()
        if session is not None:
            found += _after(session, bench)
    finally:
        bench.close()
    session = None
    left = _descriptors() - before
    if left > 0 and _warm:
        gc.collect()  # sockets of the fakes may wait for it
        left = _descriptors() - before
    if left > 0 and _warm:
        found.append(Broken("clean exit", seen.samples * SAMPLE_S, f"{left} descriptors stay open"))
    _warm.append(True)  # what the first run opens for good, such as compiled code, belongs to the process
    return seen, found


def _after(session, bench) -> list[Broken]:
    """Motors off, log whole."""
    found, end_s = [], bench.world.samples * SAMPLE_S
    duty = np.zeros(len(session.config.motors.channels))
    bench.kernel.motor_wiring.disconnect()
    if bench.kernel.motor_wiring.read(duty) or duty.any():
        found.append(Broken("clean exit", end_s, "the motors are enabled after the end"))
    log = open_log(session.ring.path)
    expected = min(session.loop.ticks, session.ring.capacity)
    if log.damage or len(log.frames) != expected:
        found.append(Broken("log", end_s, f"{len(log.frames)} of {expected} rows can be read: {'; '.join(log.damage) or 'no damage named'}"))
    return found


def ends_balancing(seen, config) -> list[Broken]:
    """After the last fault is over the operator can always start again: a campaign's run ends balancing."""
    if seen.rows and seen.rows["state"][-1] == State.BALANCING:
        return []
    state = State(int(seen.rows["state"][-1])).name if seen.rows else "nothing"
    return [Broken("recovers", seen.samples * SAMPLE_S, f"the operator cannot start again: the run ends in {state}")]


def fault_entries(seen) -> list[tuple]:
    """(sample, fault code) of every entry into FAULT."""
    rows = seen.rows
    if not rows:
        return []
    state = rows["state"]
    entered = np.flatnonzero((state[1:] == State.FAULT) & (state[:-1] != State.FAULT)) + 1
    return [(int(rows["sample"][k]), FAULT_BY_NUMBER[int(rows["fault"][k])].code) for k in entered]


def reactions(seen) -> list[Reaction]:
    """What followed each injection."""
    rows, entries = seen.rows, fault_entries(seen)
    moving = (rows["remote_velocity_m_s"] != 0.0).any(axis=1) | (rows["remote_yaw_rate_rad_s"] != 0.0)
    found = []
    for name, begin, end, _ in seen.injections:
        last = min(end + AFTER, seen.samples)
        reaction = Reaction(name, begin * SAMPLE_S, bool(seen.enabled[begin]))
        if reaction.armed:
            reaction.off_s = _until_off(seen, begin, last)
        a, b = np.searchsorted(rows["sample"], (begin, last + 1))
        if a < b and moving[a]:
            zero = np.flatnonzero(~moving[a:b])
            reaction.zero_s = float(rows["sample"][a + zero[0]] - begin) * SAMPLE_S if len(zero) else None
        reaction.codes = [code for k, code in entries if begin <= k <= last + 1]
        usual = int(np.bitwise_or.reduce(rows["limits"][max(0, a - 100) : a])) if a else 0
        during = int(np.bitwise_or.reduce(rows["limits"][a:b])) if a < b else 0
        reaction.codes += [limit for limit, bit in LIMITS.items() if during & ~usual & bit]
        reaction.lean_rad = float(seen.lean_rad[begin : last + 1].max())
        reaction.fell = bool(seen.lean_rad[begin] < FALLEN_RAD <= reaction.lean_rad)
        found.append(reaction)
    return found


def _until_off(seen, begin: int, last: int) -> float | None:
    """Seconds from a sample to the fall of the enable line, if that was not the operator's wish."""
    low = np.flatnonzero(~seen.enabled[begin : last + 1])
    if not len(low):
        return None
    fell = begin + int(low[0])
    if ((seen.presses >= fell - PRESS_SEEN) & (seen.presses < fell)).any():
        return None
    begin_ns = seen.start_ns + begin * SAMPLE_NS
    exact = [fell_ns for fell_ns in seen.fell_ns if begin_ns <= fell_ns <= begin_ns + (fell - begin) * SAMPLE_NS]
    return (exact[0] - begin_ns) * 1e-9 if exact else (fell - begin) * SAMPLE_S


def false_alarms(seen) -> list[tuple]:
    """(seconds, code): faults entered without an injection to explain them, and falls without one."""
    explaining = [(begin, end) for name, begin, end, _ in seen.injections if FAULTS[name].boundary not in HARMLESS]
    explaining += [(int(press), int(press)) for press in seen.presses if seen.enabled[press]]  # disarmed: it falls
    events = fault_entries(seen)
    down = seen.lean_rad > FALLEN_RAD
    events += [(int(k), "fell") for k in np.flatnonzero(down[1:] & ~down[:-1]) + 1]
    return [(k * SAMPLE_S, code) for k, code in events if not any(begin <= k <= end + EXPLAINED for begin, end in explaining)]


_configs = {}
_warm = []


def configured(overrides: dict, path=None):
    """The configuration of a campaign's runs; loaded once a process."""
    path = path or configuration.default_path("mbbr")
    key = (str(path), *sorted(overrides.items()))
    if key not in _configs:
        _configs[key] = configuration.load(path, {"estimator.shadows": "[]", "log.ring_s": "5", **overrides})
    return _configs[key]


def run(config, scenario, seed: int, duration_s: float, campaign: bool, config_path: Path | None = None) -> dict:
    """Everything a campaign wants to know of one run, small enough to be sent between processes.

    Args:
        campaign: the scenario is a plan, which ends with a recovery; otherwise it is ordinary driving, and every alarm is false.
    """
    seen, found = observe(config, scenario, seed, duration_s, config_path)
    result = {"seed": seed, "scenario": scenario.name, "simulated_s": seen.samples * SAMPLE_S, "reactions": [], "false_alarms": []}
    if seen.rows:
        found = broken(seen, config) + found + (ends_balancing(seen, config) if campaign else [])
        result["reactions"] = reactions(seen)
        result["false_alarms"] = false_alarms(seen)
    result["broken"] = sorted(found, key=lambda entry: entry.time_s)
    return result
