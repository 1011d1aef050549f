"""The simulated world: physics, sensors and wiring agree with the models and with each other."""

import math
import struct

import numpy as np
import pytest
from helpers import felt_by_chip as chip
from helpers import make_config

from mip_rt.fake.world import World
from mip_rt.models import mbbr

pytestmark = pytest.mark.armhf
QUIET = dict(
    dry_run__gyro_noise_rad_s="0", dry_run__accel_noise_m_s2="0", dry_run__gyro_bias_rad_s="[0, 0, 0]", dry_run__dmp_noise_rad="0",
    dry_run__dmp_lag_s="0", dry_run__dmp_yaw_drift_rad_s="0", dry_run__vibration_torque_n_m="0", dry_run__vibration_accel_m_s2="0",
)  # fmt: skip


def world(seed=1, **changes):
    made = World(make_config(**{**QUIET, **changes}), seed)
    made.state[0].held = 0
    made.state[0].x[:] = 0.0
    return made


def truth(made):
    return made.truth[made.truth_row]


def quaternion(made):
    return np.array(struct.unpack(">4i", bytes(made.packet[:16]))) / 2**30


def test_same_seed_same_world():
    runs = []
    for seed in (3, 3, 4):
        made = World(make_config(), seed)
        made.release()
        for k in range(200):
            made.advance(np.array([0.1, -0.05 * math.sin(k / 9), 0.02]), True)
        runs.append((bytes(made.packet), bytes(made.raw), made.counts.copy().tolist(), float(truth(made).x_m)))
    assert runs[0] == runs[1] != runs[2]


def test_energy_is_kept_without_friction_and_motors():
    made = world(dry_run__friction="0")
    s, p = made.state[0], made.parameters[0].model
    s.x[:] = [0.1, -0.05, 0.2, 0, 0, 0.3, -0.2, 4.0, 2.0, -3.0]
    before = mbbr.energy(s.x, p)
    for _ in range(30):
        made.advance(np.zeros(3), False)
    assert mbbr.energy(s.x, p) == pytest.approx(before, rel=1e-6)


def test_standing_still_reads_gravity_upwards():
    made = World(make_config(**QUIET), 1)
    made.lean_rad = (0.3, 0.0)
    made.hold()
    forces = []
    for _ in range(400):
        made.advance(np.zeros(3), False)
        forces.append(chip(made)[0])
    assert np.mean(forces, axis=0) == pytest.approx([0, 9.8 * math.sin(0.3), 9.8 * math.cos(0.3)], abs=0.02)


def test_a_crooked_imu_is_crooked_for_accelerometer_and_dmp_alike():
    made = World(make_config(**QUIET, dry_run__imu_misalignment_rad="[0.03, -0.02, 0.0]"), 1)
    made.lean_rad = (0.0, 0.0)
    made.hold()
    leans = []
    for _ in range(400):
        made.advance(np.zeros(3), False)
        (x, y, z), (w, i, j, k) = chip(made)[0], quaternion(made)
        leans.append([math.atan2(y, z), -math.asin(x / 9.8), math.atan2(2 * (w * i + j * k), 1 - 2 * (i * i + j * j)), math.asin(2 * (w * j - k * i))])
    by_force, by_dmp = np.mean(leans, axis=0)[:2], np.mean(leans, axis=0)[2:]
    assert by_force == pytest.approx([-0.03, 0.02], abs=1e-3) and by_dmp == pytest.approx(by_force, abs=1e-3)


def test_quaternion_and_gyro_follow_the_true_attitude():
    made = world()
    s = made.state[0]
    s.x[:3] = 0.1, -0.2, 1.0
    s.x[5:8] = 0.5, 0.3, -2.0
    made.advance(np.zeros(3), False)
    w, x, y, z = quaternion(made)
    assert w * w + x * x + y * y + z * z == pytest.approx(1.0, abs=1e-8)
    angles = [math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), math.asin(2 * (w * y - z * x)), math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))]
    t = truth(made)
    assert angles == pytest.approx([t.roll_rad, t.pitch_rad, t.yaw_rad], abs=1e-6)
    assert chip(made)[1] == pytest.approx(mbbr.gyro(s.x), abs=0.002)


