"""The simulated MBBR, compiled: exact plant, friction and roller vibration for one IMU sample; the rest is in `fake.plant`.

Per sample of 5 ms: five RK4 steps of 1 ms of the exact model (variant N), the wheels' currents from the drive/coast (or brake)
equations at the present wheel speeds and battery voltage, Coulomb and viscous friction inside the integrator; then the sensors.

Vibration. The rollers of the double-row omniwheels hand over to each other as the ball rolls; the dissertation (section 6.4.4,
Fig. 6.24) finds lines in the ball speed's spectrum whose frequency grows with the drive rate, 39.1 rad/s at 0.3 m/s being the highest, and a 17 to 25 rad/s
response at low speed. Here each wheel drives the ball with a torque of amplitude proportional to its speed (up to a limit) at
`rollers_per_ball_turn` times the ball's angle about that wheel's axis; the published lines are
at 4.2 to 4.5 times the ball's rate.
"""

import math

import numpy as np

from mip_rt.compiled import entry, njit, records_at
from mip_rt.fake import plant, usual_sample
from mip_rt.models import friction, mbbr
from mip_rt.robots.robot import orthonormal

WHEELS = 3
LEAN_RATE = 5  # place of the roll rate in STATE.x

PARAMETERS = np.dtype(
    [
        ("model", mbbr.PARAMETERS),
        ("body_from_wheel", "f8", (3, 3)),
        ("coulomb_n_m", "f8"),
        ("viscous_n_m_s_rad", "f8"),
        *plant.parameter_fields(WHEELS),
        ("vibration_torque_n_m", "f8"),  # amplitude at 10 rad/s of the wheel's ball-side speed
        ("vibration_accel_m_s2", "f8"),
        ("rollers_per_ball_turn", "f8"),
        ("roller_ripple_rad", "f8"),  # ball-side
        ("input_error_n_m", "f8", (3,)),
        ("rolling", "f8", (2,)),  # what the floor's rolling resistance takes from the tilt rates and the ball's, rad/s^2
    ],
    align=True,
)
TRUTH = np.dtype(
    [
        ("time_s", "f8"),
        ("roll_rad", "f8"),
        ("pitch_rad", "f8"),
        ("yaw_rad", "f8"),
        ("roll_rate_rad_s", "f8"),
        ("pitch_rate_rad_s", "f8"),
        ("yaw_rate_rad_s", "f8"),
        ("ball_rate_x_rad_s", "f8"),  # inertial
        ("ball_rate_y_rad_s", "f8"),
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
        *plant.state_fields(WHEELS, 10, 5),
        ("body_angle_rad", "f8", (3,)),  # phi_B, integrated
        ("a5", "f8", (5,)),
        ("torque", "f8", (3,)),  # of the motors and the rollers, held during a 1 ms step
    ],
    align=True,
)


@njit
def _derivative(p, s, x, out):
    rate = s.v3
    total = s.w3
    mbbr.encoder_rate_into(x, rate)
    for i in range(3):
        total[i] = s.torque[i] + friction.torque(rate[i], p.coulomb_n_m, p.viscous_n_m_s_rad)
    mbbr.acceleration_from_torque(x, total, p.model, s.a5)
    if p.rolling[1] != 0.0:
        for i in range(2):
            direction = math.tanh(x[8 + i] / friction.SMOOTHING_RAD_S)
            s.a5[i] += p.rolling[0] * direction
            s.a5[3 + i] += p.rolling[1] * direction
    cosine = math.cos(x[2])
    sine = math.sin(x[2])
    out[0] = x[5]
    out[1] = x[6]
    out[2] = x[7]
    out[3] = cosine * x[8] - sine * x[9]
    out[4] = sine * x[8] + cosine * x[9]
    for i in range(5):
        out[5 + i] = s.a5[i]


@njit
def _motors(p, s, slot):
    """Torque on the ball, body axes, from the duties of delay slot `slot`, held for one step."""
    rate = s.v3
    mbbr.encoder_rate_into(s.x, rate)
    ratio = p.model.ball_radius_m / p.model.wheel_radius_m
    for j in range(3):
        s.torque[j] = p.input_error_n_m[j]
    for i in range(3):
        ball_side = 0.0
        ball_angle = 0.0
        for j in range(3):
            ball_side += p.body_from_wheel[j, i] * rate[j]
            ball_angle += p.body_from_wheel[j, i] * s.body_angle_rad[j]
        current = plant.motor_current(p, s, slot, i, ratio * ball_side)
        shake = min(abs(ball_side) * 0.1, 1.0) * p.vibration_torque_n_m * math.sin(p.rollers_per_ball_turn * ball_angle + 2.1 * i)
        wheel_torque = ratio * p.torque_constant_n_m_a * current + shake
        for j in range(3):
            s.torque[j] += p.body_from_wheel[j, i] * wheel_torque
    plant.drain_battery(p, s, slot)


