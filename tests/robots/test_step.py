"""What replay relies on: the step depends on nothing but its inputs and its state, and writes every output in every tick."""

import numpy as np
import pytest
from helpers import make_config

from mip_rt import frame, robots
from mip_rt.hardware.imu_status import IMU_BUS_ERROR, IMU_OK

pytestmark = pytest.mark.armhf
TICKS = 60
REQUESTS = (0, frame.REQUEST_ENGAGED, frame.REQUEST_ENGAGED | frame.REQUEST_HEADING_RESET)


SHADOWS = {"mbbr": "[ekf, kf, kf_printed]", "edumip": "[planar_kf, complementary_kf, dmp, inertial_ekf, pendulum_ekf, two_state_ekf]"}


@pytest.fixture(scope="module", params=robots.NAMES)
def config(request):
    return make_config(request.param, estimator__shadows=SHADOWS[request.param])


def build(config):
    return robots.setup(config.robot).build(config)


def inputs(layout, seed=1):
    """Rows with inputs of every kind: engaged or not, with and without a usable packet, jumping encoders, bad battery."""
    random = np.random.default_rng(seed)
    rows = np.zeros(TICKS, layout.dtype)
    rows["tick"] = np.arange(TICKS)
    rows["request"] = random.choice(REQUESTS, TICKS, p=(0.3, 0.6, 0.1))
    rows["imu_status"] = random.choice((IMU_OK, IMU_BUS_ERROR), TICKS, p=(0.8, 0.2))
    rows["imu_packet"] = random.integers(0, 256, rows["imu_packet"].shape)
    rows["imu_packet"][:, 0] = 63
    rows["encoder_count"] = random.integers(-30, 30, rows["encoder_count"].shape).cumsum(axis=0)
    rows["encoder_count"][40:] += 100_000
    rows["battery_v"] = random.choice((7.4, 8.1, np.nan, 0.0), TICKS)
    rows["remote_velocity_m_s"] = random.normal(size=(TICKS, 2))
    rows["remote_yaw_rate_rad_s"] = random.normal(size=TICKS)
    rows["gyro_bias_rad_s"] = 0.01
    rows["drive_scale"] = 1.0
    return rows


def run(robot, rows):
    robot.attach(rows)
    for index in range(len(rows)):
        robot.step(index)
    return rows


def test_every_output_is_written_in_every_tick(config):
    """A field that a way through the step leaves alone would show what was true one turn of the ring ago."""
    layout = build(config).layout
    clean = run(build(config), inputs(layout))
    dirty = inputs(layout)
    for name in layout.step_outputs:
        dirty[name] = np.nan if dirty[name].dtype.kind == "f" else -1
    run(build(config), dirty)
    for name in layout.step_outputs:
        slots = (slice(None), slice(0, len(build(config).names))) if name in ("estimates", "estimator_flags") else ()
        assert clean[name][slots].tobytes() == dirty[name][slots].tobytes(), name


def test_a_step_returns_its_conditions(config):
    """On 32-bit ARM a plain integer has 32 bits: alarms, which begin at bit 44, and the higher limits would be lost, and the robot would run on."""
    robot = build(config)
    rows = inputs(robot.layout)
    rows["edge_ns"] = 1 + 50_000_000 * np.arange(TICKS)  # a tenth of the rate
    robot.attach(rows)
    for index in range(TICKS):
        row = rows[index]
        found = robot.step(index)
        assert found == int(row["imu_status"]) << frame.STATUS_AT | int(row["limits"]) << frame.LIMITS_AT | int(row["alarms"]) << frame.ALARMS_AT
    assert rows["alarms"].any() and rows["limits"].max() >= 1 << 12


def test_step_changes_no_input(config):
    """An input that the step overwrote would be recorded as what it became, and replay from there."""
    robot = build(config)
    rows = run(robot, inputs(robot.layout))
    for name in robot.layout.step_inputs:
        assert rows[name].tobytes() == inputs(robot.layout)[name].tobytes(), name


def test_rehearsal_leaves_no_trace(config):
    """The first tick of a run that was rehearsed must be that of a replay that was not."""
    robot = build(config)
    rows = inputs(robot.layout)
    robot.attach(rows)
    before = robot.persistence.present(), rows.tobytes(), robot.estimator_states.tobytes()
    robot.rehearse()
    assert (robot.persistence.present(), rows.tobytes(), robot.estimator_states.tobytes()) == before


@pytest.mark.parametrize("tick", range(0, TICKS - 1, 7))
def test_the_kept_state_is_all_that_the_next_tick_needs(config, tick):
    """A persistent number that is taken for scratch would make a replay from a state row drift away."""
    robot = build(config)
    whole = inputs(robot.layout)
    robot.attach(whole)
    for index in range(tick + 1):
        robot.step(index)
    kept = robot.persistence.present()
    for index in range(tick + 1, TICKS):
        robot.step(index)
    resumed = build(config)
    run(resumed, inputs(resumed.layout, seed=9))  # other scratch, other history
    resumed.persistence.restore(kept)
    rows = inputs(resumed.layout)[tick + 1 :]
    run(resumed, rows)
    assert rows.tobytes() == whole[tick + 1 :].tobytes()
    assert resumed.persistence.present() == robot.persistence.present()


def test_parts_are_the_memory_itself(config):
    """A copy would keep the state of the start for ever."""
    robot = build(config)
    before = robot.persistence.present()
    rows = inputs(robot.layout)
    run(robot, rows)
    assert robot.persistence.present() != before and sum(part.nbytes for part in robot.persistence.parts) == robot.persistence.size
    robot.command_in_force[:] = 0.25
    assert set(robot.state[0].applied) == {0.25}
