"""The frame: everything that is known about one tick, as one table of fields.

The row of the log ring is the working memory of the tick: drivers and supervisor write the inputs, the compiled step reads
them and writes every result in place, and the row is the log. Fields that every robot has stand here, a robot's own in
`robots/*_frame.py`; adding one is adding one line, and record type, log header, monitor, export and documentation follow from it.

All numbers are little-endian float64, int64 or bytes in multiples of eight, so every field is naturally aligned on every machine.
Frames and signs: inertial z up; body rotation R = Rz(yaw) Ry(pitch) Rx(roll). SI units.
"""

import math
import struct
from typing import NamedTuple

import numpy as np

ESTIMATORS = 8  # slots: the first estimator controls, the others run in shadow

# frame.request: what the supervisor asks of the step.
REQUEST_ENGAGED = 1  # estimate and control; otherwise estimators wait, reset to the measured attitude
REQUEST_HEADING_RESET = 2  # the present heading becomes "forward"

# frame.limits: what was limited, replaced or refused in this tick; bit i is the i-th entry, so new ones go to the end.
LIMIT_SENTENCES = {
    "imu_missing": "no usable packet: measurement masked, last attitude kept",
    "innovation_rejected": "a measurement failed its gate",
    "not_finite": "a number was not finite and was replaced or masked",
    "estimator_reset": "the controlling estimator was unhealthy and was reset",
    "lean_limited": "the lean reference was at its limit",
    "wheel_saturated": "a wheel command beyond full voltage was clipped",
    "coast_saturated": "the drive/coast inverse asked for more current than the battery gives at this speed",
    "tipped": "the robot leans beyond limits.tip_rad",
    "battery_unknown": "no plausible battery reading: nominal voltage assumed",
    "encoder_jump": "a wheel moved further in one tick than it can",
    "covariance_bounded": "the variance of an unobservable state was held at its limit",
    "remote_lost": "no valid frame within the time limit: commands are ramped to zero",
    "duty_refused": "a non-finite duty was replaced by zero",
    "lean_rate_limited": "the lean rate reference was at its limit",
    "reference_held": "the position or heading reference waits for the robot",
    "wheels_disagree": "wheels and gyro disagree about the spin: encoders masked",
    "drive_reduced": "drive and spin commands are scaled down: motors at their limit, or battery below battery.minimum_v",
    "spin_down": "balance was being lost while spinning: spin command taken away until calm",
    "battery_warning": "the battery is below battery.warn_v",
}
LIMITS = {name: 1 << i for i, name in enumerate(LIMIT_SENTENCES)}
for _name, _bit in LIMITS.items():
    globals()[f"LIMIT_{_name.upper()}"] = _bit
LOOP_LIMITS = LIMITS["remote_lost"]  # bits that the loop adds after the step; all others are the step's

# What a step returns: imu_status, limits and alarms in one number, from these bits on; below is room for the supervisor's own conditions.
STATUS_AT, LIMITS_AT, ALARMS_AT = 8, 20, 44

# frame.alarms: what the detectors of the step (robots.health) have found; each is a fault of the same name while balancing.
ALARM_SENTENCES = {
    "imu_unreliable": "more than 3 of 10 IMU packets were unusable over the last half second",
    "imu_rate": "the interval of the IMU's interrupts, smoothed over a second, is off by more than limits.rate_tolerance",
    "encoder_static": "a count stands still while its motor is driven, or while the other wheels and the gyro contradict it",
    "encoder_jump": "five counts that a wheel cannot have made, within a quarter of a second",
    "encoder_sign": "wheels and gyro disagree for 50 ms, and agree once the sign of one or more wheels is changed",
    "wheel_slip": "wheels and gyro disagree for a quarter of a second",
    "lifted": "a wheel runs at more than limits.race_share of its no-load speed for 0.1 s",
    "saturated": "one wheel's command is clipped in the same direction for limits.saturation_s",
    "battery_low": "the smoothed battery voltage is below battery.cutoff_v for 2 s",
    "overrun": "more than one tick was missed for every two made, smoothed over half a second",
}
ALARMS = {name: 1 << i for i, name in enumerate(ALARM_SENTENCES)}
for _name, _bit in ALARMS.items():
    globals()[f"ALARM_{_name.upper()}"] = _bit


class Field(NamedTuple):
    """One field of the frame: name, numpy type, shape (() for a scalar), unit, meaning."""

    name: str
    dtype: str
    shape: tuple
    unit: str
    meaning: str


def inputs(wheels: int) -> tuple[Field, ...]:
    """What is there before the compiled step, for a robot of so many wheels: `inputs.gather` writes it."""
    return (
        Field("tick", "<i8", (), "1", "number of the tick since the start of the loop"),
        Field("edge_ns", "<i8", (), "ns", "kernel timestamp of the IMU's interrupt, CLOCK_MONOTONIC"),
        Field("wake_ns", "<i8", (), "ns", "the loop was awake"),
        Field("read_ns", "<i8", (), "ns", "all sensors were read"),
        Field("missed", "<i8", (), "1", "interrupts that came and went without a tick since the previous row"),
        Field("state", "<i8", (), "1", "supervisor state in force during this tick"),
        Field("request", "<i8", (), "bits", "what the supervisor asks of the step (REQUEST_*)"),
        Field("refusals", "<i8", (), "bits", "pre-arm checks that fail at present (prearm.CHECKS)"),
        Field("imu_status", "<i8", (), "bits", "result of reading the IMU (IMU_*)"),
        Field("imu_backlog", "<i8", (), "1", "packets that were waiting beside the newest"),
        Field("battery_v", "<f8", (), "V", "battery as last read; NaN where implausible"),
        Field("remote_velocity_m_s", "<f8", (2,), "m/s", "drive command, inertial x and y, after dead-man"),
        Field("remote_yaw_rate_rad_s", "<f8", (), "rad/s", "spin command after dead-man"),
        Field("remote_age_s", "<f8", (), "s", "age of the last valid frame; infinity before the first"),
        Field("gyro_bias_rad_s", "<f8", (3,), "rad/s", "gyro rates at rest, body axes, subtracted from the measured ones"),
        Field("drive_scale", "<f8", (), "1", "soft start: factor on the wheel commands, 0 to 1"),
        Field("encoder_count", "<i8", (wheels,), "1", "unwrapped eQEP counts by motor, before sign and scale"),
    )