@njit
def _rk4(p, s, dt):
    x = s.x
    trial = s.trial
    k = s.k
    _derivative(p, s, x, k[0])
    for i in range(5):
        s.acceleration[i] = s.a5[i]
    rate = s.v3
    for j in range(3):
        s.w3[j] = 0.0
    for stage in range(1, 4):
        h = dt if stage == 3 else 0.5 * dt
        for i in range(10):
            trial[i] = x[i] + h * k[stage - 1, i]
        _derivative(p, s, trial, k[stage])
    mbbr.encoder_rate_into(x, rate)
    for j in range(3):
        s.body_angle_rad[j] += 0.5 * dt * rate[j]
    for i in range(10):
        x[i] += dt / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])
    mbbr.encoder_rate_into(x, rate)
    for j in range(3):
        s.body_angle_rad[j] += 0.5 * dt * rate[j]


@njit
def _in_hand(p, s, dt):
    """Held by the operator, or lying: the body stands still, the ball too."""
    x = s.x
    for i in range(5, 10):
        x[i] = 0.0
    if s.held == 1:
        tremor = 2.0 * math.pi * 1.7
        x[0] = s.hand_rad[0] + 0.002 * math.sin(tremor * s.time_s)
        x[1] = s.hand_rad[1] + 0.002 * math.cos(tremor * s.time_s)
        x[5] = 0.002 * tremor * math.cos(tremor * s.time_s)
        x[6] = -0.002 * tremor * math.sin(tremor * s.time_s)
    for i in range(5):
        s.acceleration[i] = 0.0


@njit
def _sensors(p, s, normal):
    rate = s.v3
    force = s.w3
    mbbr.gyro_into(s.x, rate)
    mbbr.accelerometer_into(s.x, s.acceleration, p.model, force)
    if s.held == 0:
        mbbr.encoder_rate_into(s.x, s.k[0])
        for i in range(2):
            # By the axis' own rate: an axis that hardly turns would otherwise show a constant force, which no vibration is.
            shake = p.vibration_accel_m_s2 * min(abs(s.k[0, i]) * 0.1, 1.0)
            force[i] += shake * math.sin(p.rollers_per_ball_turn * s.body_angle_rad[i])
    plant.inertial_sensors(p, s, rate, force, normal)
    plant.dmp(p, s, s.x[0], s.x[1], s.x[2], normal, plant.SUBSTEPS * 0.001)
    ratio = p.model.ball_radius_m / p.model.wheel_radius_m
    for i in range(3):
        angle = 0.0
        for j in range(3):
            angle += ratio * p.body_from_wheel[j, i] * s.body_angle_rad[j]
        angle += ratio * p.roller_ripple_rad * math.sin(p.rollers_per_ball_turn * angle / ratio + 2.1 * i)
        plant.encoder(p, s, i, angle)


@njit
def _tell_truth(p, s, truth):
    x = s.x
    r = p.model.ball_radius_m
    cosine = math.cos(x[2])
    sine = math.sin(x[2])
    truth.time_s = s.time_s
    truth.roll_rad = x[0]
    truth.pitch_rad = x[1]
    truth.yaw_rad = x[2]
    truth.roll_rate_rad_s = x[5]
    truth.pitch_rate_rad_s = x[6]
    truth.yaw_rate_rad_s = x[7]
    truth.ball_rate_x_rad_s = cosine * x[8] - sine * x[9]
    truth.ball_rate_y_rad_s = sine * x[8] + cosine * x[9]
    truth.x_m = r * x[4]
    truth.y_m = -r * x[3]
    truth.velocity_x_m_s = r * truth.ball_rate_y_rad_s
    truth.velocity_y_m_s = -r * truth.ball_rate_x_rad_s
    truth.battery_v = s.battery_v


@njit
def advance_records(p, s, normal, duty, enabled, truth):
    """One sample of 5 ms on records; see `advance`."""
    plant.take_duty(p, s, duty, enabled)
    dt = 0.001
    for step in range(plant.SUBSTEPS):
        s.time_s += dt
        if s.held != 0:
            _in_hand(p, s, dt)
            continue
        _motors(p, s, plant.delay_slot(p, step))
        _rk4(p, s, dt)
        if not abs(s.x[0]) + abs(s.x[1]) <= p.tip_limit_rad and not math.cos(s.x[0]) * math.cos(s.x[1]) > math.cos(p.tip_limit_rad):
            s.held = 2
    if s.held != 0:
        s.battery_v = p.battery_v - p.battery_fade_v_s * s.time_s
    _sensors(p, s, normal)
    _tell_truth(p, s, truth)


