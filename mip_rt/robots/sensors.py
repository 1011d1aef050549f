"""From the bytes and counts of the drivers to SI numbers in body axes: the first part of every robot's compiled step.

The DMP's quaternion is already in body axes (its own orientation setting), accelerometer and gyro words are in chip axes: the
mounting matrix turns them, and the sign of the accelerometer is changed to the papers' (R'([0, 0, -g] - p''), the negative of
what the chip reports), here and nowhere else.

With imu.attitude "onboard" the packet has no quaternion (zeros stand in its place): `read_onboard` computes it from the other words by
`estimators.attitude`, with the velocity that the wheels show.
"""

import math

import numpy as np

from mip_rt import frame
from mip_rt.compiled import njit
from mip_rt.controllers import filters
from mip_rt.estimators import attitude, ekf

IMU_USABLE = 1  # hardware.imu_status.IMU_OK
DMP, ONBOARD = 0, 1  # where the attitude comes from
ANEW_TICKS = 10  # after so many missing samples the onboard attitude starts anew
WHEEL_VELOCITY_NOISE = 0.1  # m/s/sqrt(Hz), of the velocity that wheels show: slip, rollers, backlash
COAST_TICKS = 3  # the rates are believed, and the DMP's attitude is carried on by them, for so long; then it stays


def parameter_fields(wheels: int) -> list:
    """The fields of a parameter record that the functions here use."""
    return [
        ("rate_hz", "f8"),
        ("dt_s", "f8"),
        ("mounting", "f8", (3, 3)),  # body = mounting chip
        ("gyro_scale_rad_s", "f8"),  # per count
        ("accel_scale_m_s2", "f8"),  # per count
        ("count_scale_rad", "f8", (wheels,)),  # signed wheel angle per count
        ("wheel_jump_rad", "f8"),  # largest credible wheel motion in one tick
        ("source", "i8"),  # DMP or ONBOARD
        ("rolling_radius_m", "f8"),  # of what rolls on the ground
        ("lever_m", "f8", (3,)),  # IMU from that one's centre, body axes
    ]


def state_fields(wheels: int) -> list:
    """Likewise of a state record."""
    return [
        ("quaternion", "f8", (4,)),  # last good one; zero before the first
        ("attitude_rad", "f8", (3,)),  # likewise, yaw unwrapped
        ("gyro_rad_s", "f8", (3,)),
        ("acceleration_m_s2", "f8", (3,)),
        ("wheel_history_rad", "f8", (wheels, filters.DERIVATIVE_TAPS)),
        ("count_offset", "i8", (wheels,)),  # counts taken back after a jump, so that the angle stays continuous
        ("last_count", "i8", (wheels,)),
        ("started", "i8"),
        ("coasted", "i8"),  # ticks in a row without a usable packet
    ]


# What `read_onboard` works on: constants and state of the attitude filter, the last fields of a robot's records.
ATTITUDE_PARAMETERS = np.dtype(
    [
        ("carried", attitude.PARAMETERS),  # in someone's hands: any velocity near zero
        ("rolling", attitude.PARAMETERS),  # balancing: the velocity that the wheels show
    ],
    align=True,
)
ATTITUDE_STATE = np.dtype(
    [
        ("edge_ns", "i8"),  # interrupt of the newest sample, 0 before the first
        ("gap", "i8"),  # samples in a row that are missing
        ("gyro_bias_rad_s", "f8", (3,)),  # of the newest sample's row
        ("rate", "f8", (3,)),
        ("measured", "f8", (5,)),
        ("filter", attitude.STATE),
    ],
    align=True,
)
ATTITUDE_SCRATCH = ATTITUDE_STATE.itemsize - ATTITUDE_STATE.fields["filter"][1] - attitude.PERSISTENT  # bytes at its end


def configure(p, config, dt_s: float) -> None:
    """Fills the fields of `parameter_fields` from the imu, motor and encoders sections, but for what rolls and its lever."""
    motor = config.motor
    p.rate_hz, p.dt_s = 1.0 / dt_s, dt_s
    p.mounting[:] = config.imu.mounting
    p.gyro_scale_rad_s = math.radians(config.imu.gyro_range_dps) / 32768.0
    p.accel_scale_m_s2 = config.imu.accel_range_g * 9.80665 / 32768.0
    p.count_scale_rad[:] = [2.0 * math.pi * sign / config.encoders.counts_per_turn for sign in config.encoders.signs]
    p.source = ONBOARD if config.imu.attitude == "onboard" else DMP
    p.wheel_jump_rad = 2.0 * motor.nominal_voltage_v / motor.torque_constant_n_m_a * dt_s


