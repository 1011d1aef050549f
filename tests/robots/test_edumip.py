"""The eduMIP in a whole dry run: the same session, loop, supervisor and fakes as the MBBR."""

import math

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt import frame
from mip_rt.config import scenario as scenarios
from mip_rt.lab import batch, bench
from mip_rt.log import open as open_log
from mip_rt.robots import edumip_setup
from mip_rt.supervisor import State

KEYS = {
    "robot", "estimator", "controller", "seed", "duration_s", "ticks", "rate_hz", "missed", "latency_us", "tilt_rms_rad", "tilt_max_rad",
    "ball_speed_rms_error_rad_s", "tilt_rms_error_rad", "position_error_max_m", "yaw_rate_mean_rad_s", "speed_mean_m_s", "fell", "faults",
    "log", "scheduling", "estimators",
}  # fmt: skip


def dry_run(folder, scenario="hold", seed=1, duration_s=12.0, **changes):
    changes.setdefault("estimator__shadows", "[]")
    with DryRun(folder, make_config("edumip", **changes), scenario, seed) as dry:
        return dry.run(duration_s)


def stands(report):
    return not report["fell"] and report["faults"] == [] and report["balanced_s"] > report["duration_s"] - 3.0


def test_every_estimator_runs_in_shadow_and_the_summary_keeps_its_keys(tmp_path):
    report = dry_run(tmp_path, estimator__shadows="[ekf, ekf_printed, planar_kf, complementary, complementary_kf, dmp, inertial_ekf]")
    assert KEYS <= set(report) and report["robot"] == "edumip" and stands(report)
    assert report["position_error_max_m"] < 0.02 and report["rate_hz"] == 200.0
    assert report["estimators"]["dmp_ekf"]["tilt_rms_error_rad"] < 0.006
    log = open_log(report["log"])
    assert log.damage == [] and "track_m" in log.config and log.frames["encoder_count"].shape[1] == 2
    assert log.header["estimate_names"][1] == "phi_rad"


@pytest.mark.parametrize("estimator", edumip_setup.ESTIMATORS)
def test_every_estimator_can_control(tmp_path, estimator):
    assert stands(dry_run(tmp_path, duration_s=8.0, estimator__control=estimator))


@pytest.mark.parametrize("changes", [
    {},
    {"dry_run__imu_misalignment_rad": "[0.0, 0.0175, 0.0175]"},
    {"dry_run__imu_position_error_m": "[0.002, 0.003, -0.002]"},
    {"realtime__rate_hz": "100"},
    {"dry_run__wheel_inertia_reading": "rotor", "dry_run__extra_delay_ticks": "1", "dry_run__friction": "1.5"},
])  # fmt: skip
def test_inertial_ekf_controls_while_turning_fast(tmp_path, changes):
    """A crooked IMU, one that is not where it is believed, late commands: half the error of a DMP (3 mrad) in spite of each."""
    report = dry_run(tmp_path, "spin-10-rad-s", duration_s=20.0, estimator__control="inertial_ekf", **changes)
    assert stands(report) and report["yaw_rate_mean_rad_s"] > 5.0
    assert report["tilt_rms_error_rad"] < 1.5e-3


def test_inertial_ekf_holds_through_spikes_and_a_jumping_attitude(tmp_path):
    """Its inputs are raw samples: a spike taken for a motion would throw the robot over; the DMP's attitude it reads only at the start."""
    events = [
        scenarios.Event(2.0, press="arm"),
        scenarios.Event(3.0, yaw_rate_hz=5.0 / (2.0 * math.pi)),
        scenarios.Event(5.0, fault="gyro_spike", parameters={"axis": "z", "size_rad_s": 15.0}),
        scenarios.Event(7.0, fault="gyro_spike", parameters={"axis": "x", "size_rad_s": -15.0}),
        scenarios.Event(9.0, fault="accel_spike", parameters={"axis": "z", "size_m_s2": 80.0}),
        scenarios.Event(11.0, fault="attitude_jump", parameters={"for_s": 0.5}),
    ]
    config = make_config("edumip", estimator__control="inertial_ekf", estimator__shadows="[]")
    with DryRun(tmp_path, config, scenarios.Scenario("spikes", "", 14.0, events)) as dry:
        report = dry.run(14.0)
    assert stands(report) and report["tilt_rms_error_rad"] < 1e-3 and report["tilt_max_rad"] < 0.06


