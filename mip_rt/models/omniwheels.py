"""Geometry of three omniwheels on a ball.

Source: dissertation (2.1) to (2.5), Table 2.1 (whose angles are rounded from an iteration; here in closed form), (5.3), (5.4), (6.5).
"""

import math

import numpy as np


def orthogonal_tilt(alpha_rad: float) -> float:
    """Wheel tilt beta that makes the three wheel axes orthogonal for a contact angle alpha: cos beta = 1 / (sqrt(3) sin alpha).

    Raises:
        ValueError: alpha below 35.264 degrees, where no such tilt exists.
    """
    cosine = 1.0 / (math.sqrt(3.0) * math.sin(alpha_rad))
    if not 0.0 <= cosine <= 1.0 + 1e-12:
        raise ValueError(f"three orthogonal axes need a contact angle of at least 35.264 deg, not {math.degrees(alpha_rad):.3f}")
    return math.acos(min(1.0, cosine))


def wheel_axes(alpha_rad: float, beta_rad: float, yaw_rad: float = 0.0) -> np.ndarray:
    """(3, 3): columns are the unit axes of wheels 1 to 3 in body axes, (2.3) to (2.5), turned by yaw about the body's z.

    alpha: angle of the contact point from the ball's top; beta: tilt of the wheel about the contact normal.
    """
    first = np.array([math.cos(alpha_rad) * math.cos(beta_rad), math.sin(beta_rad), -math.sin(alpha_rad) * math.cos(beta_rad)])
    columns = []
    for wheel in range(3):
        c, s = math.cos(yaw_rad + wheel * 2.0 * math.pi / 3.0), math.sin(yaw_rad + wheel * 2.0 * math.pi / 3.0)
        columns.append([c * first[0] - s * first[1], s * first[0] + c * first[1], first[2]])
    return np.array(columns).T


def normal_force(mass_kg: float, gravity_m_s2: float, alpha_rad: float) -> float:
    """Force of each wheel on the ball while the robot stands upright, N, (2.2)."""
    return mass_kg * gravity_m_s2 / (3.0 * math.cos(alpha_rad))
