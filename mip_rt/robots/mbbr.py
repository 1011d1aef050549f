"""The micro ball-balancing robot: its compiled step, from the raw sensors in a frame to the duties in the same frame.

One call a tick: `step(parameters, state, estimator parameters, estimator states, ring, row)`. Deterministic and total: the same
parameters, state and sensor fields give the same outputs; nothing is allocated, nothing is raised, failures become bits of
`frame.limits`. Estimators are slots of one array: slot 0 controls, the others run on the same samples in shadow.
"""

import math

import numpy as np

from mip_rt import frame
from mip_rt.compiled import entry, njit
from mip_rt.controllers import gain_schedule, reference, spin_down, state_feedback, wheel_drive
from mip_rt.estimators import ekf, mbbr_ekf, mbbr_kf, momentum_observer, odometry
from mip_rt.robots import battery, health, limit_bits, mbbr_sensors, onboard, sensors
from mip_rt.robots.mbbr_frame import FRAME

KIND_EKF = 0
KIND_KF = 1
KIND_MOMENTUM = 2

PARAMETERS = np.dtype(
    [
        ("sensors", mbbr_sensors.PARAMETERS),
        ("reference", reference.PARAMETERS),
        ("schedule", gain_schedule.PARAMETERS),
        ("feedback", state_feedback.PARAMETERS),
        ("drive", wheel_drive.PARAMETERS),
        ("spin_down", spin_down.PARAMETERS),
        ("health", health.PARAMETERS),
        ("dt_s", "f8"),
        ("tip_rad", "f8"),
        ("nominal_voltage_v", "f8"),
        ("odometry", "i8"),  # 1: ball angle from encoders and gyro; 0: integral of the filter's ball rate
        ("battery_pole", "f8"),  # smooths the battery reading used for voltage scaling
        ("battery_hold_ticks", "i8"),  # so long the last good reading counts, then the nominal voltage
        ("attitude", onboard.PARAMETERS),
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("sensors", mbbr_sensors.STATE),
        ("reference", reference.STATE),
        ("schedule", gain_schedule.STATE),
        ("feedback", state_feedback.STATE),
        ("odometry", odometry.STATE),
        ("spin_down", spin_down.STATE),
        ("health", health.STATE),
        ("spin_coupling_rad_s", "f8"),  # what lean and ball rate add to the spin that the wheels show
        ("applied", "f8", (3,)),  # body command in force since the previous tick, as the estimators are told
        ("measured", "f8", (8,)),
        ("measured_kf", "f8", (6,)),
        ("battery_v", "f8"),
        ("battery_unknown", "i8"),  # ticks without a plausible reading
        ("engaged", "i8"),
        ("attitude", onboard.STATE),  # last: its end is scratch
    ],
    align=True,
)
PERSISTENT = STATE.itemsize - onboard.SCRATCH  # bytes of STATE that the next tick reads
ESTIMATOR_PARAMETERS = np.dtype(
    [
        ("kind", "i8"),
        ("dmp_attitude", "i8"),  # 1: roll, pitch and yaw handed to the controller are the DMP's
        ("ekf", mbbr_ekf.PARAMETERS),
        ("kf", mbbr_kf.PARAMETERS),
        ("momentum", momentum_observer.PARAMETERS),
    ],
    align=True,
)
# After the ball angle a momentum_observer.STATE; the other kinds use its filter alone.
ESTIMATOR_STATE = np.dtype([("ball_angle_rad", "f8", (2,)), *((name, kind[0]) for name, kind in momentum_observer.STATE.fields.items())], align=True)
# Bytes of an estimator's record that the next tick reads (what follows is scratch), and those of them that hold the estimate.
_FILTER = ESTIMATOR_STATE.fields["filter"][1]
ESTIMATOR_PERSISTENT = _FILTER + ekf.PERSISTENT
ESTIMATE_BYTES = slice(_FILTER + ekf.STATE.fields["x"][1], _FILTER + ekf.STATE.fields["P"][1])

