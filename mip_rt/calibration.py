"""What is measured of this unit before it may balance: the gyro's bias from a still window.

The bias that counts is always the one measured since the start, because it moves with temperature: at the start the robot must be still for a
second, and while its motors are off every later still second renews it. The unit's file (`mip_rt.unit_file`) is optional; where it has a bias, that
of the start must be near it, which finds an IMU that was exchanged or is failing.
"""

import math

import numpy as np

from mip_rt.prearm import refusal

STILL_S = 1.0  # length of the window in which the robot must be still
STILL_SPREAD_RAD_S = 0.05  # largest standard deviation of the gyro in it
LARGEST_BIAS_RAD_S = 0.35  # 20 deg/s: the data sheet's zero-rate output is within 5
AGREEMENT_RAD = 0.05  # attitude against accelerometer, averaged over the window
RENEW_AFTER_S = 60.0


class GyroCalibration:
    """Gyro bias and convergence of the attitude, from windows of stillness.

    Attributes:
        bias_rad_s: (3,) once `done`.
        measured_s: when it was measured, monotonic seconds; minus infinity before.
        reason: Refusal that says why the last window did not count; None where it did.
    """

    def __init__(self, rate_hz: float):
        self._window = round(STILL_S * rate_hz)
        self._gyro = np.zeros((self._window, 3))
        self._force = np.zeros((self._window, 3))
        self._lean = np.zeros((self._window, 2))
        self._filled = 0
        self.bias_rad_s = np.zeros(3)
        self.measured_s = -math.inf
        self.reason = refusal("calibrating")

    @property
    def done(self) -> bool:
        """A still window was found, and the attitude agreed with gravity, at some time since the start."""
        return self.measured_s > -math.inf

    def due(self, now_s: float) -> bool:
        """The bias is missing or should be measured anew when there is an opportunity."""
        return now_s - self.measured_s > RENEW_AFTER_S

    def take(self, now_s: float, gyro_rad_s, acceleration_m_s2, attitude_rad) -> bool:
        """One tick's sensors, gyro without bias correction; True when a window was completed and counts."""
        i = self._filled
        self._gyro[i], self._force[i], self._lean[i] = gyro_rad_s, acceleration_m_s2, attitude_rad[:2]
        self._filled += 1
        if self._filled < self._window:
            return False
        self._filled = 0
        self.reason = self._judge()
        if self.reason is not None:
            return False
        self.bias_rad_s = self._gyro.mean(axis=0)
        self.measured_s = now_s
        return True

    def restart(self) -> None:
        """Forgets an unfinished window, because ticks without good packets lie in it."""
        self._filled = 0

    def _judge(self):
        mean, spread = self._gyro.mean(axis=0), self._gyro.std(axis=0)
        if not spread.max() <= STILL_SPREAD_RAD_S:
            return refusal("not_still", f"the robot moves: the gyro varies by {spread.max():.3f} rad/s.")
        if not np.abs(mean).max() <= LARGEST_BIAS_RAD_S:
            return refusal("gyro_bias", f"the gyro's rate at rest is {np.abs(mean).max():.2f} rad/s.")
        down = self._force.mean(axis=0)  # the papers' accelerometer at rest points down
        down /= np.linalg.norm(down)
        roll, pitch = self._lean.mean(axis=0)
        said = (math.sin(pitch), -math.sin(roll) * math.cos(pitch), -math.cos(roll) * math.cos(pitch))
        apart = math.asin(min(1.0, float(np.linalg.norm(np.cross(down, said)))))
        if not (apart <= AGREEMENT_RAD and down @ said > 0.0):
            return refusal("attitude_disagrees", f"attitude and accelerometer differ by {math.degrees(apart):.1f} deg.")
        return None