def configure_attitude(p, config, dt_s: float) -> None:
    """Fills a record of ATTITUDE_PARAMETERS."""
    attitude.configure(p.carried, dt_s, attitude.UNKNOWN_VELOCITY, config.imu.gyro_delay_s)
    attitude.configure(p.rolling, dt_s, WHEEL_VELOCITY_NOISE, config.imu.gyro_delay_s)


@njit
def _int16(packet, at):
    value = (np.int64(packet[at]) << 8) | np.int64(packet[at + 1])
    return value - 65536 if value >= 32768 else value


@njit
def _int32(packet, at):
    value = (
        (np.int64(packet[at]) << 24)
        | (np.int64(packet[at + 1]) << 16)
        | (np.int64(packet[at + 2]) << 8)
        | np.int64(packet[at + 3])
    )
    return value - 4294967296 if value >= 2147483648 else value


@njit
def _show_attitude(s, w, x, y, z):
    """Keeps a normalised quaternion and its angles."""
    s.quaternion[0] = w
    s.quaternion[1] = x
    s.quaternion[2] = y
    s.quaternion[3] = z
    s.attitude_rad[0] = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    s.attitude_rad[1] = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    turn = yaw - s.attitude_rad[2]
    s.attitude_rad[2] += turn - 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)


@njit
def _read_quaternion(s, packet):
    """The DMP's; returns False where it is none."""
    w = float(_int32(packet, 0))
    x = float(_int32(packet, 4))
    y = float(_int32(packet, 8))
    z = float(_int32(packet, 12))
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not norm > 0.0:
        return False
    _show_attitude(s, w / norm, x / norm, y / norm, z / norm)
    return True


@njit
def read_imu(p, s, row):
    """Fills quaternion, attitude, gyro and acceleration of the row; returns True where they are fresh and plausible.

    Over a lost packet the attitude is carried on by the last body rates, so that neither the gap nor its end is a step.
    """
    packet = row.imu_packet
    fresh = (row.imu_status & IMU_USABLE) != 0
    if fresh and p.source == DMP:
        fresh = _read_quaternion(s, packet)
    if fresh:
        for i in range(3):
            rate = 0.0
            force = 0.0
            for k in range(3):
                force += p.mounting[i, k] * _int16(packet, 16 + 2 * k)
                rate += p.mounting[i, k] * _int16(packet, 22 + 2 * k)
            s.gyro_rad_s[i] = rate * p.gyro_scale_rad_s - row.gyro_bias_rad_s[i]
            s.acceleration_m_s2[i] = -force * p.accel_scale_m_s2
        s.coasted = 0
    elif s.coasted < COAST_TICKS:
        s.coasted += 1
        if p.source == DMP:
            roll = s.attitude_rad[0]
            s.attitude_rad[0] += p.dt_s * (s.gyro_rad_s[0] + s.attitude_rad[1] * s.gyro_rad_s[2])  # small lean, as in mbbr_ekf.reset
            s.attitude_rad[1] += p.dt_s * (s.gyro_rad_s[1] - roll * s.gyro_rad_s[2])
            s.attitude_rad[2] += p.dt_s * s.gyro_rad_s[2]
    for i in range(4):
        row.quaternion[i] = s.quaternion[i]
    for i in range(3):
        row.attitude_rad[i] = s.attitude_rad[i]
        row.gyro_rad_s[i] = s.gyro_rad_s[i]
        row.acceleration_m_s2[i] = s.acceleration_m_s2[i]
    return fresh


@njit
def _known_velocity(p, s, q, rolling, y):
    """Puts the velocity of the IMU into y[3:]: of the centre of what rolls, from its rates, and of the lever about it."""
    w, i, j, k = q[0], q[1], q[2], q[3]
    lever = p.lever_m
    x0, x1, x2 = rolling[0], rolling[1], rolling[2]
    c0 = s.gyro_rad_s[1] * lever[2] - s.gyro_rad_s[2] * lever[1]
    c1 = s.gyro_rad_s[2] * lever[0] - s.gyro_rad_s[0] * lever[2]
    c2 = s.gyro_rad_s[0] * lever[1] - s.gyro_rad_s[1] * lever[0]
    a0 = 1.0 - 2.0 * (j * j + k * k)
    a1 = 2.0 * (i * j - w * k)
    a2 = 2.0 * (i * k + w * j)
    b0 = 2.0 * (i * j + w * k)
    b1 = 1.0 - 2.0 * (i * i + k * k)
    b2 = 2.0 * (j * k - w * i)
    y[3] = p.rolling_radius_m * (b0 * x0 + b1 * x1 + b2 * x2) + a0 * c0 + a1 * c1 + a2 * c2
    y[4] = -p.rolling_radius_m * (a0 * x0 + a1 * x1 + a2 * x2) + b0 * c0 + b1 * c1 + b2 * c2


