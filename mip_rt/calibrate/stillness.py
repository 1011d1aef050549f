"""Still windows of the IMU: two in a row that agree, or a refusal with the reason."""

import math
from contextlib import contextmanager

import numpy as np

from mip_rt.errors import MipRtError
from mip_rt.hardware import imu_window
from mip_rt.hardware.devices import interrupt_line, make_imu
from mip_rt.models.mounting import body_from_chip

SPREAD_RAD_S = 0.03  # largest standard deviation of a rate in a window
DRIFT_RAD_S = 0.004  # the means of two windows may differ by so much
TILT_DRIFT_RAD = 0.006
FORCE_DRIFT_M_S2 = 0.05
GOOD_SHARE = 0.95


@contextmanager
def started_imu(patient):
    """(imu, line) of a patient, started; stopped afterwards."""
    line = interrupt_line(patient.kernel, patient.pins)
    imu = make_imu(patient.kernel, patient.config, patient.image)
    try:
        imu.start()
        yield imu, line
    finally:
        imu.stop()
        line.close()


def still_window(patient, imu, line, seconds: float):
    """An imu_window.Window in which the robot was still.

    Raises:
        MipRtError: packets are missing, or it moved.
    """
    config = patient.config
    window = imu_window.collect(patient.kernel, imu, line, config.imu, seconds, config.realtime.rate_hz)
    expected = seconds * config.realtime.rate_hz
    if len(window.rate_rad_s) < GOOD_SHARE * expected:
        raise MipRtError(f"only {len(window.rate_rad_s)} of {expected:.0f} packets were good.", "Run mip-rt doctor.", "calibrate_packets")
    spread = float(window.rate_rad_s.std(0).max())
    if not spread <= SPREAD_RAD_S:
        raise MipRtError(f"the robot moved: the gyro varied by {spread:.3f} rad/s, {SPREAD_RAD_S:g} are allowed.",
                         "Put it on something solid, hands off, and begin again.", "calibrate_moved")  # fmt: skip
    return window


def two_windows(patient, imu, line, seconds: float):
    """Two still windows that agree in rate, tilt and force.

    Raises:
        MipRtError: they do not.
    """
    first, second = (still_window(patient, imu, line, seconds) for _ in range(2))
    apart = float(np.abs(first.rate_rad_s.mean(0) - second.rate_rad_s.mean(0)).max())
    if not apart <= DRIFT_RAD_S:
        raise MipRtError(f"two windows of {seconds:g} s differ by {apart:.4f} rad/s, {DRIFT_RAD_S:g} are allowed: it was turned slowly, or warms up.",
                         "Wait a minute with the power on, keep it still, and begin again.", "calibrate_disagree")  # fmt: skip
    force = float(np.abs(first.force_m_s2.mean(0) - second.force_m_s2.mean(0)).max())
    if not force <= FORCE_DRIFT_M_S2:
        raise MipRtError(f"two windows of {seconds:g} s differ by {force:.3f} m/s^2: it was moved.", "Keep it still, and begin again.", "calibrate_disagree")
    return first, second


def body_axes(patient) -> np.ndarray:
    """Body axes from chip axes of the patient."""
    return body_from_chip(patient.config.imu)


def degrees(angles) -> str:
    """For sentences."""
    return ", ".join(f"{math.degrees(angle):+.2f}" for angle in angles) + " deg"
