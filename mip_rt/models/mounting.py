"""How the IMU sits in the body, as rotation matrices and quaternions. Plain numpy: needed before, and without, anything compiled."""

import math

import numpy as np


def about_axle(angle_rad: float) -> np.ndarray:
    """Body axes from board axes (3, 3) of a board that is turned about the axle against the body: body = Rx(-angle) board."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def level_rotation(level_rad) -> np.ndarray:
    """Body axes from the IMU's (3, 3), where the IMU shows this roll and pitch while the body's lean is zero: Ry(pitch) Rx(roll)."""
    (cr, cp), (sr, sp) = np.cos(level_rad), np.sin(level_rad)
    return np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])


def level_quaternion(level_rad) -> tuple[float, float, float, float]:
    """The same rotation as w, x, y, z."""
    (cr, cp), (sr, sp) = np.cos(0.5 * np.asarray(level_rad)), np.sin(0.5 * np.asarray(level_rad))
    return float(cp * cr), float(cp * sr), float(sp * cr), float(-sp * sr)


def body_from_chip(imu) -> np.ndarray:
    """Body axes from the chip's (3, 3), of a configuration's imu section: mounting, a turned board where the robot has one, level."""
    return level_rotation(imu.level_rad) @ about_axle(getattr(imu, "mount_angle_rad", 0.0)) @ np.array(imu.mounting, float)
