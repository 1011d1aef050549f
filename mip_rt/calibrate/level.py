"""Zero lean as mounted: what roll and pitch the IMU shows while the body stands upright."""

import numpy as np

from mip_rt.calibrate.stillness import TILT_DRIFT_RAD, degrees, started_imu, two_windows
from mip_rt.errors import MipRtError
from mip_rt.models.mounting import about_axle

WINDOW_S, SETTLE_S = 3.0, 5.0
LARGEST_RAD = 0.15
AGREEMENT_RAD = 0.05  # quaternion against accelerometer


def measure(patient) -> dict:
    """Figures for the part "level".

    Raises:
        MipRtError: it moved, quaternion and accelerometer disagree, or the lean is larger than a mounting error.
    """
    imu_settings = patient.config.imu
    mount_rad = getattr(imu_settings, "mount_angle_rad", 0.0)
    patient.person.do("Hold the robot exactly upright in a stand or fixture, motors off, hands off.", ("stand",))
    with started_imu(patient) as (imu, line):
        patient.kernel.sleep(SETTLE_S)  # the DMP converges
        imu.recover()
        patient.kernel.sleep(SETTLE_S)
        windows = two_windows(patient, imu, line, WINDOW_S)
    board = about_axle(mount_rad) @ np.array(imu_settings.mounting, float)
    leans, by_force = [], []
    for window in windows:
        up = board @ (np.array(imu_settings.accel_gain) * window.force_m_s2.mean(0) - np.array(imu_settings.accel_offset_m_s2))
        by_force.append((np.arctan2(up[1], up[2]), np.arctan2(-up[0], np.hypot(up[1], up[2]))))
        shown = window.attitude_rad.mean(0) if window.quaternion.any() else None
        leans.append(np.array(by_force[-1]) if shown is None else shown + (mount_rad, 0.0))
    lean = (leans[0] + leans[1]) / 2.0
    differ = float(np.abs(leans[0] - leans[1]).max())
    apart = float(np.abs(lean - np.mean(by_force, 0)).max())
    if not differ <= TILT_DRIFT_RAD:
        raise MipRtError(f"the lean of two windows differs by {np.degrees(differ):.2f} deg.", "Keep it still; let the DMP settle for a minute.", "calibrate_disagree")
    if not apart <= AGREEMENT_RAD:
        raise MipRtError(f"quaternion and accelerometer differ by {np.degrees(apart):.1f} deg.",
                         "Check imu.mounting and imu.dmp_orientation; calibrate the accelerometer first.", "calibrate_level")  # fmt: skip
    if not np.abs(lean).max() <= LARGEST_RAD:
        raise MipRtError(f"the IMU shows {degrees(lean)} of roll and pitch: that is no small mounting error.",
                         "Hold it upright; a turned board belongs into imu.mounting (or imu.mount_angle_rad).", "calibrate_level")  # fmt: skip
    return {
        "lean_rad": [round(float(value), 5) for value in lean],
        "windows_differ_rad": round(differ, 5),
        "accelerometer_differs_rad": round(apart, 5),
    }


def in_words(found: dict) -> str:
    """What was found."""
    return f"the IMU shows {degrees(found['lean_rad'])} of roll and pitch while the body is upright (accelerometer within {degrees([found['accelerometer_differs_rad']])})"