def sensors(wheels: int) -> tuple[Field, ...]:
    """What every robot's step writes first: the sensors in SI units and body axes."""
    return (
        Field("imu_packet", "|u1", (32,), "bytes", "newest packet: DMP quaternion q30, accelerometer, gyro, gesture; onboard attitude: 16 zeros, accelerometer, gyro, temperature, INT_STATUS, 0"),
        Field("quaternion", "<f8", (4,), "1", "attitude (imu.attitude) w, x, y, z, body to inertial, normalised"),
        Field("attitude_rad", "<f8", (3,), "rad", "its roll, pitch, yaw (yaw unwrapped)"),
        Field("gyro_rad_s", "<f8", (3,), "rad/s", "body rates in body axes, bias removed"),
        Field("acceleration_m_s2", "<f8", (3,), "m/s^2", "R'([0, 0, -g] - p'') in body axes, the papers' sign"),
        Field("wheel_angle_rad", "<f8", (wheels,), "rad", "wheel angles"),
        Field("wheel_rate_rad_s", "<f8", (wheels,), "rad/s", "wheel rates from the 6-tap derivative filter"),
    )


def estimation(names: tuple[str, ...]) -> tuple[Field, ...]:
    """What was limited and found wrong, and one row of numbers from each estimator."""
    return (
        Field("limits", "<i8", (), "bits", "what was limited, replaced or refused (LIMIT_*)"),
        Field("alarms", "<i8", (), "bits", "what the detectors have found (ALARM_*)"),
        Field("drive_allowed", "<f8", (), "1", "factor on drive and spin commands, 0 to 1"),
        Field("wheel_mismatch_rad", "<f8", (), "rad", "spin of the wheels less that of the gyro, over the last 0.1 s"),
        Field("estimates", "<f8", (ESTIMATORS, len(names)), "rad, rad/s", "one row an estimator: " + ", ".join(names)),
        Field("estimator_flags", "<i8", (ESTIMATORS,), "bits", "flags of each estimator (estimators.ekf)"),
    )


def pulses(wheels: int) -> tuple[Field, ...]:
    """How every robot's step ends: what it asks of the motors."""
    return (
        Field("duty", "<f8", (wheels,), "1", "signed duty by wheel after voltage scaling and drive/coast inverse"),
        Field("duty_ns", "<i8", (wheels,), "ns", "signed PWM pulse by motor asked of the motors"),
    )


def results(wheels: int) -> tuple[Field, ...]:
    """What is written after the step: what the supervisor made of the pulses, and when (log.commit.RESULTS)."""
    return (
        Field("applied_ns", "<i8", (wheels,), "ns", "signed PWM pulse that the supervisor let through"),
        Field("fault", "<i8", (), "1", "fault code of the supervisor, 0 where none"),
        Field("step_ns", "<i8", (), "ns", "the compiled step had ended"),
        Field("write_ns", "<i8", (), "ns", "the motors were written"),
    )


class Layout:
    """The frame of one robot: common fields around its own. Who writes which field is decided here and nowhere else.

    Args:
        wheels: how many motors and encoders it has.
        estimate_names: names of the numbers in one row of its `estimates` field.
        own: the robot's fields, between estimation and outputs.

    Attributes:
        fields: all Fields in order.
        step_inputs: names of the fields that are there before the step: what the loop packs, and the IMU's bytes.
        step_outputs: names of the fields that the step writes, every one in every tick; of `limits` all bits but LOOP_LIMITS,
            of `estimates` and `estimator_flags` the slots in use.
        dtype: their aligned record type.
        offset: byte offset by name.
        pulses: struct.Struct of applied_ns.
    """

    def __init__(self, wheels: int, estimate_names: tuple[str, ...], own: tuple[Field, ...]):
        self.wheels, self.estimate_names = wheels, estimate_names
        self.input_fields, result_fields = inputs(wheels), results(wheels)
        sequence = Field("sequence", "<i8", (), "1", "commit counter: equals tick + 1 once the row is complete")
        written = (*sensors(wheels), *estimation(estimate_names), *own, *pulses(wheels))
        self.fields = (sequence, *self.input_fields, *written, *result_fields)
        self.step_inputs = (*(f.name for f in self.input_fields), "imu_packet")
        self.step_outputs = tuple(f.name for f in written if f.name != "imu_packet")
        self.dtype = np.dtype([(f.name, f.dtype, f.shape) if f.shape else (f.name, f.dtype) for f in self.fields], align=True)
        self.offset = {name: self.dtype.fields[name][1] for name in self.dtype.names}
        self.pulses = struct.Struct(f"<{wheels}q")