GYRO_TILT_BITS = 0b00000011
GYRO_YAW_BIT = 0b00000100
ENCODER_BITS = 0b00111000
ACCELEROMETER_BITS = 0b11000000
SPINNING_RAD_S = 0.1  # a yaw rate reference beyond this is a spin


@njit
def _valid_for_kf(valid):
    """The six-measurement mask of the KF from the eight-measurement mask: gyro and encoder z are left out."""
    return (valid & 0b11) | ((valid >> 3 & 0b11) << 2) | ((valid >> 6 & 0b11) << 4)


@njit
def _reset_estimator(p, s, row):
    roll, pitch, yaw = row.attitude_rad[0], row.attitude_rad[1], row.attitude_rad[2]
    if p.kind == KIND_EKF:
        mbbr_ekf.reset(p.ekf, s.filter, roll, pitch, yaw, row.body_angle_rad, row.gyro_rad_s)
    elif p.kind == KIND_KF:
        mbbr_kf.reset(p.kf, s.filter, roll, pitch, row.body_angle_rad, row.gyro_rad_s)
    else:
        momentum_observer.reset(p.momentum, s, roll, pitch, row.body_angle_rad, row.gyro_rad_s)


@njit
def _estimate(p, s, common, rolled, row, slot):
    """Writes the slot's estimate from its filter, and adds what the ball has rolled to its inertial ball angles."""
    out = row.estimates[slot]
    x = s.filter.x
    if p.kind == KIND_EKF:
        for i in range(3):
            out[i] = x[i]
        for i in range(5):
            out[3 + i] = x[5 + i]
    elif p.kind == KIND_MOMENTUM:
        momentum_observer.show(p.momentum, s, out)
        out[2] = row.attitude_rad[2]
    else:
        out[0] = x[0]
        out[1] = x[1]
        out[2] = row.attitude_rad[2]
        out[3] = x[4]
        out[4] = x[5]
        out[5] = row.gyro_rad_s[2]
        out[6] = x[6]
        out[7] = x[7]
    if p.dmp_attitude == 1:
        # Yaw, too: the filter's is unobservable and, first order in the tilt, loses 15 mrad a second at 1 Hz and 4 degrees of lean.
        for i in range(3):
            out[i] = row.attitude_rad[i]
    cosine = math.cos(out[2])
    sine = math.sin(out[2])
    if common.odometry == 1:
        odometry.add(rolled, out[0], out[1], cosine, sine, 0.5 * common.dt_s * out[5], s.ball_angle_rad)
    else:
        s.ball_angle_rad[0] += common.dt_s * (cosine * out[6] - sine * out[7])
        s.ball_angle_rad[1] += common.dt_s * (sine * out[6] + cosine * out[7])
    out[8] = s.ball_angle_rad[0]
    out[9] = s.ball_angle_rad[1]


@njit
def _run_estimators(p, s, ep, es, row, valid, fresh_start):
    """One cycle of every slot; returns the bits of frame.LIMITS that concern the estimator in control."""
    limits = 0
    y = s.measured
    for i in range(3):
        y[i] = row.gyro_rad_s[i]
        y[3 + i] = row.body_angle_rad[i]
    y[6] = row.acceleration_m_s2[0]
    y[7] = row.acceleration_m_s2[1]
    six = s.measured_kf
    for i in range(2):
        six[i] = y[i]
        six[2 + i] = y[3 + i]
        six[4 + i] = y[6 + i]
    if fresh_start:
        odometry.reset(s.odometry, row.body_angle_rad, row.gyro_rad_s)
    else:
        odometry.step(s.odometry, row.body_angle_rad, row.gyro_rad_s, p.dt_s)
    for slot in range(len(ep)):
        pe = ep[slot]
        se = es[slot]
        if fresh_start:
            _reset_estimator(pe, se, row)
            se.ball_angle_rad[0] = 0.0
            se.ball_angle_rad[1] = 0.0
        elif pe.kind == KIND_EKF:
            mbbr_ekf.step(pe.ekf, se.filter, s.applied, y, valid)
        elif pe.kind == KIND_KF:
            mbbr_kf.step(pe.kf, se.filter, s.applied, six, _valid_for_kf(valid), row.gyro_rad_s[2])
        else:
            momentum_observer.step(pe.momentum, se, y, valid)
        flags = se.filter.status
        row.estimator_flags[slot] = flags
        if flags & ekf.UNHEALTHY:
            _reset_estimator(pe, se, row)
        _estimate(pe, se, p, s.odometry, row, slot)
        if slot == 0:
            limits = limit_bits.of_filter(flags)
    control = es[0].filter
    for i in range(16):
        row.state_estimate[i] = control.x[i]
        row.state_variance[i] = control.P[i, i]
    for i in range(8):
        row.innovation[i] = control.innovation[i]
    return limits