@entry(PARAMETERS, STATE, np.dtype("f8"), np.dtype("f8"), "int64", TRUTH, "int64")
def advance(parameters, state, normal, duty, enabled, truth, row):
    """Moves the world by one IMU sample.

    Args:
        normal: (NORMALS,) standard normal numbers.
        duty: (3,) signed duty by wheel, in force from `actuation_delay_steps` ms into this sample.
        enabled: 1 where the motor drivers are enabled.
        truth: (rows,) TRUTH; row `row` is written.
    """
    advance_records(parameters[0], state[0], normal, duty, enabled, truth[row])


@entry("uintp", "uintp", "int64", "uintp", "int64")
def sample(parts_at, normals_at, row, line_at, due_ns):
    """The whole of a usual sample; returns usual_sample.UNUSUAL, MOVED, NO_ROOM or EDGE.

    Args:
        parts_at: address of a usual_sample.PARTS.
        normals_at: of NORMALS random numbers.
        row: of the truth.
        line_at: of the interrupt line's edges.LINE.
        due_ns: time of the sample.
    """
    parts = records_at(parts_at, 1, usual_sample.PARTS)[0]
    enabled = usual_sample.begin(parts, due_ns)
    if enabled < 0:
        return np.int64(usual_sample.UNUSUAL)
    parameters, state = records_at(parts.parameters, 1, PARAMETERS)[0], records_at(parts.state, 1, STATE)[0]
    normal, duty = records_at(normals_at, plant.NORMALS, np.float64), records_at(parts.duty, WHEELS, np.float64)
    advance_records(parameters, state, normal, duty, enabled, records_at(parts.truth, row + 1, TRUTH)[row])
    return usual_sample.end(parts, line_at, due_ns)


def configure(p, config) -> None:
    """The MBBR's own parameters, from model, wheels, friction and dry_run sections."""
    m, dry = config.model, config.dry_run
    error = dry.model_error
    true = mbbr.parameters(
        body_mass_kg=m.body_mass_kg * error.mass,
        ball_mass_kg=m.ball_mass_kg * error.mass,
        ball_radius_m=m.ball_radius_m,
        wheel_radius_m=m.wheel_radius_m,
        com_height_m=m.com_height_m * error.com_height,
        body_inertia_kg_m2=np.array(m.body_inertia_kg_m2) * error.inertia,
        ball_inertia_kg_m2=m.ball_inertia_kg_m2 * error.inertia,
        wheel_inertia_kg_m2=m.wheel_inertia_kg_m2 * error.inertia,
        gravity_m_s2=m.gravity_m_s2,
        imu_position_m=np.array(config.imu.position_m) + dry.imu_position_error_m,
    )
    p.model = true[0]
    p.body_from_wheel[:] = orthonormal(config.wheels.body_from_wheel)
    p.coulomb_n_m = config.friction.coulomb_n_m * error.friction * dry.friction
    p.viscous_n_m_s_rad = config.friction.viscous_n_m_s_rad * error.friction * dry.friction
    p.vibration_torque_n_m, p.vibration_accel_m_s2 = dry.vibration_torque_n_m, dry.vibration_accel_m_s2
    p.rollers_per_ball_turn, p.roller_ripple_rad = dry.rollers_per_ball_turn, dry.roller_ripple_rad
    p.rolling[:] = _rolling(true[0], dry.rolling_resistance_n_m)
    p.input_error_n_m[:] = m.torque_per_command_n_m * np.array(dry.input_error)


def _rolling(m, resistance_n_m: float) -> np.ndarray:
    """(tilt, ball) accelerations, rad/s^2, of an upright robot whose floor resists a positive ball rate with this torque."""
    wheels = m.wheel_inertia_kg_m2 * (m.ball_radius_m / m.wheel_radius_m) ** 2
    arm = m.body_mass_kg * m.com_height_m
    tilt = m.body_inertia_kg_m2[0] + wheels + arm * m.com_height_m
    ball = m.ball_inertia_kg_m2 + wheels + (m.body_mass_kg + m.ball_mass_kg) * m.ball_radius_m**2
    shared = arm * m.ball_radius_m - wheels
    return np.linalg.solve([[tilt, shared], [shared, ball]], [0.0, -resistance_n_m])


def hold(s, lean_rad) -> None:
    """In the operator's hands at this roll and pitch."""
    s.hand_rad[:] = lean_rad
    s.x[0], s.x[1] = lean_rad
