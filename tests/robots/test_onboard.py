"""Both robots without the DMP: they balance, know their lean, start anew after gaps, and replay."""

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt import log as logs
from mip_rt.config import scenario as scenarios
from mip_rt.config.scenario import Event, Scenario
from mip_rt.log.replay import replay
from mip_rt.supervisor import State

RUNS = [("mbbr", "drive"), ("mbbr", "drive-spin-1.5"), ("edumip", "drive"), ("edumip", "spin-15-rad-s")]


def config(robot, **changes):
    return make_config(robot, imu__attitude="onboard", imu__dmp_image="/nowhere/dmp.bin", **{"estimator__shadows": "[ekf]", **changes})


@pytest.mark.parametrize(("robot", "scenario"), RUNS)
def test_balances_without_the_dmp_and_replays(robot, scenario, tmp_path):
    """The lean of the filter is worth the DMP's (3 mrad in the dry run), and the log explains it bit for bit, also from a state row on."""
    found = scenarios.load(scenario)
    with DryRun(tmp_path, config(robot), found, seed=2) as dry:
        summary = dry.run(20.0)
    assert not summary["fell"] and not summary["faults"] and summary["balanced_s"] > 16.0
    assert summary["tilt_rms_error_rad"] < 1.2 * make_config(robot).dry_run.dmp_noise_rad * 1.05
    log = logs.open(summary["log"])
    assert not log.frames["imu_packet"][:, :16].any() and log.frames["quaternion"].any()
    rerun, comparison = replay(log)
    assert comparison.exact and rerun.skipped == 0 and comparison.rows == len(log.frames)


@pytest.mark.parametrize("robot", ["mbbr", "edumip"])
def test_other_range_and_rate(robot, tmp_path):
    """Only the DMP is bound to 2000 deg/s."""
    changes = {"realtime__rate_hz": "100"} if robot == "edumip" else {"imu__gyro_range_dps": "500"}
    with DryRun(tmp_path, config(robot, **changes)) as dry:
        summary = dry.run(8.0)
    assert not summary["fell"] and summary["balanced_s"] > 4.0 and summary["tilt_rms_error_rad"] < 0.006


def test_attitude_is_right_again_after_a_gap_in_the_hand(tmp_path):
    """Rates that nobody saw: an attitude that was carried on over 0.3 s of silence would be wrong until the accelerometer has pulled it back."""
    events = [Event(3.0, fault="imu_silent", parameters={"for_s": 0.3})]
    with DryRun(tmp_path, config("mbbr"), Scenario("gap", "", 9.0, events)) as dry:
        dry.until(lambda: dry.state is State.FAULT, 5.0)
        world = dry.bench.world
        world.state[0].hand_rad[:] = (0.2, -0.1)
        dry.until(lambda: dry.session.loop.ticks > 900, 3.0)
        assert np.asarray(dry.row["attitude_rad"][:2]) == pytest.approx(np.asarray(world.state[0].x[:2]), abs=0.02)