@pytest.mark.parametrize("rate_hz", [100, 200])
@pytest.mark.parametrize("controller", ["lqr", "successive_loop", "pid"])
def test_every_controller_balances_at_both_rates(tmp_path, controller, rate_hz):
    report = dry_run(tmp_path, "spin-10-rad-s", duration_s=10.0, control__controller=controller, realtime__rate_hz=str(rate_hz))
    assert stands(report) and report["rate_hz"] == rate_hz and report["ticks"] == pytest.approx(10 * rate_hz, abs=2)
    assert report["missed"] == 0 and report["yaw_rate_mean_rad_s"] > 5.0


@pytest.mark.parametrize("controller", ["lqr", "successive_loop", "pid"])
def test_every_controller_holds_the_other_reading_of_the_wheel_inertia(tmp_path, controller):
    """At the highest rate, where it matters: with the paper's constant gain the successive loops fall within 10 s."""
    changes = {"control__controller": controller, "dry_run__wheel_inertia_reading": "rotor"}
    assert stands(dry_run(tmp_path, "spin-15-rad-s", duration_s=16.0, **changes))


@pytest.mark.parametrize("changes", [
    {"dry_run__wheel_inertia_reading": "rotor"},
    {"dry_run__wheel_inertia_reading": "rotor", "realtime__rate_hz": "100"},
    {"model__wheel_inertia_reading": "rotor", "dry_run__wheel_inertia_reading": "rigid"},
    {"motor__drive": "coast"},
    {"estimator__control": "ekf"},
    {"imu__mount_angle_rad": "-0.3", "estimator__control": "ekf"},
    {"dry_run__extra_delay_ticks": "2"},
    {"dry_run__battery_v": "6.6", "dry_run__model_error__motor": "0.9", "dry_run__model_error__mass": "1.1"},
])  # fmt: skip
def test_it_survives(tmp_path, changes):
    """The other reading of the wheel inertia, coasting, no DMP in the loop, a board mounted otherwise, late commands, a tired battery."""
    assert stands(dry_run(tmp_path, duration_s=9.0, **changes))


def test_fifteen_radians_a_second(tmp_path):
    report = dry_run(tmp_path, "spin-15-rad-s", seed=2)
    assert stands(report) and report["position_error_max_m"] < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["dmp_ekf", "inertial_ekf"])
def test_ten_seeds_of_a_minute(estimator):
    """Acceptance: never falls with full noise and IMU offset; the place is held within 2 cm."""
    overrides = {"estimator.shadows": "[]", "estimator.control": estimator}
    names = ("hold", "spin-5-rad-s", "spin-10-rad-s", "spin-15-rad-s")
    jobs = [(overrides, scenario, seed, 60.0, "edumip") for scenario in names for seed in range(1, 11)]
    for job, report in zip(jobs, batch.results(bench.work, jobs), strict=True):
        assert stands(report) and report["ticks"] == 12000, job
        assert job[1] != "hold" or report["position_error_max_m"] < 0.02, job


def test_lever_arm_is_what_the_filters_of_the_paper_lack(tmp_path):
    """Published complementary filter: 0.161 rad at 10 rad/s, explained by 16 mm; the EKF that knows of them must not see them."""
    report = dry_run(tmp_path, "spin-10-rad-s", duration_s=14.0, estimator__shadows="[ekf, complementary, planar_kf]")
    errors = {name: entry["tilt_rms_error_rad"] for name, entry in report["estimators"].items()}
    assert errors["ekf"] < 0.012 < 0.05 < errors["planar_kf"] and 0.11 < errors["complementary"] < 0.18
    blind = dry_run(tmp_path, "spin-10-rad-s", duration_s=14.0, estimator__shadows="[ekf]", estimator__lever_arm="false")
    assert blind["estimators"]["ekf"]["tilt_rms_error_rad"] > 5 * errors["ekf"]


