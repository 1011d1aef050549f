"""The gyro's rates at rest. A run measures its own bias at the start, and refuses to arm where that is far from the one kept here."""

import numpy as np

from mip_rt.calibrate.stillness import body_axes, started_imu, two_windows
from mip_rt.calibration import LARGEST_BIAS_RAD_S
from mip_rt.errors import MipRtError

WINDOW_S = 3.0


def measure(patient) -> dict:
    """Figures for the part "gyro".

    Raises:
        MipRtError: it moved, the two windows disagree, or the bias is beyond what a sound chip shows.
    """
    patient.person.do("Put the robot on something solid, hands off.", ("stand",))
    with started_imu(patient) as (imu, line):
        windows = two_windows(patient, imu, line, WINDOW_S)
    turned = body_axes(patient)
    means = [turned @ window.rate_rad_s.mean(0) for window in windows]
    bias = (means[0] + means[1]) / 2.0
    if not np.abs(bias).max() <= LARGEST_BIAS_RAD_S:
        raise MipRtError(f"the gyro's rate at rest is {np.abs(bias).max():.2f} rad/s; a sound chip is within {LARGEST_BIAS_RAD_S:g}.",
                         "Was it still? Otherwise replace the IMU.", "calibrate_gyro")  # fmt: skip
    return {
        "bias_rad_s": [round(float(value), 6) for value in bias],
        "windows_differ_rad_s": round(float(np.abs(means[0] - means[1]).max()), 6),
        "noise_rad_s": round(float(max(window.rate_rad_s.std(0).max() for window in windows)), 6),
        "seconds": 2 * WINDOW_S,
    }


def in_words(found: dict) -> str:
    """What was found."""
    shown = ", ".join(f"{value:+.4f}" for value in found["bias_rad_s"])
    return f"bias {shown} rad/s (body axes); the two windows differ by {found['windows_differ_rad_s']:.4f}, noise {found['noise_rad_s']:.4f} rad/s"
