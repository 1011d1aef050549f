"""The simulated eduMIP, compiled: exact plant and friction for one IMU sample; the rest is in `fake.plant`."""

import math

import numpy as np

from mip_rt.compiled import entry, njit, records_at
from mip_rt.fake import plant, usual_sample
from mip_rt.models import friction, mip
from mip_rt.models.mounting import about_axle
from mip_rt.robots.edumip_setup import imu_position, model_parameters

WHEELS = 2
LEAN_RATE = 3  # place of the lean's rate in STATE.x

PARAMETERS = np.dtype(
    [
        ("model", mip.PARAMETERS),
        ("coulomb_n_m", "f8"),  # a wheel
        ("viscous_n_m_s_rad", "f8"),
        ("mount_angle_rad", "f8"),
        *plant.parameter_fields(WHEELS),
    ],
    align=True,
)
TRUTH = np.dtype(
    [
        ("time_s", "f8"),
        ("pitch_rad", "f8"),
        ("yaw_rad", "f8"),
        ("pitch_rate_rad_s", "f8"),
        ("yaw_rate_rad_s", "f8"),
        ("wheel_rate_rad_s", "f8"),  # against the ground
        ("way_m", "f8"),  # along the heading
        ("x_m", "f8"),
        ("y_m", "f8"),
        ("velocity_x_m_s", "f8"),
        ("velocity_y_m_s", "f8"),
        ("battery_v", "f8"),
    ],
    align=True,
)
STATE = np.dtype(
    [
        *plant.state_fields(WHEELS, 8, 3),  # x = [pitch, phi, yaw, their rates, x_m, y_m]
        ("torque", "f8", (2,)),  # of the motors, held during a 1 ms step
        ("rate2", "f8", (2,)),
        ("a3", "f8", (3,)),
    ],
    align=True,
)


@njit
def _derivative(p, s, x, out):
    rate = s.rate2
    mip.encoder_rate_into(x, p.model, rate)
    right = s.torque[0] + friction.torque(rate[0], p.coulomb_n_m, p.viscous_n_m_s_rad)
    left = s.torque[1] + friction.torque(rate[1], p.coulomb_n_m, p.viscous_n_m_s_rad)
    mip.acceleration_from_torque(x, right + left, right - left, p.model, s.a3)
    for i in range(3):
        out[i] = x[3 + i]
        out[3 + i] = s.a3[i]
    speed = p.model.wheel_radius_m * (x[3] + x[4])
    out[6] = speed * math.sin(x[2])  # forward is -y in body axes
    out[7] = -speed * math.cos(x[2])


@njit
def _motors(p, s, slot):
    """Torques of the motors at delay slot `slot`, held for one step."""
    rate = s.rate2
    mip.encoder_rate_into(s.x, p.model, rate)
    for i in range(2):
        s.torque[i] = p.torque_constant_n_m_a * plant.motor_current(p, s, slot, i, rate[i])
    plant.drain_battery(p, s, slot)


@njit
def _rk4(p, s, dt):
    x = s.x
    k = s.k
    _derivative(p, s, x, k[0])
    for i in range(3):
        s.acceleration[i] = s.a3[i]
    for stage in range(1, 4):
        h = dt if stage == 3 else 0.5 * dt
        for i in range(8):
            s.trial[i] = x[i] + h * k[stage - 1, i]
        _derivative(p, s, s.trial, k[stage])
    for i in range(8):
        x[i] += dt / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


@njit
def _in_hand(s):
    """Held by the operator, or lying: the wheels stand still."""
    x = s.x
    x[3] = 0.0
    x[4] = 0.0
    x[5] = 0.0
    if s.held == 1:
        tremor = 2.0 * math.pi * 1.7
        x[0] = s.hand_rad[0] + 0.002 * math.sin(tremor * s.time_s)
        x[3] = 0.002 * tremor * math.cos(tremor * s.time_s)
    for i in range(3):
        s.acceleration[i] = 0.0


@njit
def _sensors(p, s, normal):
    rate = s.v3
    force = s.w3
    mip.gyro_into(s.x, rate)
    mip.accelerometer_into(s.x, s.acceleration, p.model, force)
    plant.inertial_sensors(p, s, rate, force, normal)
    plant.dmp(p, s, s.x[0] - p.mount_angle_rad, 0.0, s.x[2], normal, plant.SUBSTEPS * 0.001)
    turn = 0.5 * p.model.track_m / p.model.wheel_radius_m * s.x[2]
    plant.encoder(p, s, 0, s.x[1] + turn)
    plant.encoder(p, s, 1, s.x[1] - turn)


