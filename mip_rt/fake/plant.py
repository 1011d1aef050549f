"""What the simulated robots have in common, compiled: motors behind their bridges, delay, IMU, DMP and encoders.

Records are passed whole: these functions read and write the fields that `parameter_fields` and `state_fields` put into every
robot's records, whatever else those hold.
"""

import math

from mip_rt.compiled import njit
from mip_rt.models import motor

NORMALS = 16  # random numbers used per sample
SUBSTEPS = 5
DELAY_TICKS = 4


def parameter_fields(wheels: int) -> list:
    """The fields of a parameter record that the functions here use."""
    return [
        ("resistance_ohm", "f8"),
        ("torque_constant_n_m_a", "f8"),
        ("inductance_h", "f8"),
        ("pwm_period_s", "f8"),
        ("diode_drop_v", "f8"),
        ("brake", "i8"),  # 1: drive/brake bridge
        ("battery_v", "f8"),
        ("battery_resistance_ohm", "f8"),
        ("battery_fade_v_s", "f8"),
        ("count_per_rad", "f8", (wheels,)),  # signed counts per wheel angle, wiring included
        ("backlash_rad", "f8"),
        ("gyro_bias_rad_s", "f8", (3,)),
        ("gyro_drift_rad_s2", "f8", (3,)),
        ("gyro_noise_rad_s", "f8"),
        ("accel_bias_m_s2", "f8", (3,)),
        ("accel_noise_m_s2", "f8"),
        ("imu_misalignment", "f8", (3, 3)),  # measured axes = misalignment body axes
        ("chip_from_body", "f8", (3, 3)),
        ("gyro_count_per_rad_s", "f8"),
        ("accel_count_per_m_s2", "f8"),
        ("dmp_lag_s", "f8"),
        ("dmp_offset_rad", "f8", (2,)),
        ("dmp_noise_rad", "f8"),  # slowly varying error, standard deviation per tilt axis
        ("dmp_noise_time_s", "f8"),
        ("dmp_yaw_drift_rad_s", "f8"),
        ("actuation_delay_steps", "i8"),
        ("extra_delay_ticks", "i8"),
        ("tip_limit_rad", "f8"),
    ]


def state_fields(wheels: int, states: int, accelerations: int) -> list:
    """The fields of a state record that the functions here use, and the Runge-Kutta stages."""
    return [
        ("x", "f8", (states,)),
        ("motor_angle_rad", "f8", (wheels,)),  # wheel angles on the encoder's side of the backlash
        ("duty", "f8", (DELAY_TICKS, wheels)),  # duty by wheel, newest first
        ("enabled", "i8", (DELAY_TICKS,)),
        ("current", "f8", (wheels,)),
        ("acceleration", "f8", (accelerations,)),
        ("dmp_tilt", "f8", (2,)),
        ("dmp_error", "f8", (2,)),
        ("dmp_yaw", "f8"),
        ("held", "i8"),  # 1: in the operator's hands, 2: lying on the ground
        ("hand_rad", "f8", (2,)),
        ("battery_v", "f8"),
        ("time_s", "f8"),
        ("count", "i8", (wheels,)),
        ("packet", "u1", (32,)),
        ("raw", "u1", (16,)),  # accelerometer, temperature, gyro: 14 bytes as in the registers, 2 unused
        ("k", "f8", (4, states)),
        ("trial", "f8", (states,)),
        ("v3", "f8", (3,)),
        ("w3", "f8", (3,)),
        ("chip_rate", "f8", (3,)),
        ("chip_force", "f8", (3,)),
    ]


@njit
def take_duty(p, s, duty, enabled):
    """Puts a new duty and enable into the delay line; what is no duty counts as none."""
    for d in range(DELAY_TICKS - 1, 0, -1):
        s.enabled[d] = s.enabled[d - 1]
        for i in range(len(s.current)):
            s.duty[d, i] = s.duty[d - 1, i]
    s.enabled[0] = enabled
    for i in range(len(s.current)):
        value = duty[i]
        s.duty[0, i] = value if abs(value) <= 1.0 else 0.0


@njit
def delay_slot(p, step):
    """Which entry of the delay line is in force in this 1 ms step of a sample."""
    return min(p.extra_delay_ticks + (1 if step < p.actuation_delay_steps else 0), DELAY_TICKS - 1)


