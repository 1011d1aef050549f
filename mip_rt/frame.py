"""The frame: everything that is known about one tick, as one table of fields.

The row of the log ring is the working memory of the tick: drivers and supervisor write the inputs, the compiled step reads
them and writes every result in place, and the row is the log. Adding a field is adding one line to `FIELDS`; record
type, log header, monitor, export and documentation follow from it.

All numbers are little-endian float64, int64 or bytes in multiples of eight, so every field is naturally aligned on every machine.
Frames and signs: inertial z up; body rotation R = Rz(yaw) Ry(pitch) Rx(roll). SI units.
"""

from typing import NamedTuple

import numpy as np

ESTIMATORS = 8  # slots: the first estimator controls, the others run in shadow
ESTIMATE = 10  # numbers in an estimate, see ESTIMATE_NAMES

ESTIMATE_NAMES = (
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
    "roll_rate_rad_s",
    "pitch_rate_rad_s",
    "yaw_rate_rad_s",
    "ball_rate_x_rad_s",  # yaw-rotated ball rates (the papers' phi*), as the filters have them
    "ball_rate_y_rad_s",
    "ball_angle_x_rad",  # inertial ball angles, integrated outside the filters; position = r (angle_y, -angle_x)
    "ball_angle_y_rad",
)

# frame.request: what the supervisor asks of the step.
REQUEST_ENGAGED = 1  # estimate and control; otherwise estimators wait, reset to the measured attitude
REQUEST_HEADING_RESET = 2  # the present heading becomes "forward"

# frame.limits: what was limited, replaced or refused in this tick.
LIMITS = {
    "imu_missing": 1 << 0,  # no usable packet: measurement masked, last attitude kept
    "innovation_rejected": 1 << 1,  # a measurement failed its gate
    "not_finite": 1 << 2,  # a number was not finite and was replaced or masked
    "estimator_reset": 1 << 3,  # the controlling estimator was unhealthy and was reset
    "lean_limited": 1 << 4,  # the lean reference was at its limit
    "wheel_saturated": 1 << 5,  # a wheel command beyond full voltage was clipped
    "coast_saturated": 1 << 6,  # the drive/coast inverse asked for more current than the battery gives at this speed
    "tipped": 1 << 7,  # lean beyond limits.tip_rad
    "battery_unknown": 1 << 8,  # no plausible battery reading: nominal voltage assumed
    "encoder_jump": 1 << 9,  # a wheel moved further in one tick than it can
    "covariance_bounded": 1 << 10,  # the variance of an unobservable state was held at its limit
    "remote_lost": 1 << 11,  # no valid frame within the time limit: commands are ramped to zero
    "duty_refused": 1 << 12,  # a non-finite duty was replaced by zero
}
for _name, _bit in LIMITS.items():
    globals()[f"LIMIT_{_name.upper()}"] = _bit


class Field(NamedTuple):
    """One field of the frame: name, numpy type, shape (() for a scalar), unit, meaning."""

    name: str
    dtype: str
    shape: tuple
    unit: str
    meaning: str


# Written by the loop in one stroke before the compiled step; `INPUT_FORMAT` packs them.
INPUTS = (
    Field("tick", "<i8", (), "1", "number of the tick since the start of the loop"),
    Field("edge_ns", "<i8", (), "ns", "kernel timestamp of the IMU's interrupt, CLOCK_MONOTONIC"),
    Field("wake_ns", "<i8", (), "ns", "the loop was awake"),
    Field("read_ns", "<i8", (), "ns", "all sensors were read"),
    Field("missed", "<i8", (), "1", "interrupts that came and went without a tick since the previous row"),
    Field("state", "<i8", (), "1", "supervisor state in force during this tick"),
    Field("request", "<i8", (), "bits", "what the supervisor asks of the step (REQUEST_*)"),
    Field("imu_status", "<i8", (), "bits", "result of reading the IMU (IMU_*)"),
    Field("imu_backlog", "<i8", (), "1", "packets that were waiting beside the newest"),
    Field("encoder_count", "<i8", (3,), "1", "unwrapped eQEP counts by motor, before sign and scale"),
    Field("battery_v", "<f8", (), "V", "battery as last read; NaN where implausible"),
    Field("remote_velocity_m_s", "<f8", (2,), "m/s", "drive command, inertial x and y, after dead-man"),
    Field("remote_yaw_rate_rad_s", "<f8", (), "rad/s", "spin command after dead-man"),
    Field("remote_age_s", "<f8", (), "s", "age of the last valid frame; infinity before the first"),
    Field("drive_scale", "<f8", (), "1", "soft start: factor on the wheel commands, 0 to 1"),
)
INPUT_FORMAT = "<" + "".join(f"{int(np.prod(f.shape))}{'q' if 'i8' in f.dtype else 'd'}" for f in INPUTS)

