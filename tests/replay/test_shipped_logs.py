"""The change indicator: what was committed must come out of the present code, on this machine or any other."""

import numpy as np
import pytest
import shipped_logs

from mip_rt import frame, robots
from mip_rt import log as logs
from mip_rt.log.replay import label, replay
from mip_rt.robots import mbbr_setup

CURE = "if that is meant: tools/update-replay-logs, and commit what it wrote"
FILES = sorted(shipped_logs.FOLDER.glob("*"))


@pytest.mark.armhf
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_shipped_log_replays(path):
    """A numerical change that nobody meant, or that only another processor or another numba shows."""
    rerun, comparison = replay(logs.open(path))
    first = comparison.first
    where = first and f"tick {first.tick}, {label(rerun, first.field, first.column)}: recorded {first.recorded!r}, replayed {first.replayed!r}"
    worst = {name: f"{comparison.relative(name):.1e}" for name in comparison.differing()[:5]}
    print(f"{path.stem}: {comparison.rows} ticks {'bit for bit' if comparison.exact else 'to 1e-9'}, largest relative differences {worst}")
    assert comparison.equal, f"{path.stem} differs first at {where or f'the state after tick {comparison.state_ticks[0]}'}; {CURE}"
    assert rerun.skipped == 0 and comparison.rows == len(rerun.log.frames) > 60, f"the state has other fields; {CURE}"
    assert rerun.layout.dtype.names == rerun.log.frames.dtype.names, f"the frame has other fields; {CURE}"


def test_every_shipped_scenario_has_a_log_and_all_are_small():
    """A new scenario without a log would go unwatched; a repository is no place for many megabytes."""
    assert {path.stem for path in FILES} == set(shipped_logs.wanted()), CURE
    assert sum(path.stat().st_size for path in FILES) <= shipped_logs.LARGEST


def test_logs_show_every_phase():
    """Excerpts of standing still alone would notice nothing."""
    opened = [logs.open(path) for path in FILES]
    assert all("are missing" in sentence for log in opened for sentence in log.damage)
    for robot in robots.NAMES:
        seen = {name for log, path in zip(opened, FILES) if path.stem.startswith(robot) for name in log.header["estimators"]}
        assert seen == set(robots.setup(robot).ESTIMATORS)
    request = np.concatenate([log.frames["request"] for log in opened])
    assert {0, frame.REQUEST_ENGAGED, frame.REQUEST_ENGAGED | frame.REQUEST_HEADING_RESET} <= set(request.tolist())
    yaw_rate = np.concatenate([log.frames["remote_yaw_rate_rad_s"] for log in opened])
    assert yaw_rate.max() > 9.0 and all(0 in log.frames["tick"] for log in opened)


def test_a_changed_constant_shows(monkeypatch):
    """The indicator must indicate."""
    monkeypatch.setattr(mbbr_setup, "BATTERY_SMOOTHING_RAD_S", mbbr_setup.BATTERY_SMOOTHING_RAD_S * 1.1)
    assert any(not replay(logs.open(path))[1].equal for path in FILES)
    name, (config, _) = next(iter(shipped_logs.wanted().items()))
    assert "duty" in shipped_logs.change(name, config, shipped_logs.LARGEST)
