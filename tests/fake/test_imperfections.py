"""What is wrong with a simulated robot on purpose is wrong by as much as its configuration says."""

import math

import numpy as np
import pytest
from helpers import felt_by_chip as chip
from helpers import make_config

from mip_rt.fake.world import World
from mip_rt.models import mbbr, mbbr_momentum

pytestmark = pytest.mark.armhf


def world(**changes):
    """Released, upright, at rest, without noise."""
    quiet = ("gyro_noise_rad_s", "accel_noise_m_s2", "dmp_noise_rad", "vibration_torque_n_m", "vibration_accel_m_s2")
    made = World(make_config(**{f"dry_run__{name}": "0" for name in quiet}, dry_run__gyro_bias_rad_s="[0, 0, 0]", **changes), 1)
    made.state[0].held = 0
    made.state[0].x[:] = 0.0
    return made


def momentum(made):
    """(l_x, l_y) of the robot in the world, rad/s."""
    model, p, x = made.parameters[0].model, np.zeros(1, mbbr_momentum.PARAMETERS).view(np.recarray)[0], np.asarray(made.state[0].x)
    mbbr_momentum.configure(p, model)
    return np.array(mbbr_momentum.momentum(p, 1.0, x[0], x[1], mbbr.gyro(x), x[8], x[9]))


def rolled(ticks=4, **changes):
    """Momentum before and after a robot rolled freely, with what its lean alone would have added."""
    made = world(**changes)
    s = made.state[0]
    s.x[8:10] = 5.0, -5.0
    before, lean = momentum(made), np.zeros(2)
    p = np.zeros(1, mbbr_momentum.PARAMETERS).view(np.recarray)[0]
    mbbr_momentum.configure(p, made.parameters[0].model)
    for _ in range(ticks):
        earlier = np.sin(s.x[:2])
        made.advance(np.zeros(3), False)
        lean += 0.0025 * p.gravity_s2 * (earlier + np.sin(s.x[:2]))
    return before, momentum(made) - lean


def test_rolling_resistance_takes_its_torque_from_the_momentum_and_friction_does_not():
    model = mbbr.parameters()[0]
    ball = model.ball_inertia_kg_m2 + 0.7 * 0.032**2 + 0.55 * 0.1 * 0.032
    before, after = rolled()
    assert after == pytest.approx(before, abs=2e-3)
    before, after = rolled(dry_run__rolling_resistance_n_m="0.01")
    assert after - before == pytest.approx(np.array([-0.01, 0.01]) * 0.02 / ball, rel=0.03)


def test_an_input_error_moves_the_robot_as_that_command_would():
    made = world(dry_run__input_error="[0.1, 0.0, 0.0]", dry_run__friction="0")
    made.advance(np.zeros(3), False)
    x = np.zeros(10)
    expected = mbbr.acceleration(x, np.array([0.1, 0.0, 0.0]), mbbr.parameters(damping_n_m_s_rad=1e-12)[0])
    assert np.asarray(made.state[0].x)[[5, 8]] == pytest.approx(0.005 * expected[[0, 3]], rel=0.02)


def test_the_gyro_drifts_with_time():
    made = world(dry_run__gyro_drift_rad_s2="[0.01, 0.0, -0.02]", dry_run__friction="0")
    made.hold()
    made.lean_rad = (0.0, 0.0)
    rates = []
    for _ in range(400):
        made.advance(np.zeros(3), False)
        rates.append(chip(made)[1])
    assert np.mean(rates[-118:], axis=0)[2] == pytest.approx(-0.02 * (2.0 - 59 * 0.005), abs=2e-3)


def test_roller_ripple_bends_the_counts_and_not_the_ball():
    runs = []
    for ripple in ("0", "0.005"):
        made = world(dry_run__roller_ripple_rad=ripple, dry_run__friction="0")
        made.state[0].x[8] = 20.0
        counts = []
        for _ in range(40):
            made.advance(np.zeros(3), False)
            counts.append(made.counts.copy())
        runs.append((np.array(counts), made.truth[made.truth_row].copy()))
    wheel_rad = np.abs(runs[1][0] - runs[0][0]) * 2 * math.pi / 1080 * 0.0125 / 0.032
    assert runs[0][1] == runs[1][1] and wheel_rad.max() == pytest.approx(0.005, abs=0.003)


def test_an_imu_out_of_place_feels_the_lean_turn():
    forces = []
    for error in ("[0.0, 0.0, 0.0]", "[0.0, 0.0, 0.02]"):
        made = world(dry_run__imu_position_error_m=error, dry_run__friction="0")
        made.state[0].x[0] = 0.2
        made.advance(np.zeros(3), False)
        forces.append(chip(made)[0])
    s = made.state[0]
    assert forces[1][1] - forces[0][1] == pytest.approx(-0.02 * s.acceleration[0], rel=0.05)