def test_encoders_count_the_ball_relative_to_the_body():
    made = world(dry_run__friction="0")
    s = made.state[0]
    s.x[5:10] = 0.0, 0.0, 0.0, 20.0, -10.0
    for _ in range(20):
        made.advance(np.zeros(3), False)
    config = make_config()
    angles = made.counts * np.array(config.encoders.signs) * 2 * math.pi / 1080
    T, ratio = np.asarray(made.parameters[0].body_from_wheel), 0.0125 / 0.032
    assert ratio * T @ angles == pytest.approx(np.asarray(s.body_angle_rad), abs=0.01)
    assert abs(s.body_angle_rad[0]) > 1.0


def test_duty_takes_effect_after_the_actuation_delay():
    def first_motion(delay_ms, ticks):
        made = world(dry_run__actuation_delay_ms=str(delay_ms), dry_run__extra_delay_ticks=str(ticks), dry_run__friction="0")
        motion = []
        for _ in range(5):
            made.advance(np.array([0.5, 0.5, 0.5]), True)
            motion.append(abs(truth(made).yaw_rate_rad_s))
        return motion

    now, later, much_later = first_motion(0, 0), first_motion(3, 0), first_motion(0, 2)
    assert now[0] > later[0] > 0.0
    assert much_later[1] < 1e-9 < much_later[2]


def test_disabled_drivers_drive_nothing():
    made = world(dry_run__friction="0")
    for _ in range(5):
        made.advance(np.array([0.5, 0.5, 0.5]), False)
    assert abs(truth(made).yaw_rate_rad_s) < 1e-9


def test_battery_sags_with_current():
    made = world()
    made.advance(np.zeros(3), True)
    idle = made.battery_raw
    for _ in range(3):
        made.advance(np.ones(3), True)
    assert made.battery_raw < idle
    volts = idle * 1.8 / 4095 * 11.0 - 0.1
    assert volts == pytest.approx(7.9, abs=0.01)


def test_vibration_frequency_grows_with_drive_speed():
    """The strongest line of the ball's acceleration moves in proportion to the ball's speed (dissertation Fig. 6.24)."""
    lines = []
    for speed in (4.0, 8.0):
        made = world(dry_run__vibration_accel_m_s2="3", dry_run__friction="0")
        s, samples = made.state[0], []
        for _ in range(800):
            s.x[:3] = 0.0
            s.x[5:10] = 0.0, 0.0, 0.0, speed, 0.0
            made.advance(np.zeros(3), False)
            samples.append(chip(made)[0][0])
        spectrum = np.abs(np.fft.rfft(np.array(samples) - np.mean(samples)))
        lines.append(np.argmax(spectrum))
    assert lines[1] == pytest.approx(2 * lines[0], rel=0.15)
    at_0_2_m_s = lines[0] * 2 * math.pi / 4.0 * (0.2 / 0.032) / 4.0
    assert at_0_2_m_s == pytest.approx(39.1, rel=0.15)


def test_non_finite_and_oversized_duties_are_no_torque():
    made = world(dry_run__friction="0")
    for _ in range(5):
        made.advance(np.array([math.nan, math.inf, 7.0]), True)
    assert np.isfinite(made.state[0].x).all() and abs(truth(made).yaw_rate_rad_s) < 1e-9


def test_a_fallen_robot_lies_until_it_is_picked_up():
    made = world()
    made.state[0].x[0] = 1.2
    for _ in range(200):
        made.advance(np.zeros(3), False)
    assert made.state[0].held == 2
    made.release()
    assert made.state[0].held == 2
    made.hold()
    made.release()
    assert made.state[0].held == 0


def test_unknown_parameter_is_refused():
    with pytest.raises(KeyError):
        world().set("batery_v", 6.0)
