"""From the body command to the duty of each wheel: friction compensation, wheel transform, voltage scaling, drive/coast inverse.

A command is the voltage, as a fraction of the nominal 8 V, that a drive/brake bridge with linear current would be given; the
estimators' models know only that linear motor. So the chain ends with the duty that makes a drive/coast bridge at the present
battery voltage and wheel speed carry the same current, (4.4) with the exact voltage scaling of section I.5.

A command that the battery cannot follow is clipped here, and the estimators are told what was left of it.

Source: dissertation (5.13), (5.14) transforms, (6.14), (6.15) friction, chapter 4 drive/coast.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.models.friction import compensation
from mip_rt.models.motor import brake_command, coast_inverse

DRIVE_COAST = 0
DRIVE_BRAKE = 1

CLIPPED = 1  # result bit of `step`: a wheel command was beyond what the battery gives
CURRENT_SATURATED = 2  # the inverse met a current that cannot be reached at this wheel speed
NOT_FINITE = 4  # a duty was not finite and was replaced by zero

PARAMETERS = np.dtype(
    [
        ("body_from_wheel", "f8", (3, 3)),  # T_ob, orthonormal
        ("wheel_ratio", "f8"),  # rw / r
        ("friction_level", "f8"),  # compensated part of mu_c / k1, in body commands
        ("friction_smoothing_s_rad", "f8"),  # k of S(x)
        ("drive", "i8"),  # DRIVE_COAST or DRIVE_BRAKE
        ("resistance_ohm", "f8"),
        ("torque_constant_n_m_a", "f8"),
        ("nominal_voltage_v", "f8"),
        ("time_ratio", "f8"),  # T_r = T_pwm R / L
        ("diode_drop_v", "f8"),
        ("command_limit", "f8"),  # largest wheel command, at most 1
        ("period_ns", "f8"),
        ("motor_sign", "f8", (3,)),
    ],
    align=True,
)


@njit
def friction_add(p, estimate, added):
    """(3,) out: the body command that cancels Coulomb friction at the estimated ball rate relative to the body, (6.14)."""
    roll, pitch = estimate[0], estimate[1]
    roll_rate, pitch_rate, yaw_rate = estimate[3], estimate[4], estimate[5]
    x, y = estimate[6], estimate[7]
    k = p.friction_smoothing_s_rad
    added[0] = p.friction_level * compensation(x - roll_rate + pitch * yaw_rate, k)
    added[1] = p.friction_level * compensation(y - pitch_rate - roll * yaw_rate, k)
    added[2] = p.friction_level * compensation(-yaw_rate - roll * y + pitch * x, k)


@njit
def duties(p, wheel_command, wheel_rate_rad_s, battery_v, duty, duty_ns):
    """Duties that carry the currents of the linear motor model at these wheel commands; CURRENT_SATURATED and NOT_FINITE bits.

    Args:
        p: a record with the motor's fields of PARAMETERS, whatever else it holds.
        wheel_command: (wheels,) fractions of the nominal voltage.
        wheel_rate_rad_s, duty, duty_ns: (wheels,) as in `step`.
    """
    bits = 0
    for i in range(len(duty)):
        back_emf_v = p.torque_constant_n_m_a * wheel_rate_rad_s[i]
        current = (p.nominal_voltage_v * wheel_command[i] - back_emf_v) / battery_v  # in units of stall current V_b / R
        speed = back_emf_v / battery_v
        if p.drive == DRIVE_COAST:
            value, saturated = coast_inverse(current, speed, p.time_ratio, 2.0 * p.diode_drop_v / battery_v)
        else:
            value, saturated = brake_command(current, speed)
        if saturated:
            bits |= CURRENT_SATURATED
        if not abs(value) <= 1.0:
            value = 0.0
            bits |= NOT_FINITE
        duty[i] = value
        duty_ns[i] = int(math.floor(p.motor_sign[i] * value * p.period_ns + 0.5))
    return bits


@njit
def step(p, body_command, added, scale, wheel_rate_rad_s, battery_v, wheel_command, applied, duty, duty_ns):
    """One tick for the three wheels.

    Args:
        body_command: (3,) u of the state feedback.
        added: (3,) what friction compensation adds.
        scale: soft-start factor on the wheel commands.
        wheel_rate_rad_s: (3,) measured wheel rates.
        battery_v: battery voltage, positive.
        wheel_command: (3,) out, clipped wheel commands.
        applied: (3,) out, body command after clipping, less compensation.
        duty: (3,) out, signed duty by wheel.
        duty_ns: (3,) out, signed pulse by motor.

    Returns:
        CLIPPED, CURRENT_SATURATED and NOT_FINITE bits.
    """
    bits = 0
    available = min(p.command_limit, battery_v / p.nominal_voltage_v)
    for i in range(3):
        command = 0.0
        for j in range(3):
            command += p.body_from_wheel[j, i] * (body_command[j] + added[j])
        command *= p.wheel_ratio * scale
        if command > available:
            command = available
            bits |= CLIPPED
        elif command < -available:
            command = -available
            bits |= CLIPPED
        wheel_command[i] = command
    for j in range(3):
        total = 0.0
        for i in range(3):
            total += p.body_from_wheel[j, i] * wheel_command[i]
        applied[j] = total / p.wheel_ratio - scale * added[j]
    return bits | duties(p, wheel_command, wheel_rate_rad_s, battery_v, duty, duty_ns)
