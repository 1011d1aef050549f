"""From the bytes and counts of the drivers to SI numbers in body axes: the first part of every robot's compiled step.

The DMP's quaternion is already in body axes (its own orientation setting), accelerometer and gyro words are in chip axes: the
mounting matrix turns them, and the sign of the accelerometer is changed to the papers' (R'([0, 0, -g] - p''), the negative of
what the chip reports), here and nowhere else.

With imu.attitude "onboard" the packet has no quaternion (zeros stand in its place): see `robots.onboard`.
"""

import math

import numpy as np

from mip_rt import frame
from mip_rt.compiled import njit
from mip_rt.controllers import filters
from mip_rt.models.mounting import body_from_chip, level_quaternion

IMU_USABLE = 1  # hardware.imu_status.IMU_OK
DMP, ONBOARD = 0, 1  # where the attitude comes from
COAST_TICKS = 3  # the rates are believed, and the DMP's attitude is carried on by them, for so long; then it stays


def parameter_fields(wheels: int) -> list:
    """The fields of a parameter record that the functions here use."""
    return [
        ("rate_hz", "f8"),
        ("dt_s", "f8"),
        ("mounting", "f8", (3, 3)),  # body = mounting chip
        ("gyro_scale_rad_s", "f8"),  # per count
        ("accel_scale_m_s2", "f8"),  # per count
        ("accel_gain", "f8", (3,)),  # chip axes, of this unit
        ("accel_offset", "f8", (3,)),  # counts, chip axes, of this unit
        ("level_quaternion", "f8", (4,)),  # body from IMU, as mounted in this unit
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


def configure(p, config, dt_s: float) -> None:
    """Fills the fields of `parameter_fields` from the imu, motor and encoders sections, but for what rolls and its lever."""
    motor = config.motor
    p.rate_hz, p.dt_s = 1.0 / dt_s, dt_s
    p.mounting[:] = body_from_chip(config.imu)
    p.level_quaternion[:] = level_quaternion(config.imu.level_rad)
    p.accel_gain[:] = config.imu.accel_gain
    p.accel_offset[:] = np.array(config.imu.accel_offset_m_s2) / (config.imu.accel_range_g * 9.80665 / 32768.0)
    p.gyro_scale_rad_s = math.radians(config.imu.gyro_range_dps) / 32768.0
    p.accel_scale_m_s2 = config.imu.accel_range_g * 9.80665 / 32768.0
    p.count_scale_rad[:] = [2.0 * math.pi * sign / config.encoders.counts_per_turn for sign in config.encoders.signs]
    p.source = ONBOARD if config.imu.attitude == "onboard" else DMP
    p.wheel_jump_rad = 2.0 * motor.nominal_voltage_v / motor.torque_constant_n_m_a * dt_s


@njit
def _int16(packet, at):
    return np.int32(np.int16(np.int32(packet[at]) << 8 | np.int32(packet[at + 1])))


@njit
def _int32(packet, at):
    # 32 bits: to make a float64 of 64 is a call on 32-bit ARM.
    return np.int32(np.int32(packet[at]) << 24 | np.int32(packet[at + 1]) << 16 | np.int32(packet[at + 2]) << 8 | np.int32(packet[at + 3]))


@njit
def _turned_back(level, w, x, y, z):
    """Attitude of the body from that of the IMU, which is turned by `level` against it: q conj(level)."""
    a, b, c, d = level[0], -level[1], -level[2], -level[3]
    return (
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    )


@njit
def show_attitude(s, w, x, y, z):
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
def _read_quaternion(p, s, packet):
    """The DMP's; returns False where it is none."""
    w = float(_int32(packet, 0))
    x = float(_int32(packet, 4))
    y = float(_int32(packet, 8))
    z = float(_int32(packet, 12))
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not norm > 0.0:
        return False
    w, x, y, z = _turned_back(p.level_quaternion, w / norm, x / norm, y / norm, z / norm)
    show_attitude(s, w, x, y, z)
    return True


@njit
def read_imu(p, s, row, usable):
    """Fills quaternion, attitude, gyro and acceleration of the row; returns True where they are fresh and plausible.

    Over a lost packet the attitude is carried on by the last body rates, so that neither the gap nor its end is a step.
    """
    packet = row.imu_packet
    fresh = usable
    if fresh and p.source == DMP:
        fresh = _read_quaternion(p, s, packet)
    if fresh:
        force = s.acceleration_m_s2
        rate = s.gyro_rad_s
        for i in range(3):
            force[i] = 0.0
            rate[i] = 0.0
        for k in range(3):
            felt = p.accel_gain[k] * _int16(packet, 16 + 2 * k) - p.accel_offset[k]
            turned = float(_int16(packet, 22 + 2 * k))
            for i in range(3):
                force[i] += p.mounting[i, k] * felt
                rate[i] += p.mounting[i, k] * turned
        for i in range(3):
            rate[i] = rate[i] * p.gyro_scale_rad_s - row.gyro_bias_rad_s[i]
            force[i] = -force[i] * p.accel_scale_m_s2
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
    bias = row.gyro_bias_rad_s
    known = abs(bias[0] + bias[1] + bias[2]) < math.inf  # a packet's words are integers: nothing else of the IMU can be no number
    if not known:
        limits |= frame.LIMIT_NOT_FINITE
    if not read_imu(p, s, row, known and (row.imu_status & IMU_USABLE) != 0):
        limits |= frame.LIMIT_IMU_MISSING
    if not read_wheels(p, s, row):
        limits |= frame.LIMIT_ENCODER_JUMP
    return limits