@njit
def _tell_truth(p, s, truth):
    x = s.x
    r = p.model.wheel_radius_m
    truth.time_s = s.time_s
    truth.pitch_rad = x[0]
    truth.yaw_rad = x[2]
    truth.pitch_rate_rad_s = x[3]
    truth.yaw_rate_rad_s = x[5]
    truth.wheel_rate_rad_s = x[3] + x[4]
    truth.way_m = r * (x[0] + x[1])
    truth.x_m = x[6]
    truth.y_m = x[7]
    truth.velocity_x_m_s = r * truth.wheel_rate_rad_s * math.sin(x[2])
    truth.velocity_y_m_s = -r * truth.wheel_rate_rad_s * math.cos(x[2])
    truth.battery_v = s.battery_v


@njit
def advance_records(p, s, normal, duty, enabled, truth):
    """One sample of 5 ms on records; see `advance`."""
    plant.take_duty(p, s, duty, enabled)
    dt = 0.001
    for step in range(plant.SUBSTEPS):
        s.time_s += dt
        if s.held != 0:
            _in_hand(s)
            continue
        _motors(p, s, plant.delay_slot(p, step))
        _rk4(p, s, dt)
        if not abs(s.x[0]) <= p.tip_limit_rad and not math.cos(s.x[0]) > math.cos(p.tip_limit_rad):
            s.held = 2
    if s.held != 0:
        s.battery_v = p.battery_v - p.battery_fade_v_s * s.time_s
    _sensors(p, s, normal)
    _tell_truth(p, s, truth)


@entry(PARAMETERS, STATE, np.dtype("f8"), np.dtype("f8"), "int64", TRUTH, "int64")
def advance(parameters, state, normal, duty, enabled, truth, row):
    """Moves the world by one IMU sample; arguments as `fake.mbbr_plant.advance`, two wheels."""
    advance_records(parameters[0], state[0], normal, duty, enabled, truth[row])


@entry("uintp", "uintp", "int64", "uintp", "int64")
def sample(parts_at, normals_at, row, line_at, due_ns):
    """The whole of a usual sample; as `fake.mbbr_plant.sample`, on this plant's records."""
    parts = records_at(parts_at, 1, usual_sample.PARTS)[0]
    enabled = usual_sample.begin(parts, due_ns)
    if enabled < 0:
        return np.int64(usual_sample.UNUSUAL)
    parameters, state = records_at(parts.parameters, 1, PARAMETERS)[0], records_at(parts.state, 1, STATE)[0]
    normal, duty = records_at(normals_at, plant.NORMALS, np.float64), records_at(parts.duty, WHEELS, np.float64)
    advance_records(parameters, state, normal, duty, enabled, records_at(parts.truth, row + 1, TRUTH)[row])
    return usual_sample.end(parts, line_at, due_ns)


def configure(p, config) -> None:
    """The eduMIP's own parameters, from model, friction, imu and dry_run sections."""
    dry = config.dry_run
    error = dry.model_error
    reading = config.model.wheel_inertia_reading if dry.wheel_inertia_reading == "model" else dry.wheel_inertia_reading
    true = model_parameters(config, reading)[0]
    for name in ("body_mass_kg", "wheel_mass_kg"):
        true[name] *= error.mass
    for name in ("body_inertia_kg_m2", "wheel_inertia_kg_m2", "rotor_inertia_kg_m2"):
        true[name] = np.asarray(true[name]) * error.inertia
    true.com_height_m *= error.com_height
    true.imu_position_m[:] = imu_position(config) + np.array(dry.imu_position_error_m)
    true.variant = mip.EXACT
    p.model = true
    p.coulomb_n_m = config.friction.coulomb_n_m * error.friction * dry.friction
    p.viscous_n_m_s_rad = config.friction.viscous_n_m_s_rad * error.friction * dry.friction
    p.mount_angle_rad = config.imu.mount_angle_rad
    p.chip_from_body[:] = (about_axle(config.imu.mount_angle_rad) @ np.array(config.imu.mounting, float)).T


def hold(s, lean_rad) -> None:
    """In the operator's hands at this lean; the wheels keep their angle against the body."""
    s.hand_rad[0] = s.x[0] = lean_rad