FIELDS = (
    Field("sequence", "<i8", (), "1", "commit counter: equals tick + 1 once the row is complete"),
    *INPUTS,
    Field("imu_packet", "|u1", (32,), "bytes", "newest DMP packet: quaternion q30, accelerometer, gyro, gesture"),
    Field("quaternion", "<f8", (4,), "1", "DMP attitude w, x, y, z, body to inertial, normalised"),
    Field("attitude_rad", "<f8", (3,), "rad", "DMP roll, pitch, yaw (yaw unwrapped)"),
    Field("gyro_rad_s", "<f8", (3,), "rad/s", "body rates in body axes, bias removed"),
    Field("acceleration_m_s2", "<f8", (3,), "m/s^2", "R'([0, 0, -g] - p'') in body axes, the papers' sign"),
    Field("wheel_angle_rad", "<f8", (3,), "rad", "wheel angles"),
    Field("wheel_rate_rad_s", "<f8", (3,), "rad/s", "wheel rates from the 6-tap derivative filter"),
    Field("body_angle_rad", "<f8", (3,), "rad", "ball angle relative to the body, from the encoders (phi_B)"),
    Field("limits", "<i8", (), "bits", "what was limited, replaced or refused (LIMIT_*)"),
    Field("estimates", "<f8", (ESTIMATORS, ESTIMATE), "rad, rad/s", "one row an estimator, see ESTIMATE_NAMES"),
    Field("estimator_flags", "<i8", (ESTIMATORS,), "bits", "flags of each estimator (estimators.ekf)"),
    Field("state_estimate", "<f8", (16,), "rad, rad/s", "full state vector of the estimator in control"),
    Field("state_variance", "<f8", (16,), "rad^2", "diagonal of its covariance"),
    Field("innovation", "<f8", (8,), "rad/s, rad, m/s^2", "its innovations: gyro, encoders, accelerometer"),
    Field("gains", "<f8", (9,), "1/rad, s/rad", "gains in force: c1 to c6, SLC gain, SLC pole, low-pass (rad/s)"),
    Field("reference_velocity_rad_s", "<f8", (2,), "rad/s", "reference of the ball's inertial rates"),
    Field("reference_angle_rad", "<f8", (2,), "rad", "reference of the ball's inertial angles"),
    Field("reference_yaw_rad", "<f8", (2,), "rad, rad/s", "reference of yaw and yaw rate"),
    Field("reference_lean_rad", "<f8", (4,), "rad, rad/s", "outer loop: lean x, y and lean rate x, y"),
    Field("error", "<f8", (10,), "rad, rad/s", "reference - estimate: tilt, yaw, ball angle, their rates"),
    Field("command_feedback", "<f8", (3,), "1", "body command of the state feedback"),
    Field("command_friction", "<f8", (3,), "1", "what friction compensation adds"),
    Field("command_wheel", "<f8", (3,), "1", "wheel commands of the linear motor model, clipped"),
    Field("command_applied", "<f8", (3,), "1", "body command after clipping, less compensation: what estimators are told"),
    Field("duty", "<f8", (3,), "1", "signed duty by wheel after voltage scaling and drive/coast inverse"),
    Field("duty_ns", "<i8", (3,), "ns", "signed PWM pulse by motor asked of the motors"),
    Field("applied_ns", "<i8", (3,), "ns", "signed PWM pulse that the supervisor let through"),
    Field("fault", "<i8", (), "1", "fault code of the supervisor, 0 where none"),
    Field("step_ns", "<i8", (), "ns", "the compiled step had ended"),
    Field("write_ns", "<i8", (), "ns", "the motors were written"),
)


def record_dtype() -> np.dtype:
    """The aligned record type of a frame."""
    return np.dtype([(f.name, f.dtype, f.shape) if f.shape else (f.name, f.dtype) for f in FIELDS], align=True)


FRAME = record_dtype()
INPUT_OFFSET = FRAME.fields["tick"][1]
PACKET_OFFSET = FRAME.fields["imu_packet"][1]
