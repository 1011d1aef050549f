"""What is wrong with the robot: detectors that need arithmetic in every tick, as part of the compiled step of any robot.

They judge the sensors' timing, the wheels against the gyro, the motors against their limits and the battery, and answer with bits of
frame.alarms (a reason to stop) and frame.limits, and with the factor that drive commands are allowed to have. Every comparison is written
so that a number that is not finite counts as a failure.

Wheels against gyro. The wheels of a rolling robot and its gyro tell the same story about the spin: the sum of the wheels' motions, each
with its weight, is the robot's yaw. The difference, leaked over 0.1 s, is a few milliradians in health; a standing, slipping or
reversed wheel makes it grow by that wheel's own share, which tells which of the three it is.
"""

import math

import numpy as np

from mip_rt import frame
from mip_rt.compiled import njit

MAX_WHEELS = 4
MISMATCH_S = 0.1  # leak of the comparison of wheels and gyro
STILL_S = 0.1  # a count that stood for so long ...
STILL_SHARE = 0.3  # ... while the mismatch is beyond this share of its limit, is a dead encoder
LEAN_COSINE = 0.92  # leaning by more than 0.4 rad, a falling robot's wheels and gyro are not compared
SIGN_S = 0.05
SLIP_S = 0.25
SIGN_FIT = 0.35  # a reversed wheel explains the mismatch up to this share
RACE_S = 0.1
JUMPS, JUMPS_S = 4.0, 0.25  # jumps, each forgotten within 0.25 s
MISSING_SHARE, MISSING_S = 0.3, 0.5
RATE_S = 1.0
OVERRUN_SHARE, OVERRUN_S = 0.5, 0.5
BATTERY_LOW_S = 2.0
SATURATION_S = 0.2  # smoothing of "a command was clipped" for reducing the drive
SATURATION_FREE = 0.4  # clipped share of the ticks from which the drive is reduced
RECOVERY_S = 2.0  # the drive grows back from 0 to 1 within this time

PARAMETERS = np.dtype(
    [
        ("wheels", "i8"),
        ("dt_s", "f8"),
        ("yaw_from_wheel", "f8", (MAX_WHEELS,)),  # yaw by each wheel's motion, in the sense that is passed to check_wheels
        ("mismatch_pole", "f8"),
        ("mismatch_limit_rad", "f8"),
        ("stall_duty_s", "f8"),  # integral of |duty| over a standing count
        ("still_ticks", "i8"),
        ("sign_ticks", "i8"),
        ("slip_ticks", "i8"),
        ("race_rad_s", "f8"),
        ("race_ticks", "i8"),
        ("jump_pole", "f8"),
        ("saturation_ticks", "i8"),
        ("saturation_pole", "f8"),
        ("recovery", "f8"),
        ("missing_pole", "f8"),
        ("rate_pole", "f8"),
        ("rate_tolerance_s", "f8"),
        ("overrun_pole", "f8"),
        ("warn_v", "f8"),
        ("minimum_v", "f8"),
        ("cutoff_v", "f8"),
        ("battery_ticks", "i8"),
    ],
    align=True,
)
STATE = np.dtype(
    [
        # of the wheels, fresh at every arming
        ("wheel_angle_rad", "f8", (MAX_WHEELS,)),
        ("duty", "f8", (MAX_WHEELS,)),  # in force since the previous tick
        ("part_rad", "f8", (MAX_WHEELS,)),  # each wheel's share of the leaked spin
        ("yaw_rad", "f8"),  # the gyro's
        ("stalled_s", "f8", (MAX_WHEELS,)),  # |duty| integrated since the count last changed
        ("still", "i8", (MAX_WHEELS,)),  # ticks since then
        ("disagree", "i8"),  # ticks in a row with wheels and gyro at odds
        ("racing", "i8"),
        ("jumps", "f8"),
        ("clipped", "i8", (MAX_WHEELS,)),  # ticks in a row at the limit, signed
        ("saturation", "f8"),  # smoothed share of ticks with a clipped command
        ("allowed", "f8"),  # factor on drive commands
        ("low", "i8"),  # ticks with the battery below cutoff
        # of the timing, never reset
        ("edge_ns", "i8"),
        ("interval_error_s", "f8"),
        ("missing", "f8"),
        ("overrun", "f8"),
    ],
    align=True,
)