@njit
def _control(p, s, row):
    """References, feedback, compensation, wheel commands; returns limit bits."""
    limits = 0
    estimate = row.estimates[0]
    ref = s.reference
    allowed = s.health.allowed
    losing = s.spin_down.active == 1
    if reference.step(
        p.reference,
        ref,
        allowed * row.remote_velocity_m_s[0],
        allowed * row.remote_velocity_m_s[1],
        0.0 if losing else allowed * row.remote_yaw_rate_rad_s,
        estimate,
    ):
        limits |= frame.LIMIT_REFERENCE_HELD
    gain_schedule.step(p.schedule, s.schedule, 0.0 if losing else ref.yaw_rate_rad_s)
    bits = state_feedback.step(
        p.feedback, s.feedback, ref, s.schedule.gains, estimate, row.error, row.reference_lean_rad, row.command_feedback
    )
    if bits & state_feedback.LEAN_LIMITED:
        limits |= frame.LIMIT_LEAN_LIMITED
    if bits & state_feedback.LEAN_RATE_LIMITED:
        limits |= frame.LIMIT_LEAN_RATE_LIMITED
    spinning = row.remote_yaw_rate_rad_s != 0.0 or abs(ref.yaw_rate_rad_s) > SPINNING_RAD_S
    if spin_down.step(p.spin_down, s.spin_down, spinning, row.error):
        limits |= frame.LIMIT_SPIN_DOWN
    wheel_drive.friction_add(p.drive, estimate, row.command_friction)
    limits |= battery.step(p, s, row)
    bits = wheel_drive.step(
        p.drive,
        row.command_feedback,
        row.command_friction,
        row.drive_scale,
        row.wheel_rate_rad_s,
        s.battery_v,
        row.command_wheel,
        row.command_applied,
        row.duty,
        row.duty_ns,
    )
    limits |= limit_bits.of_drive(bits)
    for i in range(2):
        row.reference_velocity_rad_s[i] = ref.rate_rad_s[i]
        row.reference_angle_rad[i] = ref.angle_rad[i]
    row.reference_yaw_rad[0] = ref.yaw_rad
    row.reference_yaw_rad[1] = ref.yaw_rate_rad_s
    for i in range(gain_schedule.GAINS):
        row.gains[i] = s.schedule.gains[i]
    return limits


@njit
def _rest(row):
    """Outputs of a tick without control: zero commands, and zero wherever nothing is estimated or wanted.

    Every output is written in every tick: a row of the ring still holds what was true one turn of the ring ago.
    """
    for i in range(16):
        row.state_estimate[i] = 0.0
        row.state_variance[i] = 0.0
    for i in range(8):
        row.innovation[i] = 0.0
    for i in range(gain_schedule.GAINS):
        row.gains[i] = 0.0
    for i in range(2):
        row.reference_velocity_rad_s[i] = 0.0
        row.reference_angle_rad[i] = 0.0
        row.reference_yaw_rad[i] = 0.0
    for i in range(10):
        row.error[i] = 0.0
    for i in range(4):
        row.reference_lean_rad[i] = 0.0
    for i in range(3):
        row.command_feedback[i] = 0.0
        row.command_friction[i] = 0.0
        row.command_wheel[i] = 0.0
        row.command_applied[i] = 0.0
        row.duty[i] = 0.0
        row.duty_ns[i] = 0
    row.drive_allowed = 1.0
    row.wheel_mismatch_rad = 0.0


