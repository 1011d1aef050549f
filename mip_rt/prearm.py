"""Before arming: the checks that must pass, as a table, and the calibration of the gyro.

Each check has a bit in the frame's `refusals`, a code, a sentence and a cure. Those that block keep the robot disarmed; the others only
warn: balancing must not depend, for example, on recording. All of it runs between ticks while the motors are off.
"""

import math
from typing import NamedTuple

import numpy as np

STILL_S = 1.0  # length of the window in which the robot must be still
STILL_SPREAD_RAD_S = 0.05  # largest standard deviation of the gyro in it
LARGEST_BIAS_RAD_S = 0.35  # 20 deg/s: the data sheet's zero-rate output is within 5
AGREEMENT_RAD = 0.05  # DMP against accelerometer, averaged over the window


class Check(NamedTuple):
    """A pre-arm check: bit in frame.refusals, code, what is wrong when it fails, what to do, and whether it keeps the robot disarmed."""

    bit: int
    code: str
    sentence: str
    cure: str
    blocks: bool = True


_TABLE = (
    ("self_test", "the supervisor's own test failed.", "Do not use this installation; send the log to the developers."),
    ("imu_starting", "the IMU has not yet sent good packets for 50 ms.", "Wait; if it stays, run mip-rt doctor."),
    ("calibrating", "the gyro's bias is being measured.", "Keep the robot still for a second."),
    ("not_still", "the robot moves, so the gyro's bias cannot be measured.", "Hold it still."),
    ("gyro_bias", "the gyro's rate at rest is too large.", "Hold it still, or replace the IMU."),
    ("gyro_bias_old", "the gyro's bias was measured too long ago.", "Keep the robot still for a second."),
    ("attitude_disagrees", "DMP and accelerometer disagree about what is up.",
     "Wait for the DMP to converge; if it stays, check imu.mounting and imu.dmp_orientation."),
    ("calibration_invalid", "this unit's calibration file cannot be used.", "Repair or remove it: then the bias measured at the start counts."),
    ("calibration_differs", "the gyro's rate at rest is not that of this unit's calibration file.", "Calibrate this unit anew, or remove the file."),
    ("encoder_errors", "an encoder does not answer.", "Run mip-rt doctor."),
    ("battery_unknown", "the battery's voltage is not plausible.", "Check battery.adc_channel and the divider."),
    ("battery_low", "the battery is too low.", "Charge it above battery.minimum_v."),
    ("remote_not_centred", "the remote commands motion.", "Let go of stick and buttons."),
    ("rate_wrong", "the IMU's interrupts are more than 3 % off the configured rate.", "Check the DMP's image and rate."),
    ("realtime_required", "a real-time setting was refused and realtime.strict is set.", "Grant it, as the warning at the start says."),
)  # fmt: skip
_WARNINGS = (
    ("realtime_missing", "a real-time setting was refused.", "Grant it, as the warning at the start says; ticks may come late."),
    ("log_space", "the log's disk is full or cannot be written.", "Free some space; the robot balances without a record."),
)
_ALL = [(*row, True) for row in _TABLE] + [(*row, False) for row in _WARNINGS]
CHECKS = {row[0]: Check(1 << i, *row) for i, row in enumerate(_ALL)}
BLOCKING = sum(check.bit for check in CHECKS.values() if check.blocks)


class Refusal(NamedTuple):
    """A check that fails at present: its row of the table, and the sentence with the figures that matter."""

    check: Check
    sentence: str

    @property
    def code(self) -> str:
        """The check's code."""
        return self.check.code

    @property
    def cure(self) -> str:
        """The check's cure."""
        return self.check.cure


def refusal(code: str, sentence: str = "") -> Refusal:
    """The refusal of a check, with its sentence from the table unless a better one is known."""
    return Refusal(CHECKS[code], sentence or CHECKS[code].sentence)


def failing(bits: int) -> list[Check]:
    """The checks whose bits are set in a frame's `refusals`, those that block first."""
    return [check for check in CHECKS.values() if bits & check.bit]


class Calibration:
    """Gyro bias and convergence of the DMP, from one window of stillness.

    Attributes:
        bias_rad_s: (3,) once `done`.
        reason: Refusal that says what is still missing; None when done.
    """

    def __init__(self, rate_hz: float):
        self._window = round(STILL_S * rate_hz)
        self._gyro = np.zeros((self._window, 3))
        self._force = np.zeros((self._window, 3))
        self._lean = np.zeros((self._window, 2))
        self._filled = 0
        self.bias_rad_s = np.zeros(3)
        self.reason = refusal("calibrating")

    @property
    def done(self) -> bool:
        """A still window was found and the DMP agrees with gravity."""
        return self.reason is None

    def take(self, gyro_rad_s, acceleration_m_s2, attitude_rad) -> bool:
        """One tick's converted sensors, gyro without bias correction; True when calibration is complete."""
        i = self._filled
        self._gyro[i], self._force[i], self._lean[i] = gyro_rad_s, acceleration_m_s2, attitude_rad[:2]
        self._filled += 1
        if self._filled < self._window:
            return False
        self._filled = 0
        self.reason = self._judge()
        return self.done

    def _judge(self):
        mean, spread = self._gyro.mean(axis=0), self._gyro.std(axis=0)
        if spread.max() > STILL_SPREAD_RAD_S:
            return refusal("not_still", f"the robot moves: the gyro varies by {spread.max():.3f} rad/s.")
        if np.abs(mean).max() > LARGEST_BIAS_RAD_S:
            return refusal("gyro_bias", f"the gyro's rate at rest is {np.abs(mean).max():.2f} rad/s.")
        ax, ay, az = self._force.mean(axis=0)
        roll, pitch = math.atan2(-ay, -az), math.asin(max(-1.0, min(1.0, ax / math.sqrt(ax * ax + ay * ay + az * az))))
        apart = np.hypot(*(self._lean.mean(axis=0) - (roll, pitch)))
        if apart > AGREEMENT_RAD:
            return refusal("attitude_disagrees", f"DMP and accelerometer differ by {math.degrees(apart):.1f} deg.")
        self.bias_rad_s = mean
        return None


def failing_checks(calibration, devices, minimum_v: float, rate_hz: float, wanted_hz: float) -> list[Refusal]:
    """The checks that fail at present."""
    refusals = []
    if not calibration.done:
        refusals.append(calibration.reason)
    if math.isnan(devices.battery_v):
        refusals.append(refusal("battery_unknown"))
    elif devices.battery_v < minimum_v:
        refusals.append(refusal("battery_low", f"the battery has {devices.battery_v:.2f} V."))
    if not devices.remote.centred:
        refusals.append(refusal("remote_not_centred"))
    if any(encoder.failing for encoder in devices.encoders):
        refusals.append(refusal("encoder_errors"))
    if abs(rate_hz - wanted_hz) > 0.03 * wanted_hz:
        refusals.append(refusal("rate_wrong", f"the IMU interrupts at {rate_hz:.1f} Hz, not {wanted_hz:g} Hz."))
    return refusals