def configure(p, config, dt_s: float, yaw_from_wheel) -> None:
    """Derives the constants, once.

    Args:
        config: a configuration with limits, battery and motor sections.
        yaw_from_wheel: weight of each wheel's angle in the robot's yaw, in the sense that check_wheels is told.
    """
    limits, battery, motor = config.limits, config.battery, config.motor

    def pole(time_s):
        return math.exp(-dt_s / time_s)

    def ticks(time_s):
        return max(1, round(time_s / dt_s))

    p.wheels, p.dt_s = len(yaw_from_wheel), dt_s
    p.yaw_from_wheel[: p.wheels] = yaw_from_wheel
    p.mismatch_pole, p.mismatch_limit_rad = pole(MISMATCH_S), limits.wheel_mismatch_rad
    p.stall_duty_s = limits.stall_duty_s
    p.still_ticks, p.sign_ticks, p.slip_ticks = ticks(STILL_S), ticks(SIGN_S), ticks(SLIP_S)
    p.race_rad_s = limits.race_share * motor.nominal_voltage_v / motor.torque_constant_n_m_a
    p.race_ticks, p.jump_pole = ticks(RACE_S), pole(JUMPS_S)
    p.saturation_ticks, p.saturation_pole, p.recovery = ticks(limits.saturation_s), pole(SATURATION_S), dt_s / RECOVERY_S
    p.missing_pole, p.overrun_pole = pole(MISSING_S), pole(OVERRUN_S)
    p.rate_pole, p.rate_tolerance_s = pole(RATE_S), limits.rate_tolerance * dt_s
    p.warn_v, p.minimum_v, p.cutoff_v = battery.warn_v, battery.minimum_v, battery.cutoff_v
    p.battery_ticks = ticks(BATTERY_LOW_S)


@njit
def reset(p, s, row):
    """Fresh for an arming; the timing's memory stays."""
    for i in range(p.wheels):
        s.wheel_angle_rad[i] = row.wheel_angle_rad[i]
        s.duty[i] = 0.0
        s.part_rad[i] = 0.0
        s.stalled_s[i] = 0.0
        s.still[i] = 0
        s.clipped[i] = 0
    s.yaw_rad = 0.0
    s.disagree = 0
    s.racing = 0
    s.jumps = 0.0
    s.saturation = 0.0
    s.allowed = 1.0
    s.low = 0


@njit
def check_timing(p, s, row, limits):
    """Every tick, armed or not: interrupts' rate, missed ticks, unusable packets; returns alarm bits."""
    alarms = 0
    missing = 1.0 if limits & frame.LIMIT_IMU_MISSING else 0.0
    s.missing = p.missing_pole * s.missing + (1.0 - p.missing_pole) * missing
    if not s.missing <= MISSING_SHARE:
        alarms |= frame.ALARM_IMU_UNRELIABLE
    error_s = 0.0
    if s.edge_ns != 0:
        error_s = (row.edge_ns - s.edge_ns) * 1e-9 - (row.missed + 1) * p.dt_s
    s.edge_ns = row.edge_ns
    s.interval_error_s = p.rate_pole * s.interval_error_s + (1.0 - p.rate_pole) * error_s
    if not abs(s.interval_error_s) <= p.rate_tolerance_s:
        alarms |= frame.ALARM_IMU_RATE
    s.overrun = p.overrun_pole * s.overrun + (1.0 - p.overrun_pole) * row.missed
    if not s.overrun <= OVERRUN_SHARE:
        alarms |= frame.ALARM_OVERRUN
    return alarms


@njit
def check_wheels(p, s, row, yaw_rate_rad_s, lean_cosine):
    """Before the estimators, while armed: True where wheels and gyro agree.

    Args:
        row: frame with this tick's wheel angles.
        yaw_rate_rad_s: spin that the gyro says the wheels must show.
        lean_cosine: of the body against the vertical.
    """
    pole = p.mismatch_pole if lean_cosine > LEAN_COSINE else 0.0
    mismatch = 0.0
    for i in range(p.wheels):
        moved = row.wheel_angle_rad[i] - s.wheel_angle_rad[i]
        s.wheel_angle_rad[i] = row.wheel_angle_rad[i]
        part = pole * s.part_rad[i] + p.yaw_from_wheel[i] * moved
        s.part_rad[i] = part
        mismatch += part
        if moved == 0.0:
            s.still[i] += 1
            s.stalled_s[i] += p.dt_s * abs(s.duty[i])
        else:
            s.still[i] = 0
            s.stalled_s[i] = 0.0
    s.yaw_rad = pole * s.yaw_rad + p.dt_s * yaw_rate_rad_s
    mismatch -= s.yaw_rad
    row.wheel_mismatch_rad = mismatch
    if abs(mismatch) <= p.mismatch_limit_rad:
        s.disagree = 0
        return True
    s.disagree += 1
    return False


