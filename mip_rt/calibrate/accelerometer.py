"""Gain and offset of the accelerometer's axes, from six positions: an ellipsoid with axes along the chip's.

At rest the true force has the length g, so with true = gain * measured - offset the measured points lie on an ellipsoid
sum_i (gain_i m_i - offset_i)^2 = g^2, which is linear in A_i = gain_i^2 and B_i = gain_i offset_i up to one factor.
"""

import numpy as np

from mip_rt.calibrate.stillness import started_imu, still_window
from mip_rt.errors import MipRtError
from mip_rt.hardware.imu_window import GRAVITY_M_S2

WINDOW_S = 1.5
POSITIONS = [(axis, sign) for axis in range(3) for sign in (1, -1)]
ALIGNED = 0.8  # share of the force that must lie along the wanted axis
LARGEST_GAIN_ERROR, LARGEST_OFFSET_M_S2 = 0.15, 1.5
LARGEST_RESIDUAL_M_S2 = 0.15


def fit(points) -> tuple[np.ndarray, np.ndarray]:
    """(gain, offset in m/s^2) of axes-parallel ellipsoid through (n, 3) measured forces, by least squares.

    Raises:
        MipRtError: the points do not determine one.
    """
    m = np.asarray(points, float) / GRAVITY_M_S2
    design = np.hstack([m * m, -2.0 * m])
    solution, _, rank, values = np.linalg.lstsq(design, np.ones(len(m)), rcond=None)
    if rank < 6 or values[-1] < 1e-3 * values[0] or not (solution[:3] > 0.0).all():
        raise MipRtError("the positions do not determine an ellipsoid.", "Take all six: each axis once up and once down.", "calibrate_accelerometer")
    a, b = solution[:3], solution[3:]
    centre = b / a
    scale = 1.0 / (1.0 + float((a * centre * centre).sum()))  # a_i are those of a sphere of radius 1 only after this
    gain = np.sqrt(a * scale)
    return gain, gain * centre * GRAVITY_M_S2


def measure(patient) -> dict:
    """Figures for the part "accelerometer".

    Raises:
        MipRtError: it moved, a position was not the one asked for, or the fit is not credible.
    """
    halves = []
    with started_imu(patient) as (imu, line):
        for axis, sign in POSITIONS:
            patient.person.do(f"Lay the robot so that the IMU's {'xyz'[axis]} axis points {'up' if sign > 0 else 'down'}, within 20 degrees.", ("place", axis, sign))
            window = still_window(patient, imu, line, WINDOW_S)
            force = window.force_m_s2
            mean = force.mean(0)
            if not sign * mean[axis] >= ALIGNED * np.linalg.norm(mean):
                shown = ", ".join(f"{value:+.1f}" for value in mean)
                raise MipRtError(f"the {'xyz'[axis]} axis is not {'up' if sign > 0 else 'down'}: the force is {shown} m/s^2.",
                                 "Find the chip's axes in its data sheet, or by what the command shows, and begin again.", "calibrate_position")  # fmt: skip
            half = len(force) // 2
            halves += [force[:half].mean(0), force[half:].mean(0)]
    points = np.array(halves)
    gain, offset = fit(points)
    residual = np.abs(np.linalg.norm(gain * points - offset, axis=1) - GRAVITY_M_S2).max()
    before = np.abs(np.linalg.norm(points, axis=1) - GRAVITY_M_S2).max()
    if not (np.abs(gain - 1.0).max() <= LARGEST_GAIN_ERROR and np.abs(offset).max() <= LARGEST_OFFSET_M_S2):
        raise MipRtError(f"gain {np.round(gain, 3)} and offset {np.round(offset, 2)} m/s^2 are beyond what a sound chip has.",
                         "Check imu.accel_range_g; keep each position still; otherwise replace the IMU.", "calibrate_accelerometer")  # fmt: skip
    if not residual <= LARGEST_RESIDUAL_M_S2:
        raise MipRtError(f"the corrected force is off by up to {residual:.2f} m/s^2.", "Keep each position still, and begin again.", "calibrate_accelerometer")
    return {
        "gain": [round(float(value), 5) for value in gain],
        "offset_m_s2": [round(float(value), 4) for value in offset],
        "residual_m_s2": round(float(residual), 4),
        "before_m_s2": round(float(before), 4),
        "temperature_note": "offsets move with temperature: calibrate warm",
    }


def in_words(found: dict) -> str:
    """What was found."""
    return (
        f"gain {', '.join(f'{value:.4f}' for value in found['gain'])}, offset {', '.join(f'{value:+.3f}' for value in found['offset_m_s2'])} m/s^2; "
        f"gravity is met within {found['residual_m_s2']:.3f} m/s^2 (before: {found['before_m_s2']:.3f})"
    )
