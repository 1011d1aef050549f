"""The simulated eduMIP: physics, sensors and the board's mounting agree with the model."""

import math
import struct

import numpy as np
import pytest
from helpers import make_config

from mip_rt.fake.world import World
from mip_rt.models import mip
from mip_rt.robots import edumip_setup

pytestmark = pytest.mark.armhf
QUIET = dict(
    dry_run__gyro_noise_rad_s="0", dry_run__accel_noise_m_s2="0", dry_run__gyro_bias_rad_s="[0, 0, 0]", dry_run__dmp_noise_rad="0",
    dry_run__dmp_lag_s="0", dry_run__dmp_yaw_drift_rad_s="0", dry_run__backlash_rad="0",
)  # fmt: skip


def world(**changes):
    made = World(make_config("edumip", **{**QUIET, **changes}), 1)
    made.state[0].held = 0
    return made


def test_energy_is_conserved_with_the_drivers_asleep_and_no_friction():
    made = world(dry_run__friction="0")
    s, p = made.state[0], made.parameters[0].model
    s.x[:6] = [0.3, 0.0, 0.2, 0.0, 3.0, 6.0]
    before = mip.energy(s.x[:6], p)
    for _ in range(40):
        made.advance(np.zeros(2), False)
    assert mip.energy(s.x[:6], p) == pytest.approx(before, rel=1e-6)


def test_motors_give_the_torque_of_the_model():
    """k1 and k2 of the model section and the motor section say the same: a duty of u is a command of u at the nominal voltage."""
    made = world(dry_run__friction="0", dry_run__battery_v="8.0", dry_run__battery_resistance_ohm="0", dry_run__actuation_delay_ms="0",
                 dry_run__battery_fade_v_s="0")  # fmt: skip
    s, p = made.state[0], made.parameters[0].model
    s.x[:6] = [0.05, 0.0, 0.2, 0.3, 5.0, 4.0]
    x, u = np.array(s.x[:6]), np.array([0.25, 0.1])
    made.advance(np.array([0.35, 0.15]), True)
    for _ in range(5):
        k1 = mip.derivative(x, u, p)
        k2 = mip.derivative(x + 5e-4 * k1, u, p)
        x = x + 1e-3 * k2
    assert np.asarray(s.x[:6]) == pytest.approx(x, abs=0.03)  # 2 % of the change; the current is held for 1 ms


@pytest.mark.parametrize("mount", ["0.49", "0.0", "-0.3"])
def test_step_sees_what_the_world_does_however_the_board_is_mounted(mount):
    """Packet to body axes is the inverse of body axes to packet: a sign slip in the mounting angle would be a lean of its own."""
    config = make_config("edumip", **QUIET, imu__mount_angle_rad=mount)
    made = World(config, 1)
    made.state[0].held = 0
    robot = edumip_setup.build(config)
    rows = np.zeros(40, robot.layout.dtype)
    robot.attach(rows)
    s = made.state[0]
    s.x[:6] = [0.2, 0.0, 0.4, 0.5, 2.0, 4.0]
    for k in range(40):
        made.advance(np.array([0.2, 0.1]), True)
        row = rows[k : k + 1]
        row["imu_packet"][0] = np.frombuffer(made.packet, np.uint8)
        row["encoder_count"], row["imu_status"], row["battery_v"] = made.counts, 1, 7.8
        robot.step(k)
    truth, row, p = made.truth[made.truth_row], rows[39], made.parameters[0].model
    x = np.array(s.x[:6])
    assert row["attitude_rad"] == pytest.approx([truth.pitch_rad, 0.0, truth.yaw_rad], abs=1e-6)
    assert row["gyro_rad_s"] == pytest.approx(mip.gyro(x), abs=0.002)
    assert row["acceleration_m_s2"] == pytest.approx(mip.accelerometer(x, np.array(s.acceleration), p), abs=0.2)
    assert row["phi_rad"] - rows[20]["phi_rad"] == pytest.approx(0.5 * (made.counts @ [-1, 1] - rows[20]["encoder_count"] @ [-1, 1]) * 2 * math.pi / 2135)
    started = np.array([made.counts[0] * -1, made.counts[1]]) * 2 * math.pi / 2135
    assert started == pytest.approx([x[1] + x[2], x[1] - x[2]], abs=0.004)


def test_accelerometer_registers_hold_specific_force_with_the_lever_arm():
    made = world(imu__mount_angle_rad="0", imu__mounting="[[1, 0, 0], [0, 1, 0], [0, 0, 1]]")
    s = made.state[0]
    s.x[:6] = [0.0, 0.0, 0.0, 0.0, 0.0, 10.0]
    made.advance(np.zeros(2), False)
    _, y, z = struct.unpack(">3h", bytes(made.raw[:6]))
    scale = 8 * 9.80665 / 32768
    # The axis of turning is 16 mm behind an IMU that sits in front: the chip feels the support push it backwards, towards +y.
    assert y * scale == pytest.approx(0.016 * s.x[5] ** 2, rel=0.1) and z * scale == pytest.approx(9.8, abs=0.1)


def test_the_plant_may_have_the_other_reading_of_the_wheel_inertia():
    rigid, rotor = (world(dry_run__wheel_inertia_reading=name).parameters[0].model.rotor_inertia_kg_m2 for name in ("rigid", "rotor"))
    assert rigid == 0.0 and rotor == pytest.approx(4.924e-5)
    followed = world(model__wheel_inertia_reading="rotor").parameters[0].model.rotor_inertia_kg_m2
    assert followed == rotor
