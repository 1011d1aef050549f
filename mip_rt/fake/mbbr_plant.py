"""The compiled half of the simulated world: exact plant, motors, friction, roller vibration, IMU, DMP and encoders for one IMU sample.

Per sample of 5 ms: five RK4 steps of 1 ms of the exact model (variant N), the wheels' currents from the drive/coast (or brake)
equations at the present wheel speeds and battery voltage, Coulomb and viscous friction inside the integrator; then the sensors.

Vibration. The rollers of the double-row omniwheels hand over to each other as the ball rolls; the dissertation (section 6.4.4,
Fig. 6.24) finds lines in the ball speed's spectrum whose frequency grows with the drive rate, 39.1 rad/s being marked, and a 17 to 25 rad/s
response at low speed. Here each wheel drives the ball with a torque of amplitude proportional to its speed (up to a limit) at
`rollers_per_ball_turn` times the ball's angle about that wheel's axis: at 0.2 m/s the ball turns at 6.25 rad/s, so the marked line
needs a factor of 6.26.
"""

import math

import numpy as np

from mip_rt.compiled import njit, numba, record_array
from mip_rt.models import friction, mbbr, motor

NORMALS = 16  # random numbers used per sample
SUBSTEPS = 5
DELAY_TICKS = 4

PARAMETERS = np.dtype(
    [
        ("model", mbbr.PARAMETERS),
        ("body_from_wheel", "f8", (3, 3)),
        ("coulomb_n_m", "f8"),
        ("viscous_n_m_s_rad", "f8"),
        ("resistance_ohm", "f8"),
        ("torque_constant_n_m_a", "f8"),
        ("inductance_h", "f8"),
        ("pwm_period_s", "f8"),
        ("diode_drop_v", "f8"),
        ("brake", "i8"),  # 1: drive/brake bridge
        ("battery_v", "f8"),
        ("battery_resistance_ohm", "f8"),
        ("battery_fade_v_s", "f8"),
        ("count_per_rad", "f8", (3,)),  # signed counts per wheel angle, wiring included
        ("backlash_rad", "f8"),
        ("gyro_bias_rad_s", "f8", (3,)),
        ("gyro_noise_rad_s", "f8"),
        ("accel_bias_m_s2", "f8", (3,)),
        ("accel_noise_m_s2", "f8"),
        ("imu_misalignment", "f8", (3, 3)),  # measured axes = misalignment body axes
        ("chip_from_body", "f8", (3, 3)),
        ("gyro_count_per_rad_s", "f8"),
        ("accel_count_per_m_s2", "f8"),
        ("vibration_torque_n_m", "f8"),  # amplitude at 10 rad/s of the wheel's ball-side speed
        ("vibration_accel_m_s2", "f8"),
        ("rollers_per_ball_turn", "f8"),
        ("dmp_lag_s", "f8"),
        ("dmp_offset_rad", "f8", (2,)),
        ("dmp_noise_rad", "f8"),  # slowly varying error, standard deviation per tilt axis
        ("dmp_noise_time_s", "f8"),
        ("dmp_yaw_drift_rad_s", "f8"),
        ("actuation_delay_steps", "i8"),
        ("extra_delay_ticks", "i8"),
        ("tip_limit_rad", "f8"),
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
        ("x", "f8", (10,)),
        ("body_angle_rad", "f8", (3,)),  # phi_B, integrated
        ("motor_angle_rad", "f8", (3,)),  # wheel angles on the encoder's side of the backlash
        ("duty", "f8", (DELAY_TICKS, 3)),  # duty by wheel, newest first
        ("enabled", "i8", (DELAY_TICKS,)),
        ("current", "f8", (3,)),
        ("acceleration", "f8", (5,)),
        ("dmp_tilt", "f8", (2,)),
        ("dmp_error", "f8", (2,)),
        ("dmp_yaw", "f8"),
        ("held", "i8"),  # 1: in the operator's hands, 2: lying on the ground
        ("hand_rad", "f8", (2,)),
        ("battery_v", "f8"),
        ("time_s", "f8"),
        ("count", "i8", (3,)),
        ("packet", "u1", (32,)),
        ("raw", "u1", (16,)),  # accelerometer, temperature, gyro: 14 bytes as in the registers, 2 unused
        ("k", "f8", (4, 10)),  # Runge-Kutta stages
        ("trial", "f8", (10,)),
        ("v3", "f8", (3,)),
        ("w3", "f8", (3,)),
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
        s.torque[j] = 0.0
    drawn = 0.0
    for i in range(3):
        ball_side = 0.0
        ball_angle = 0.0
        for j in range(3):
            ball_side += p.body_from_wheel[j, i] * rate[j]
            ball_angle += p.body_from_wheel[j, i] * s.body_angle_rad[j]
        omega = ratio * ball_side
        current = 0.0
        if s.enabled[slot] == 1:
            speed = p.torque_constant_n_m_a * omega / s.battery_v
            u = s.duty[slot, i]
            if p.brake == 1:
                current = motor.brake_current(u, speed)
            else:
                t_r = p.pwm_period_s * p.resistance_ohm / p.inductance_h
                current = motor.coast_current(u, speed, t_r, 2.0 * p.diode_drop_v / s.battery_v)
            current *= s.battery_v / p.resistance_ohm
            drawn += abs(current * u)
        s.current[i] = current
        shake = min(abs(ball_side) * 0.1, 1.0) * p.vibration_torque_n_m * math.sin(p.rollers_per_ball_turn * ball_angle + 2.1 * i)
        wheel_torque = ratio * p.torque_constant_n_m_a * current + shake
        for j in range(3):
            s.torque[j] += p.body_from_wheel[j, i] * wheel_torque
    s.battery_v = p.battery_v - p.battery_fade_v_s * s.time_s - p.battery_resistance_ohm * drawn


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
def _put16(buffer, at, value):
    number = int(math.floor(value + 0.5))
    number = max(-32768, min(32767, number)) & 0xFFFF
    buffer[at] = number >> 8
    buffer[at + 1] = number & 0xFF


@njit
def _put32(buffer, at, value):
    number = int(math.floor(value * 1073741824.0 + 0.5))
    number = max(-2147483648, min(2147483647, number)) & 0xFFFFFFFF
    buffer[at] = number >> 24
    buffer[at + 1] = (number >> 16) & 0xFF
    buffer[at + 2] = (number >> 8) & 0xFF
    buffer[at + 3] = number & 0xFF


@njit
def _inertial_sensors(p, s, normal):
    rate = s.v3
    force = s.w3
    mbbr.gyro_into(s.x, rate)
    mbbr.accelerometer_into(s.x, s.acceleration, p.model, force)
    if s.held == 0:
        mbbr.encoder_rate_into(s.x, s.k[0])
        shake = p.vibration_accel_m_s2 * min(math.hypot(s.k[0, 0], s.k[0, 1]) * 0.1, 1.0)
        phase = p.rollers_per_ball_turn * s.body_angle_rad[0]
        force[0] += shake * math.sin(phase)
        force[1] += shake * math.sin(p.rollers_per_ball_turn * s.body_angle_rad[1])
    for i in range(3):
        turn = 0.0
        push = 0.0
        for k in range(3):
            turn += p.imu_misalignment[i, k] * rate[k]
            push -= p.imu_misalignment[i, k] * force[k]  # the chip reports specific force
        s.k[1, i] = turn + p.gyro_bias_rad_s[i] + p.gyro_noise_rad_s * normal[i]
        s.k[2, i] = push + p.accel_bias_m_s2[i] + p.accel_noise_m_s2 * normal[3 + i]
    for i in range(3):
        turn = 0.0
        push = 0.0
        for k in range(3):
            turn += p.chip_from_body[i, k] * s.k[1, k]
            push += p.chip_from_body[i, k] * s.k[2, k]
        _put16(s.raw, 2 * i, push * p.accel_count_per_m_s2)
        _put16(s.raw, 8 + 2 * i, turn * p.gyro_count_per_rad_s)
    _put16(s.raw, 6, 333.87 * 14.0)  # 35 degrees Celsius
    for i in range(6):
        s.packet[16 + i] = s.raw[i]
        s.packet[22 + i] = s.raw[8 + i]


@njit
def _dmp(p, s, normal, dt):
    """Attitude as the DMP reports it: lagged, offset, with a slowly wandering error; yaw drifts."""
    follow = 1.0 - math.exp(-dt / p.dmp_lag_s) if p.dmp_lag_s > 0.0 else 1.0
    keep = math.exp(-dt / p.dmp_noise_time_s)
    for i in range(2):
        s.dmp_tilt[i] += follow * (s.x[i] - s.dmp_tilt[i])
        s.dmp_error[i] = keep * s.dmp_error[i] + math.sqrt(1.0 - keep * keep) * p.dmp_noise_rad * normal[6 + i]
    s.dmp_yaw += p.dmp_yaw_drift_rad_s * dt
    roll = 0.5 * (s.dmp_tilt[0] + s.dmp_error[0] + p.dmp_offset_rad[0])
    pitch = 0.5 * (s.dmp_tilt[1] + s.dmp_error[1] + p.dmp_offset_rad[1])
    yaw = 0.5 * (s.x[2] + s.dmp_yaw)
    cr = math.cos(roll)
    sr = math.sin(roll)
    cp = math.cos(pitch)
    sp = math.sin(pitch)
    cw = math.cos(yaw)
    sw = math.sin(yaw)
    _put32(s.packet, 0, cr * cp * cw + sr * sp * sw)
    _put32(s.packet, 4, sr * cp * cw - cr * sp * sw)
    _put32(s.packet, 8, cr * sp * cw + sr * cp * sw)
    _put32(s.packet, 12, cr * cp * sw - sr * sp * cw)


@njit
def _encoders(p, s):
    ratio = p.model.ball_radius_m / p.model.wheel_radius_m
    for i in range(3):
        angle = 0.0
        for j in range(3):
            angle += ratio * p.body_from_wheel[j, i] * s.body_angle_rad[j]
        slack = angle - s.motor_angle_rad[i]
        if slack > p.backlash_rad:
            s.motor_angle_rad[i] = angle - p.backlash_rad
        elif slack < -p.backlash_rad:
            s.motor_angle_rad[i] = angle + p.backlash_rad
        s.count[i] = int(math.floor(s.motor_angle_rad[i] * p.count_per_rad[i]))


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
    for d in range(DELAY_TICKS - 1, 0, -1):
        s.enabled[d] = s.enabled[d - 1]
        for i in range(3):
            s.duty[d, i] = s.duty[d - 1, i]
    s.enabled[0] = enabled
    for i in range(3):
        value = duty[i]
        s.duty[0, i] = value if abs(value) <= 1.0 else 0.0
    dt = 0.001
    for step in range(SUBSTEPS):
        s.time_s += dt
        if s.held != 0:
            _in_hand(p, s, dt)
            continue
        slot = p.extra_delay_ticks + (1 if step < p.actuation_delay_steps else 0)
        _motors(p, s, min(slot, DELAY_TICKS - 1))
        _rk4(p, s, dt)
        if not math.cos(s.x[0]) * math.cos(s.x[1]) > math.cos(p.tip_limit_rad):
            s.held = 2
    if s.held != 0:
        s.battery_v = p.battery_v - p.battery_fade_v_s * s.time_s
    _inertial_sensors(p, s, normal)
    _dmp(p, s, normal, SUBSTEPS * dt)
    _encoders(p, s)
    _tell_truth(p, s, truth)


@njit([numba.void(record_array(PARAMETERS), record_array(STATE), numba.float64[:, ::1], numba.int64, numba.float64[::1],
                  numba.int64, record_array(TRUTH), numba.int64)])  # fmt: skip
def advance(parameters, state, normals, sample, duty, enabled, truth, row):
    """Moves the world by one IMU sample.

    Args:
        normals: (rows, NORMALS) standard normal numbers; row `sample` is used.
        duty: (3,) signed duty by wheel, in force from `actuation_delay_steps` ms into this sample.
        enabled: 1 where the motor drivers are enabled.
        truth: (rows,) TRUTH; row `row` is written.
    """
    advance_records(parameters[0], state[0], normals[sample], duty, enabled, truth[row])