@njit
def _finite(row):
    """True where estimate, errors and commands of an engaged tick are finite."""
    total = 0.0
    for i in range(10):
        total += row.estimates[0, i] + row.error[i]
    for i in range(3):
        total += row.command_feedback[i] + row.command_wheel[i]
    return abs(total) < math.inf


TYPES = PARAMETERS, STATE, ESTIMATOR_PARAMETERS, ESTIMATOR_STATE, FRAME, "int64"


@entry(*TYPES)
def step(parameters, state, estimator_parameters, estimator_states, ring, index):
    """One tick of the robot: reads the raw sensor fields of ring[index] and writes all other fields of that row.

    Args:
        parameters: (1,) PARAMETERS.
        state: (1,) STATE.
        estimator_parameters: (n,) ESTIMATOR_PARAMETERS, slot 0 controls.
        estimator_states: (n,) ESTIMATOR_STATE.
        ring: (rows,) mbbr_frame.FRAME.
        index: row of this tick.

    Returns:
        imu_status, limits and alarms of the row in one number: see frame.STATUS_AT.
    """
    p = parameters[0]
    s = state[0]
    row = ring[index]
    limits = mbbr_sensors.step(p.sensors, s.sensors, p.attitude, s.attitude, row)
    valid = mbbr_ekf.ALL_VALID
    if limits & frame.LIMIT_IMU_MISSING:
        valid &= ~(GYRO_TILT_BITS | ACCELEROMETER_BITS)
        if s.sensors.coasted >= sensors.COAST_TICKS:  # before that the yaw rate is as good as new, and the model's poorer
            valid &= ~GYRO_YAW_BIT
    if limits & frame.LIMIT_ENCODER_JUMP:
        valid &= ~ENCODER_BITS
    lean = math.cos(row.attitude_rad[0]) * math.cos(row.attitude_rad[1])
    if not lean > math.cos(p.tip_rad):
        limits |= frame.LIMIT_TIPPED
    alarms = health.check_timing(p.health, s.health, row, limits)

    if row.request & frame.REQUEST_ENGAGED:
        start = s.engaged == 0
        if start:
            health.reset(p.health, s.health, row)
            s.spin_coupling_rad_s = 0.0
        if not health.check_wheels(p.health, s.health, row, s.spin_coupling_rad_s - row.gyro_rad_s[2], lean):
            limits |= frame.LIMIT_WHEELS_DISAGREE
            valid &= ~ENCODER_BITS
        limits |= _run_estimators(p, s, estimator_parameters, estimator_states, row, valid, start)
        if start:
            reference.reset(s.reference, row.estimates[0, 2], row.estimates[0, 8], row.estimates[0, 9])
            gain_schedule.reset(p.schedule, s.schedule)
            state_feedback.reset(s.feedback)
            s.spin_down.active = 0
        if row.request & frame.REQUEST_HEADING_RESET:
            s.reference.forward_yaw_rad = row.estimates[0, 2]
        limits |= _control(p, s, row)
        if not _finite(row):
            limits |= frame.LIMIT_NOT_FINITE
        found, more = health.judge(p.health, s.health, row, row.command_wheel, s.battery_v, limits)
        alarms |= found
        limits |= more
        estimate = row.estimates[0]
        s.spin_coupling_rad_s = estimate[1] * estimate[6] - estimate[0] * estimate[7]
        s.engaged = 1
    else:
        s.engaged = 0
        _rest(row)
        for slot in range(len(estimator_parameters)):
            estimate = row.estimates[slot]
            for i in range(3):
                estimate[i] = row.attitude_rad[i]
                estimate[3 + i] = row.gyro_rad_s[i]
            for i in range(6, 10):
                estimate[i] = 0.0
            row.estimator_flags[slot] = 0
        limits |= battery.rest(p, s, row)
    for i in range(3):
        applied = row.command_applied[i]
        if not abs(applied) < math.inf:
            applied = 0.0
            limits |= frame.LIMIT_NOT_FINITE
        s.applied[i] = applied
    row.limits = limits
    row.alarms = alarms
    return row.imu_status << frame.STATUS_AT | row.limits << frame.LIMITS_AT | row.alarms << frame.ALARMS_AT  # fields: 64 bits on any machine
