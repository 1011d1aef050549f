"""Before arming: the gyro's bias, and the checks that must pass. Every refusal is a code, a sentence and a cure.

Runs between ticks while the motors are off, never while balancing.
"""

import math
from typing import NamedTuple

import numpy as np

STILL_S = 1.0  # length of the window in which the robot must be still
STILL_SPREAD_RAD_S = 0.05  # largest standard deviation of the gyro in it
LARGEST_BIAS_RAD_S = 0.35  # 20 deg/s: the data sheet's zero-rate output is within 5
AGREEMENT_RAD = 0.05  # DMP against accelerometer, averaged over the window


class Refusal(NamedTuple):
    """Why the robot is not armed."""

    code: str
    sentence: str
    cure: str


class Calibration:
    """Gyro bias and convergence of the DMP, from one window of stillness.

    Attributes:
        bias_rad_s: (3,) once `done`.
        reason: Refusal that says what is still missing; None when done.
    """

    def __init__(self, rate_hz: float, prior_bias_rad_s=None):
        self._window = round(STILL_S * rate_hz)
        self._gyro = np.zeros((self._window, 3))
        self._force = np.zeros((self._window, 3))
        self._lean = np.zeros((self._window, 2))
        self._filled = 0
        self.bias_rad_s = np.zeros(3)
        self.reason = Refusal("calibrating", "the gyro's bias is being measured.", "Keep the robot still.")

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
            return Refusal("not_still", f"the robot moves: the gyro varies by {spread.max():.3f} rad/s.", "Hold it still.")
        if np.abs(mean).max() > LARGEST_BIAS_RAD_S:
            return Refusal("gyro_bias", f"the gyro's rate at rest is {np.abs(mean).max():.2f} rad/s.", "Hold it still, or replace the IMU.")
        ax, ay, az = self._force.mean(axis=0)
        roll, pitch = math.atan2(-ay, -az), math.asin(max(-1.0, min(1.0, ax / math.sqrt(ax * ax + ay * ay + az * az))))
        apart = np.hypot(*(self._lean.mean(axis=0) - (roll, pitch)))
        if apart > AGREEMENT_RAD:
            return Refusal(
                "attitude_disagrees",
                f"DMP and accelerometer differ by {math.degrees(apart):.1f} deg.",
                "Wait for the DMP to converge; if it stays, check imu.mounting and imu.dmp_orientation.",
            )
        self.bias_rad_s = mean
        return None


def failing_checks(calibration, devices, minimum_v: float, rate_hz: float, wanted_hz: float) -> list[Refusal]:
    """The checks that fail at present."""
    refusals = []
    if not calibration.done:
        refusals.append(calibration.reason)
    if math.isnan(devices.battery_v):
        refusals.append(Refusal("battery_unknown", "the battery's voltage is not plausible.", "Check battery.adc_channel and the divider."))
    elif devices.battery_v < minimum_v:
        refusals.append(Refusal("battery_low", f"the battery has {devices.battery_v:.2f} V.", f"Charge it above {minimum_v:g} V."))
    if not devices.remote.centred:
        refusals.append(Refusal("remote_not_centred", "the remote commands motion.", "Let go of stick and buttons."))
    if any(encoder.failing for encoder in devices.encoders):
        refusals.append(Refusal("encoder_errors", "an encoder cannot be read.", "Run mip-rt doctor."))
    if abs(rate_hz - wanted_hz) > 0.03 * wanted_hz:
        refusals.append(Refusal("rate_wrong", f"the IMU interrupts at {rate_hz:.1f} Hz, not {wanted_hz:g} Hz.", "Check the DMP's image and rate."))
    return refusals