@njit
def _reversed_wheels(p, s, mismatch):
    """True where changing the sign of some wheels would explain the mismatch."""
    for some in range(1, 1 << p.wheels):
        total = 0.0
        for i in range(p.wheels):
            if some >> i & 1:
                total += 2.0 * s.part_rad[i]
        if abs(mismatch - total) < SIGN_FIT * abs(mismatch):
            return True
    return False


@njit
def _judge_wheels(p, s, row, limits):
    alarms = 0
    mismatch = row.wheel_mismatch_rad
    fastest = 0.0
    for i in range(p.wheels):
        fastest = max(fastest, abs(row.wheel_rate_rad_s[i]))
        if s.stalled_s[i] > p.stall_duty_s:
            alarms |= frame.ALARM_ENCODER_STATIC
        elif s.still[i] >= p.still_ticks and abs(mismatch) > STILL_SHARE * p.mismatch_limit_rad:
            alarms |= frame.ALARM_ENCODER_STATIC
    if s.disagree >= p.sign_ticks and alarms == 0:
        if _reversed_wheels(p, s, mismatch):
            alarms |= frame.ALARM_ENCODER_SIGN
        elif s.disagree >= p.slip_ticks:
            alarms |= frame.ALARM_WHEEL_SLIP
    s.racing = 0 if fastest < p.race_rad_s else s.racing + 1
    if s.racing >= p.race_ticks:
        alarms |= frame.ALARM_LIFTED
    s.jumps *= p.jump_pole
    if limits & frame.LIMIT_ENCODER_JUMP:
        s.jumps += 1.0
        if s.jumps > JUMPS:
            alarms |= frame.ALARM_ENCODER_JUMP
    return alarms


@njit
def _judge_motors(p, s, row, command, limits):
    alarms = 0
    clipped = 0.0
    if limits & frame.LIMIT_WHEEL_SATURATED:
        clipped = 1.0
        largest = 0.0
        for i in range(p.wheels):
            largest = max(largest, abs(command[i]))
        for i in range(p.wheels):  # all clipped commands have the same size
            run = 0
            if command[i] == largest:
                run = max(s.clipped[i], 0) + 1
            elif command[i] == -largest:
                run = min(s.clipped[i], 0) - 1
            s.clipped[i] = run
            if abs(run) >= p.saturation_ticks:
                alarms |= frame.ALARM_SATURATED
    else:
        for i in range(p.wheels):
            s.clipped[i] = 0
    s.saturation = p.saturation_pole * s.saturation + (1.0 - p.saturation_pole) * clipped
    for i in range(p.wheels):
        s.duty[i] = row.duty[i]
    return alarms


@njit
def judge(p, s, row, command, battery_v, limits):
    """At the end of an armed tick: alarms, further limit bits, and the drive that the next tick is allowed.

    Args:
        command: (wheels,) wheel commands after clipping.
        battery_v: smoothed battery voltage in use; nominal where no reading is plausible.
        limits: bits of this tick so far.

    Returns:
        (alarm bits, limit bits).
    """
    alarms = _judge_wheels(p, s, row, limits) | _judge_motors(p, s, row, command, limits)
    more = 0
    allowed = 1.0
    s.low = s.low + 1 if battery_v < p.cutoff_v else 0
    if s.low >= p.battery_ticks:
        alarms |= frame.ALARM_BATTERY_LOW
    if battery_v < p.warn_v:
        more |= frame.LIMIT_BATTERY_WARNING
        allowed = min(1.0, max(0.0, (battery_v - p.cutoff_v) / (p.minimum_v - p.cutoff_v)))
    if s.saturation > SATURATION_FREE:
        allowed = min(allowed, max(0.0, 1.0 - (s.saturation - SATURATION_FREE) / (1.0 - SATURATION_FREE)))
    s.allowed = min(allowed, s.allowed + p.recovery)
    row.drive_allowed = s.allowed
    if s.allowed < 1.0:
        more |= frame.LIMIT_DRIVE_REDUCED
    return alarms, more
