"""The eduMIP: its compiled step, from the raw sensors in a frame to the duties in the same frame.

One call a tick, deterministic and total, as `robots.mbbr`. Estimators are slots of one array: slot 0 controls, the others run on the same
samples in shadow.
"""

import math

import numpy as np

from mip_rt import frame
from mip_rt.compiled import entry, njit
from mip_rt.controllers import mip_drive, mip_feedback, mip_reference, pid, successive_loop
from mip_rt.estimators import complementary, complementary_kf, ekf, mip_ekf, mip_planar_kf
from mip_rt.robots import battery, edumip_sensors, health, limit_bits, onboard, sensors
from mip_rt.robots import edumip_imu_slots as imu_slots
from mip_rt.robots.edumip_frame import FRAME

KIND_EKF, KIND_PLANAR, KIND_COMPLEMENTARY, KIND_COMPLEMENTARY_KF, KIND_DMP = 0, 1, 2, 3, 4
LQR, SUCCESSIVE_LOOP, PID = 0, 1, 2

PARAMETERS = np.dtype(
    [
        ("sensors", edumip_sensors.PARAMETERS),
        ("reference", mip_reference.PARAMETERS),
        ("feedback", mip_feedback.PARAMETERS),
        ("loops", successive_loop.PARAMETERS),
        ("pid", pid.PARAMETERS),
        ("drive", mip_drive.PARAMETERS),
        ("health", health.PARAMETERS),
        ("controller", "i8"),
        ("wheel_radius_m", "f8"),
        ("tip_rad", "f8"),
        ("nominal_voltage_v", "f8"),
        ("battery_pole", "f8"),
        ("battery_hold_ticks", "i8"),  # so long the last good reading counts, then the nominal voltage
        ("attitude", onboard.PARAMETERS),
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("sensors", edumip_sensors.STATE),
        ("reference", mip_reference.STATE),
        ("feedback", mip_feedback.STATE),
        ("loops", successive_loop.STATE),
        ("pid", pid.STATE),
        ("health", health.STATE),
        ("applied", "f8", (2,)),  # u_x, u_z in force since the previous tick, as the estimators are told
        ("measured", "f8", (4,)),
        ("rate", "f8", (1,)),
        ("tilt", "f8", (1,)),
        ("imu", imu_slots.STATE),
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
        ("dmp_attitude", "i8"),  # 1: the lean handed to the controller is the DMP's
        ("ekf", mip_ekf.PARAMETERS),
        ("planar", mip_planar_kf.PARAMETERS),
        ("complementary", complementary.PARAMETERS),
        ("complementary_kf", complementary_kf.PARAMETERS),
        ("imu", imu_slots.PARAMETERS),
    ],
    align=True,
)
ESTIMATOR_STATE = np.dtype([("filter", ekf.STATE)], align=True)
# Bytes of an estimator's record that the next tick reads (what follows is scratch), and those of them that hold the estimate.
ESTIMATOR_PERSISTENT = ekf.PERSISTENT
ESTIMATE_BYTES = slice(ekf.STATE.fields["x"][1], ekf.STATE.fields["P"][1])

# Bits of the EKF's mask; the planar filter has the first three.
PHI_BIT, GYRO_BIT, ACCELEROMETER_BIT, YAW_BIT = 1, 2, 4, 8


@njit
def _reset_estimator(p, s, row):
    lean = row.attitude_rad[0]
    rate = row.gyro_rad_s[0]
    if p.kind == KIND_EKF:
        mip_ekf.reset(p.ekf, s.filter, lean, row.phi_rad, row.encoder_yaw_rad, rate, row.gyro_rad_s[2])
    elif p.kind == KIND_PLANAR:
        mip_planar_kf.reset(p.planar, s.filter, lean, row.phi_rad, rate)
    elif p.kind == KIND_COMPLEMENTARY:
        complementary.reset(p.complementary, s.filter, lean)
    elif p.kind == KIND_COMPLEMENTARY_KF:
        complementary_kf.reset(p.complementary_kf, s.filter, lean)
    elif p.kind >= imu_slots.FIRST:
        imu_slots.reset(p.kind, p.imu, s.filter, row)
    else:
        _show_dmp(s.filter, row)


@njit
def _show_dmp(s, row):
    """The DMP is no filter of ours; its lean stands where a filter has its state."""
    for i in range(ekf.ROW):
        s.x[i] = 0.0
    s.x[0] = row.attitude_rad[0]
    s.status = 0