@njit
def motor_current(p, s, slot, i, omega_rad_s):
    """Current of motor i, A, at this wheel speed; s.current keeps it."""
    current = 0.0
    if s.enabled[slot] == 1:
        speed = p.torque_constant_n_m_a * omega_rad_s / s.battery_v
        u = s.duty[slot, i]
        if p.brake == 1:
            current = motor.brake_current(u, speed)
        else:
            t_r = p.pwm_period_s * p.resistance_ohm / p.inductance_h
            current = motor.coast_current(u, speed, t_r, 2.0 * p.diode_drop_v / s.battery_v)
        current *= s.battery_v / p.resistance_ohm
    s.current[i] = current
    return current


@njit
def drain_battery(p, s, slot):
    """The battery's voltage under the present currents."""
    drawn = 0.0
    for i in range(len(s.current)):
        drawn += abs(s.current[i] * s.duty[slot, i])
    s.battery_v = p.battery_v - p.battery_fade_v_s * s.time_s - p.battery_resistance_ohm * drawn


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
def inertial_sensors(p, s, rate, force, normal):
    """Registers and packet of the chip.

    Args:
        rate: (3,) true body rates, body axes.
        force: (3,) true accelerometer in the papers' sign, body axes.
    """
    for i in range(3):
        turn = 0.0
        push = 0.0
        for k in range(3):
            turn += p.imu_misalignment[i, k] * rate[k]
            push -= p.imu_misalignment[i, k] * force[k]  # the chip reports specific force
        s.chip_rate[i] = turn + p.gyro_bias_rad_s[i] + p.gyro_drift_rad_s2[i] * s.time_s + p.gyro_noise_rad_s * normal[i]
        s.chip_force[i] = push + p.accel_bias_m_s2[i] + p.accel_noise_m_s2 * normal[3 + i]
    for i in range(3):
        turn = 0.0
        push = 0.0
        for k in range(3):
            turn += p.chip_from_body[i, k] * s.chip_rate[k]
            push += p.chip_from_body[i, k] * s.chip_force[k]
        _put16(s.raw, 2 * i, push * p.accel_count_per_m_s2)
        _put16(s.raw, 8 + 2 * i, turn * p.gyro_count_per_rad_s)
    _put16(s.raw, 6, 333.87 * 14.0)  # 35 degrees Celsius
    for i in range(6):
        s.packet[16 + i] = s.raw[i]
        s.packet[22 + i] = s.raw[8 + i]


@njit
def dmp(p, s, tilt_x, tilt_y, turn, normal, dt):
    """Attitude as the DMP reports it: lagged, offset, with a slowly wandering error; yaw drifts. R = Rz(turn) Ry(tilt_y) Rx(tilt_x)."""
    follow = 1.0 - math.exp(-dt / p.dmp_lag_s) if p.dmp_lag_s > 0.0 else 1.0
    keep = math.exp(-dt / p.dmp_noise_time_s)
    s.dmp_tilt[0] += follow * (tilt_x - s.dmp_tilt[0])
    s.dmp_tilt[1] += follow * (tilt_y - s.dmp_tilt[1])
    for i in range(2):
        s.dmp_error[i] = keep * s.dmp_error[i] + math.sqrt(1.0 - keep * keep) * p.dmp_noise_rad * normal[6 + i]
    s.dmp_yaw += p.dmp_yaw_drift_rad_s * dt
    roll = 0.5 * (s.dmp_tilt[0] + s.dmp_error[0] + p.dmp_offset_rad[0])
    pitch = 0.5 * (s.dmp_tilt[1] + s.dmp_error[1] + p.dmp_offset_rad[1])
    yaw = 0.5 * (turn + s.dmp_yaw)
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
def encoder(p, s, i, angle_rad):
    """Count of encoder i at this wheel angle, behind its backlash."""
    slack = angle_rad - s.motor_angle_rad[i]
    if slack > p.backlash_rad:
        s.motor_angle_rad[i] = angle_rad - p.backlash_rad
    elif slack < -p.backlash_rad:
        s.motor_angle_rad[i] = angle_rad + p.backlash_rad
    s.count[i] = int(math.floor(s.motor_angle_rad[i] * p.count_per_rad[i]))
