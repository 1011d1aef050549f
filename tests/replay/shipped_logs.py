"""The change indicator: excerpts of dry runs of every shipped scenario, with every estimator, kept in `logs/` and replayed by the tests.

An excerpt is a recorded file like any other (`mip-rt replay` and `mip-rt log` read it): stretches of complete rows around moments at which
something happens, and before each the state from which the replay resumes. It holds what a few ticks of every phase can show: any
change of the arithmetic appears in the first tick that runs through it. `tools/update-replay-logs` rewrites the excerpts whose
replay is no longer equal, and says what changed.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from helpers import DryRun, make_config

from mip_rt import frame, robots
from mip_rt import log as logs
from mip_rt.config import scenario as scenarios
from mip_rt.errors import MipRtError
from mip_rt.lab.attitude_sources import scenarios_of
from mip_rt.log import block_format
from mip_rt.log.block_format import SUFFIX, Kind
from mip_rt.log.comparison import Comparison
from mip_rt.log.replay import replay
from mip_rt.log.rerun import Rerun
from mip_rt.progress import progress

FOLDER = Path(__file__).parent / "logs"
LARGEST = 1_500_000  # bytes of all excerpts together
LONGEST_S = 30.0  # of a scenario: what happens later is more of the same
BEFORE, LENGTH = 4, 20  # ticks of a stretch before its moment and in all
SHADOWS = 5  # estimators beside the one in control: a full state of each stands before every stretch
FILLING = 12  # moments in even distances, where there is room


def wanted() -> dict[str, tuple]:
    """{name of an excerpt: (configuration, name of the scenario)}: every scenario of every robot, and its other controllers standing still.

    Where a robot has more estimators than SHADOWS, each excerpt leaves out others.
    """
    found = {}
    for robot in robots.NAMES:
        setup, shipped = robots.setup(robot), make_config(robot)
        names = [name for name in setup.ESTIMATORS if name != shipped.estimator.control]
        for number, scenario in enumerate(scenarios_of(robot)):
            first = number * SHADOWS % len(names)
            shadows = (names[first:] + names[:first])[:SHADOWS]
            changes = {"estimator__shadows": f"[{', '.join(shadows)}]", "log__ring_s": str(LONGEST_S + 1.0)}
            found[f"{robot}-{scenario}"] = make_config(robot, **changes), scenario
        for controller in getattr(setup, "CONTROLLERS", ()):
            if controller != shipped.control.controller:
                found[f"{robot}-hold-{controller}"] = make_config(robot, **changes, control__controller=controller), "hold"
    return found


def path_of(name: str) -> Path:
    """The excerpt's file."""
    return FOLDER / (name + SUFFIX)


def moments(frames) -> list[int]:
    """Ticks worth keeping, the most telling first."""
    engaged = frames["request"] & frame.REQUEST_ENGAGED != 0
    found = list(np.flatnonzero(engaged[1:] & ~engaged[:-1]) + 1)
    found += list(np.flatnonzero(frames["request"] & frame.REQUEST_HEADING_RESET))
    found += [np.abs(frames["gyro_rad_s"][:, 2]).argmax(), np.abs(frames["wheel_rate_rad_s"]).max(axis=1).argmax()]
    for bit in frame.LIMITS.values():
        found += list(np.flatnonzero(frames["limits"] & bit)[:1])
    command = np.column_stack([frames["remote_velocity_m_s"], frames["remote_yaw_rate_rad_s"]])
    found += [*(np.flatnonzero((command[1:] != command[:-1]).any(axis=1)) + 1)[:40:8], 0, len(frames) - LENGTH + BEFORE]
    found += list(np.linspace(0, len(frames) - LENGTH, FILLING).astype(int))
    return [int(tick) for tick in found]


def states_before(log, ticks) -> dict[int, bytes]:
    """The persistent state after each tick that precedes one of `ticks`."""
    rerun = Rerun(log)
    rows = log.frames.copy()
    rerun.robot.attach(rows)
    states = {}
    for index in range(max(ticks)):
        rerun.robot.step(index)
        if index + 1 in ticks:
            states[index] = rerun.robot.persistence.present()
    return states