@njit
def _advance(p, s, state, row, valid):
    """One cycle of one estimator; `state` is the robot's, with the measurements."""
    y = state.measured
    if p.kind == KIND_EKF:
        if p.dmp_attitude == 1:
            # The DMP has used the accelerometer already; and a command that acts later than told would bend the lean most through it.
            s.filter.x[0] = row.attitude_rad[0]
            valid &= ~ACCELEROMETER_BIT
        mip_ekf.step(p.ekf, s.filter, state.applied, y, valid)
    elif p.kind == KIND_PLANAR:
        mip_planar_kf.step(p.planar, s.filter, state.applied, y, valid & mip_planar_kf.ALL_VALID)
    elif p.kind == KIND_DMP:
        _show_dmp(s.filter, row)
    elif p.kind >= imu_slots.FIRST:
        imu_slots.step(p.kind, p.imu, s.filter, state.imu, row, valid & PHI_BIT != 0, valid & GYRO_BIT != 0, valid & ACCELEROMETER_BIT != 0)
    else:
        imu = complementary.GYRO_VALID if valid & GYRO_BIT else 0
        if valid & ACCELEROMETER_BIT:
            imu |= complementary.ACCELEROMETER_VALID
        if p.kind == KIND_COMPLEMENTARY:
            complementary.step(p.complementary, s.filter, state.rate, state.tilt, imu)
        else:
            complementary_kf.step(p.complementary_kf, s.filter, state.rate, state.tilt, imu)


@njit
def _measured(row, out):
    """The estimate as the sensors show it, lean from the DMP: for what a filter does not estimate."""
    out[0] = row.attitude_rad[0]
    out[1] = row.phi_rad
    out[2] = row.encoder_yaw_rad
    out[3] = row.gyro_rad_s[0]
    out[4] = 0.5 * (row.wheel_rate_rad_s[0] + row.wheel_rate_rad_s[1])
    out[5] = row.gyro_rad_s[2] * math.cos(row.attitude_rad[0]) + row.gyro_rad_s[1] * math.sin(row.attitude_rad[0])


@njit
def _estimate(p, s, row, slot):
    """Writes the slot's estimate."""
    out = row.estimates[slot]
    x = s.filter.x
    _measured(row, out)
    if p.kind == KIND_EKF:
        for i in range(6):
            out[i] = x[i]
    elif p.kind == KIND_PLANAR:
        out[0] = x[0]
        out[1] = x[1]
        out[3] = x[2]
        out[4] = x[3]
    elif p.kind >= imu_slots.FIRST:
        imu_slots.estimate(p.kind, s.filter, row, out)
    elif p.kind != KIND_DMP:
        out[0] = x[0]
        if p.kind == KIND_COMPLEMENTARY_KF:
            out[3] -= x[1]
    if p.dmp_attitude == 1:
        out[0] = row.attitude_rad[0]


@njit
def _run_estimators(s, ep, es, row, valid, fresh_start):
    """One cycle of every slot; returns the bits of frame.LIMITS that concern the estimator in control."""
    limits = 0
    s.measured[0] = row.phi_rad
    s.measured[1] = row.gyro_rad_s[0]
    s.measured[2] = row.acceleration_m_s2[1]
    s.measured[3] = row.encoder_yaw_rad
    s.rate[0] = row.gyro_rad_s[0]
    s.tilt[0] = row.accelerometer_tilt_rad
    for slot in range(len(ep)):
        pe = ep[slot]
        se = es[slot]
        if fresh_start:
            _reset_estimator(pe, se, row)
        else:
            _advance(pe, se, s, row, valid)
        flags = se.filter.status
        row.estimator_flags[slot] = flags
        if flags & ekf.UNHEALTHY:
            _reset_estimator(pe, se, row)
        _estimate(pe, se, row, slot)
        if slot == 0:
            limits = limit_bits.of_filter(flags)
    control = es[0].filter
    for i in range(8):
        row.state_estimate[i] = control.x[i]
        row.state_variance[i] = control.P[i, i]
    for i in range(4):
        row.innovation[i] = control.innovation[i]
    return limits


@njit
def _control(p, s, row):
    """References, controller, compensation, wheel commands; returns limit bits."""
    limits = 0
    estimate = row.estimates[0]
    ref = s.reference
    wheel = estimate[1] + estimate[0]
    allowed = s.health.allowed
    mip_reference.step(
        p.reference, ref, allowed * row.remote_velocity_m_s[0], allowed * row.remote_velocity_m_s[1],
        allowed * row.remote_yaw_rate_rad_s, wheel, estimate[2],
    )  # fmt: skip
    error = row.error
    error[0] = -estimate[0]
    error[1] = ref.wheel_rad - wheel
    error[2] = ref.yaw_rad - estimate[2]
    error[3] = -estimate[3]
    error[4] = ref.wheel_rate_rad_s - estimate[4] - estimate[3]
    error[5] = ref.yaw_rate_rad_s - estimate[5]
    row.reference_lean_rad = 0.0
    for i in range(mip_feedback.GAINS):
        row.gains[i] = 0.0
    if p.controller == SUCCESSIVE_LOOP:
        forward, lean = successive_loop.step(p.loops, s.loops, error[1], estimate[0], ref.yaw_rate_rad_s)
        row.command_feedback[0] = forward
        row.command_feedback[1] = mip_feedback.yaw_command(p.feedback, error)
        row.reference_lean_rad = lean
        error[0] = lean - estimate[0]
        if abs(lean) >= p.loops.outer.limit:
            limits |= frame.LIMIT_LEAN_LIMITED
    elif p.controller == PID:
        pid.step(p.pid, s.pid, error, p.wheel_radius_m, row.command_feedback)
    else:
        mip_feedback.step(p.feedback, s.feedback, error, ref.wheel_rate_rad_s, ref.yaw_rate_rad_s, row.command_feedback)
        for i in range(mip_feedback.GAINS):
            row.gains[i] = s.feedback.gains[i]
    mip_drive.friction_add(p.drive, estimate[4], estimate[5], row.command_friction)
    limits |= battery.step(p, s, row)
    bits = mip_drive.step(
        p.drive, row.command_feedback, row.command_friction, row.drive_scale, row.wheel_rate_rad_s, s.battery_v, row.command_wheel,
        row.command_applied, row.duty, row.duty_ns,
    )  # fmt: skip
    limits |= limit_bits.of_drive(bits)
    row.reference_velocity_rad_s = ref.wheel_rate_rad_s
    row.reference_angle_rad = ref.wheel_rad
    row.reference_yaw_rad[0] = ref.yaw_rad
    row.reference_yaw_rad[1] = ref.yaw_rate_rad_s
    return limits


