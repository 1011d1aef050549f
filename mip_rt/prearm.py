"""Before arming: the checks that must pass, as a table.

Each check has a bit in the frame's `refusals`, a code, a sentence and a cure. Those that block keep the robot disarmed; the others only
warn: balancing must not depend, for example, on recording. All of it runs between ticks while the motors are off.
"""

import math
import os
from typing import NamedTuple

from mip_rt.errors import MipRtError

OLD_AFTER_S = 600.0  # a gyro bias measured longer ago does not count
NEAR_FILE_RAD_S = 0.05  # 3 deg/s: more than temperature moves a gyro's bias
LOG_SPACE_BYTES = 64_000_000


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
    ("attitude_disagrees", "attitude and accelerometer disagree about what is up.",
     "Wait for it to converge; if it stays, check imu.mounting and, with the DMP, imu.dmp_orientation."),
    ("calibration_invalid", "this unit's calibration file cannot be used.", "Repair or remove it: then the bias measured at the start counts."),
    ("calibration_differs", "the gyro's rate at rest is not that of this unit's calibration file.", "Calibrate this unit anew, or remove the file."),
    ("encoder_errors", "an encoder does not answer.", "Run mip-rt doctor."),
    ("battery_unknown", "the battery's voltage is not plausible.", "Check battery.adc_channel and the divider."),
    ("battery_low", "the battery is too low.", "Charge it above battery.minimum_v."),
    ("remote_not_centred", "the remote commands motion.", "Let go of stick and buttons."),
    ("rate_wrong", "the IMU's interrupts are more than 3 % off the configured rate.", "Check realtime.rate_hz and, with the DMP, its image."),
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


class PreArm:
    """Runs the checks.

    Args:
        config: the configuration.
        devices: opened drivers.
        calibration: calibration.GyroCalibration.
        unit_file: unit_file.UnitFile, None where there is none, or the MipRtError that says why it cannot be used.
        log_folder: where the log goes.
        self_test: sentences of what the supervisor's own test found.

    Attributes:
        scheduling: realtime.Scheduling as obtained, once known.
    """

    def __init__(self, config, devices, calibration, unit_file, log_folder, self_test):
        self._config, self._devices, self._calibration = config, devices, calibration
        self._unit_file, self._log_folder, self._self_test = unit_file, log_folder, self_test
        self.scheduling = None

    def check(self, now_s: float, started: bool, rate_hz: float) -> list[Refusal]:
        """The checks that fail at present, those that block first.

        Args:
            now_s: monotonic time.
            started: the IMU has sent good packets for long enough.
            rate_hz: measured rate of its interrupts.
        """
        found = [refusal("self_test", f"the supervisor's own test failed: {self._self_test[0]}.")] if self._self_test else []
        if not started:
            found.append(refusal("imu_starting"))
        found += [*self._calibrations(now_s), *self._sensors(rate_hz), *self._surroundings()]
        return sorted(found, key=lambda each: each.check.bit)

    def _calibrations(self, now_s: float):
        calibration, unit = self._calibration, self._unit_file
        age_s = now_s - calibration.measured_s
        if not calibration.done:
            yield calibration.reason
        elif age_s > OLD_AFTER_S:
            yield refusal("gyro_bias_old", f"the gyro's bias was measured {age_s / 60.0:.0f} minutes ago.")
        if isinstance(unit, MipRtError):
            yield refusal("calibration_invalid", unit.sentence)
        elif unit is not None and unit.gyro_bias_rad_s is not None and calibration.done:
            apart = max(abs(a - b) for a, b in zip(calibration.bias_rad_s, unit.gyro_bias_rad_s))
            if not apart <= NEAR_FILE_RAD_S:
                yield refusal("calibration_differs", f"the gyro's rate at rest is {apart:.2f} rad/s from that of the calibration file ({unit.describe()}).")

    def _sensors(self, rate_hz: float):
        devices, battery = self._devices, self._config.battery
        wanted_hz, tolerance = self._config.realtime.rate_hz, self._config.limits.rate_tolerance
        for i, encoder in enumerate(devices.encoders):
            if encoder.failing:
                yield refusal("encoder_errors", f"the encoder of wheel {i + 1} does not answer.")
        if math.isnan(devices.battery_v):
            yield refusal("battery_unknown")
        elif not devices.battery_v >= battery.minimum_v:
            yield refusal("battery_low", f"the battery has {devices.battery_v:.2f} V, less than {battery.minimum_v:g} V.")
        if not devices.remote.centred:
            yield refusal("remote_not_centred")
        if not abs(rate_hz - wanted_hz) <= tolerance * wanted_hz:
            yield refusal("rate_wrong", f"the IMU interrupts at {rate_hz:.1f} Hz, not {wanted_hz:g} Hz.")

    def _surroundings(self):
        if self.scheduling is not None and self.scheduling.warnings:
            yield refusal("realtime_required" if self._config.realtime.strict else "realtime_missing", self.scheduling.warnings[0] + ".")
        try:
            disk = os.statvfs(self._log_folder)
            free = disk.f_bavail * disk.f_frsize
        except OSError:
            free = 0
        if free < LOG_SPACE_BYTES or not os.access(self._log_folder, os.W_OK):
            yield refusal("log_space", f"the log's disk has {free / 1e6:.0f} MB left, or cannot be written.")