def test_drives_and_turns_by_the_remote(tmp_path):
    """Stick forward drives along the heading, stick to the left turns: a square of driven sides must end near its start."""
    events = [scenarios.Event(2.0, press="arm")]
    for side in range(4):
        events.append(scenarios.Event(5.0 + 4.0 * side, speed_m_s=(0.2, 0.0)))
        events.append(scenarios.Event(7.0 + 4.0 * side, speed_m_s=(0.0, math.pi / 2.0 / 17.0 / 1.0)))
        events.append(scenarios.Event(8.0 + 4.0 * side, speed_m_s=(0.0, 0.0)))
    with DryRun(tmp_path, make_config("edumip", estimator__shadows="[]"), scenarios.Scenario("square", "", 25.0, events)) as dry:
        assert stands(dry.run(25.0))
        truth = dry.bench.world.truth_rows
        end = truth[dry.bench.world.truth_row]
        assert end["yaw_rad"] == pytest.approx(2.0 * math.pi, abs=0.1)
        assert end["way_m"] == pytest.approx(1.6, abs=0.05) and math.hypot(end["x_m"], end["y_m"]) < 0.1
        assert truth["x_m"].max() - truth["x_m"].min() > 0.3 and truth["y_m"].max() - truth["y_m"].min() > 0.3


def test_falls_on_its_back_and_stays_off_until_asked(tmp_path):
    with DryRun(tmp_path, make_config("edumip", estimator__shadows="[]")) as dry:
        dry.until(lambda: dry.state is State.BALANCING)
        dry.until(lambda: dry.session.supervisor.drive_scale >= 1.0)
        dry.bench.world.state[0].x[3] = -25.0  # a blow that no motor can catch
        dry.until(lambda: dry.state is State.FAULT, 2.0)
        assert dry.session.supervisor.fault.code == "tipped" and not dry.motors_on()
        assert dry.row["limits"] & frame.LIMIT_TIPPED
        for _ in range(400):
            dry.session.loop.tick()
        assert dry.state is State.FAULT and not dry.motors_on()
        assert dry.row["attitude_rad"][0] < -1.0


def test_soft_start_scales_the_command(tmp_path):
    with DryRun(tmp_path, make_config("edumip", estimator__shadows="[]")) as dry:
        dry.until(lambda: dry.state is State.BALANCING)
        dry.until(lambda: 0.2 < dry.session.supervisor.drive_scale < 0.9)
        row = dry.row
        wanted = row["drive_scale"] * (row["command_feedback"][0] + row["command_feedback"][1] + row["command_friction"][0])
        assert row["command_wheel"][0] == pytest.approx(wanted, abs=1e-9) and row["drive_scale"] < 1.0


def test_heading_reset_holds_the_present_heading(tmp_path):
    with DryRun(tmp_path, make_config("edumip", estimator__shadows="[]"), "hold") as dry:
        dry.until(lambda: dry.state is State.BALANCING)
        dry.session.loop.tick()
        dry.session.loop.tick()
        dry.bench.world.state[0].x[5] = 3.0  # twisted by hand
        for _ in range(30):
            dry.session.loop.tick()
        dry.session.supervisor.request_heading_reset()
        dry.session.loop.tick()
        dry.session.loop.tick()
        assert abs(dry.row["error"][2]) < 0.02


@pytest.mark.parametrize("estimator", edumip_setup.ESTIMATORS)
def test_no_sensor_word_brings_a_non_finite_duty(estimator):
    """Random packets, counts and batteries through the compiled step, engaged: every duty stays within one."""
    robot = edumip_setup.build(make_config("edumip", estimator__control=estimator, estimator__shadows="[]"))
    rng = np.random.default_rng(3)
    rows = np.zeros(3000, robot.layout.dtype)
    rows["request"], rows["drive_scale"], rows["imu_status"] = frame.REQUEST_ENGAGED, 1.0, rng.integers(0, 2, 3000)
    rows["imu_packet"] = rng.integers(0, 256, rows["imu_packet"].shape)
    rows["encoder_count"] = rng.integers(-(2**40), 2**40, rows["encoder_count"].shape)
    rows["battery_v"] = rng.choice([math.nan, 0.0, -1.0, 7.4, math.inf, 1e-300], 3000)
    rows["remote_velocity_m_s"] = rng.normal(size=(3000, 2)) * 1e6
    robot.attach(rows)
    for index in range(len(rows)):
        robot.step(index)
    assert np.isfinite(rows["duty"]).all() and np.abs(rows["duty"]).max() <= 1.0
    assert np.isfinite(rows["command_applied"]).all()