@njit
def _rest(row):
    """Outputs of a tick without control: zero commands, and zero wherever nothing is estimated or wanted (every output, every tick)."""
    for i in range(8):
        row.state_estimate[i] = 0.0
        row.state_variance[i] = 0.0
    for i in range(4):
        row.innovation[i] = 0.0
    for i in range(mip_feedback.GAINS):
        row.gains[i] = 0.0
    row.reference_velocity_rad_s = 0.0
    row.reference_angle_rad = 0.0
    for i in range(6):
        row.error[i] = 0.0
    row.reference_lean_rad = 0.0
    for i in range(2):
        row.reference_yaw_rad[i] = 0.0
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
    for i in range(6):
        total += row.estimates[0, i] + row.error[i]
    for i in range(2):
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
        ring: (rows,) edumip_frame.FRAME.
        index: row of this tick.

    Returns:
        imu_status, limits and alarms of the row in one number: see frame.STATUS_AT.
    """
    p = parameters[0]
    s = state[0]
    row = ring[index]
    limits = edumip_sensors.step(p.sensors, s.sensors, p.attitude, s.attitude, row)
    valid = mip_ekf.ALL_VALID
    if limits & frame.LIMIT_IMU_MISSING:
        valid &= ~ACCELEROMETER_BIT
        if s.sensors.coasted >= sensors.COAST_TICKS:
            valid &= ~GYRO_BIT
    if limits & frame.LIMIT_ENCODER_JUMP:
        valid &= ~(PHI_BIT | YAW_BIT)
    lean = math.cos(row.attitude_rad[0]) * math.cos(row.attitude_rad[1])
    if not lean > math.cos(p.tip_rad):
        limits |= frame.LIMIT_TIPPED
    alarms = health.check_timing(p.health, s.health, row, limits)

    if row.request & frame.REQUEST_ENGAGED:
        start = s.engaged == 0
        if start:
            health.reset(p.health, s.health, row)
        lean_rad = row.attitude_rad[0]
        yaw_rate = row.gyro_rad_s[2] * math.cos(lean_rad) + row.gyro_rad_s[1] * math.sin(lean_rad)
        if not health.check_wheels(p.health, s.health, row, yaw_rate, lean):
            limits |= frame.LIMIT_WHEELS_DISAGREE
            valid &= ~(PHI_BIT | YAW_BIT)
        limits |= _run_estimators(s, estimator_parameters, estimator_states, row, valid, start)
        if start:
            mip_reference.reset(s.reference, row.estimates[0, 1] + row.estimates[0, 0], row.estimates[0, 2])
            mip_feedback.reset(s.feedback)
            successive_loop.reset(s.loops)
            pid.reset(s.pid)
        if row.request & frame.REQUEST_HEADING_RESET:
            s.reference.yaw_rad = row.estimates[0, 2]
        limits |= _control(p, s, row)
        if not _finite(row):
            limits |= frame.LIMIT_NOT_FINITE
        found, more = health.judge(p.health, s.health, row, row.command_wheel, s.battery_v, limits)
        alarms |= found
        limits |= more
        s.engaged = 1
    else:
        s.engaged = 0
        _rest(row)
        for slot in range(len(estimator_parameters)):
            _measured(row, row.estimates[slot])
            row.estimator_flags[slot] = 0
        limits |= battery.rest(p, s, row)
    for i in range(2):
        applied = row.command_applied[i]
        if not abs(applied) < math.inf:
            applied = 0.0
            limits |= frame.LIMIT_NOT_FINITE
        s.applied[i] = applied
    row.limits = limits
    row.alarms = alarms
    return row.imu_status << frame.STATUS_AT | row.limits << frame.LIMITS_AT | row.alarms << frame.ALARMS_AT  # fields: 64 bits on any machine