@njit
def read_onboard(p, s, pa, sa, row, rolling, limits):
    """Fills quaternion and attitude of the row by the onboard filter, after `step`.

    Interrupts that never became a tick and packets that are missing are made up for with the last rates. After ANEW_TICKS of them (the motors
    are off by then) the filter starts anew, and with it the heading, as the DMP does. The wheels' velocity counts while the robot balances.

    Args:
        pa: record of ATTITUDE_PARAMETERS.
        sa: record of ATTITUDE_STATE.
        rolling: (3,) rates of what rolls on the ground, rad/s, body axes.
        limits: what `step` returned.
    """
    f = sa.filter
    y = sa.measured
    carried = pa.carried
    calibrated = False
    for i in range(3):
        calibrated = calibrated or row.gyro_bias_rad_s[i] != sa.gyro_bias_rad_s[i]
        sa.gyro_bias_rad_s[i] = row.gyro_bias_rad_s[i]
    if calibrated and f.started == 1:
        attitude.forget_bias(f)
    lost = int(math.floor((row.edge_ns - sa.edge_ns) * 1e-9 * p.rate_hz + 0.5)) - 1 if sa.edge_ns > 0 else 0
    sa.edge_ns = row.edge_ns
    if limits & frame.LIMIT_IMU_MISSING:
        lost += 1
    sa.gap = sa.gap + lost if lost > 0 else 0
    if sa.gap > ANEW_TICKS:
        f.started = 0
    elif f.started == 1:
        for _ in range(lost):
            attitude.step(carried, f, sa.rate, y, 0)
    if not limits & frame.LIMIT_IMU_MISSING:
        for i in range(3):
            sa.rate[i] = s.gyro_rad_s[i]
            y[i] = -s.acceleration_m_s2[i]
        valid = attitude.GYRO_VALID | attitude.ACCELEROMETER_VALID
        if not row.request & frame.REQUEST_ENGAGED:
            y[3] = 0.0
            y[4] = 0.0
            attitude.step(carried, f, sa.rate, y, attitude.ALL_VALID)
        else:
            if not limits & frame.LIMIT_ENCODER_JUMP:
                valid |= attitude.VELOCITY_VALID
                _known_velocity(p, s, f.quaternion, rolling, y)
            attitude.step(pa.rolling, f, sa.rate, y, valid)
        if f.filter.status & ekf.UNHEALTHY:
            f.started = 0
    if f.started == 1:
        _show_attitude(s, f.quaternion[0], f.quaternion[1], f.quaternion[2], f.quaternion[3])
    for i in range(4):
        row.quaternion[i] = s.quaternion[i]
    for i in range(3):
        row.attitude_rad[i] = s.attitude_rad[i]


@njit
def read_wheels(p, s, row):
    """Fills wheel angles and rates; returns True where no wheel jumped.

    A jump (a count that a wheel cannot have made in one tick) is taken back: the angle continues from where it was.
    """
    steady = True
    for i in range(len(row.encoder_count)):
        count = row.encoder_count[i]
        if s.started == 0:
            s.count_offset[i] = count
            s.last_count[i] = count
            for k in range(filters.DERIVATIVE_TAPS):
                s.wheel_history_rad[i, k] = 0.0
        moved = count - s.last_count[i]
        if abs(moved * p.count_scale_rad[i]) > p.wheel_jump_rad:
            s.count_offset[i] += moved
            steady = False
        s.last_count[i] = count
        angle = (count - s.count_offset[i]) * p.count_scale_rad[i]
        row.wheel_angle_rad[i] = angle
        row.wheel_rate_rad_s[i] = filters.derivative(s.wheel_history_rad[i], angle, p.rate_hz)
    s.started = 1
    return steady


@njit
def step(p, s, row):
    """Reads the row's raw sensors; returns the bits of frame.LIMITS that apply."""
    limits = 0
    if not read_imu(p, s, row):
        limits |= frame.LIMIT_IMU_MISSING
    if not read_wheels(p, s, row):
        limits |= frame.LIMIT_ENCODER_JUMP
    return limits