def encode(log, ticks, states) -> bytes:
    """A recorded file of these ticks (a set) with a state row before each stretch of them."""
    # An excerpt has no date, and belongs to no one's computer.
    description = {key: value for key, value in log.header.items() if key not in ("recording", "host", "run")}
    description["clock"] = {"monotonic_ns": 0, "realtime_ns": 0}
    parts = [block_format.pack_json(Kind.HEADER, description, 0, 9)]
    ordered = np.array(sorted(ticks))
    for stretch in np.split(ordered, np.flatnonzero(np.diff(ordered) != 1) + 1):
        first, count = int(stretch[0]), len(stretch)
        if first:
            parts.append(block_format.pack(Kind.STATE, states[first - 1], len(parts), 9, first - 1, 1))
        parts.append(block_format.pack(Kind.ROWS, log.frames[first : first + count].tobytes(), len(parts), 9, first, count))
    parts.append(block_format.pack_json(Kind.END, {"reason": "excerpt"}, len(parts)))
    return b"".join(parts)


def record(config, scenario: str, largest: int) -> bytes:
    """A new excerpt of at most `largest` bytes."""
    script = scenarios.load(scenario)
    with tempfile.TemporaryDirectory() as folder, DryRun(Path(folder), config, script) as dry:
        log = logs.open(dry.run(min(script.duration_s, LONGEST_S))["log"])
    begins = [max(0, tick - BEFORE) for tick in moments(log.frames)]
    states = states_before(log, set(begins))
    kept, data = set(), b""
    for begin in begins:
        if begin in kept:
            continue
        more = kept | set(range(begin, min(begin + LENGTH, len(log.frames))))
        longer = encode(log, more, states)
        if len(longer) > largest:
            break
        kept, data = more, longer
    return data


def parameters(robot) -> bytes:
    """All numbers that a robot takes from its configuration."""
    return robot.parameters.tobytes() + robot.estimator_parameters.tobytes()


def change(name: str, config, largest: int) -> str | None:
    """Why an excerpt has to be rewritten; None where its replay is equal and the configuration gives the same parameters."""
    if not path_of(name).exists():
        return "new"
    log = logs.open(path_of(name))
    try:
        rerun, comparison = replay(log)
        unwatched = set(rerun.layout.dtype.names) - set(log.frames.dtype.names)
        if unwatched:
            return f"the frame has {', '.join(sorted(unwatched))}"
        if rerun.skipped:
            return "the state has other fields"
        if comparison.equal:
            if path_of(name).stat().st_size > largest:
                return "larger than its share"
            return None if parameters(rerun.robot) == parameters(robots.setup(config.robot).build(config)) else "configuration"
        rerun = Rerun(log, asserted=False)
    except MipRtError as error:
        return str(error).splitlines()[0]
    comparison = Comparison(log.frames, rerun.outputs, not rerun.other_machine)
    for recorded, replayed, _, counted in rerun.batches():
        comparison.take(recorded[-counted:], replayed[-counted:])
    fields = [
        f"\n    {field:<26} {comparison.columns[field].ticks:>4} of {comparison.rows} ticks, relative to its largest {comparison.relative(field):.1e}"
        for field in comparison.differing()
    ]
    return "".join(fields) or "state"


def main(argv=None) -> int:
    """Rewrites what has to be; exit code 0."""
    parser = argparse.ArgumentParser(prog="tools/update-replay-logs", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--all", action="store_true", help="rewrite every excerpt")
    arguments = parser.parse_args(argv)
    FOLDER.mkdir(exist_ok=True)
    runs = wanted()
    share = LARGEST // len(runs)
    for path in set(FOLDER.iterdir()) - {path_of(name) for name in runs}:
        path.unlink()
        print(f"{path.name}: removed, no scenario of that name is shipped")
    for number, (name, (config, scenario)) in enumerate(runs.items()):
        progress(number, len(runs), name)
        changed = change(name, config, share) or ("rewritten" if arguments.all else None)
        if changed:
            path_of(name).write_bytes(record(config, scenario, share))
            if not replay(logs.open(path_of(name)))[1].equal:
                raise SystemExit(f"{name}: the new excerpt does not replay; the step depends on something that the log lacks")
        print(f"{name}: {changed or 'unchanged'}")
    progress(1, 1, "")
    print(f"{sum(path.stat().st_size for path in FOLDER.iterdir())} of at most {LARGEST} bytes in {FOLDER.relative_to(FOLDER.parents[2])}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
