"""What the robot should do: shaped commands and the references that follow from integrating them.

The remote commands an inertial velocity and a yaw rate. Both pass a first-order filter of 3 rad/s (the yaw command twice), as
in the robot author's program; their integrals are the position and heading to hold. A reference that runs away from the
robot (held back by a wall, or by hand) is stopped at a bounded distance, so that letting go is not a leap.

Frames: inertial ball angles phi and rates phi' in rad, rad/s; ball position is r (phi_y, -phi_x), so a velocity (vx, vy) in m/s asks for
phi' = (-vy, vx) / r.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.controllers.filters import limit, low_pass, pole_from_rate

PARAMETERS = np.dtype(
    [
        ("dt_s", "f8"),
        ("ball_radius_m", "f8"),
        ("shaping_pole", "f8"),
        ("angle_error_limit_rad", "f8"),
        ("yaw_error_limit_rad", "f8"),
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("rate_rad_s", "f8", (2,)),  # reference of the inertial ball rates
        ("angle_rad", "f8", (2,)),  # reference of the inertial ball angles
        ("yaw_rad", "f8"),
        ("yaw_rate_rad_s", "f8"),
        ("yaw_rate_first_rad_s", "f8"),  # between the two shaping filters of the yaw command
        ("forward_yaw_rad", "f8"),  # heading that the operator calls forward
    ],
    align=True,
)


def configure(p, dt_s, ball_radius_m, shaping_rad_s, angle_error_limit_rad, yaw_error_limit_rad) -> None:
    """Derives the constants, once."""
    p.dt_s = dt_s
    p.ball_radius_m = ball_radius_m
    p.shaping_pole = pole_from_rate(shaping_rad_s, dt_s)
    p.angle_error_limit_rad = angle_error_limit_rad
    p.yaw_error_limit_rad = yaw_error_limit_rad


@njit
def reset(s, yaw_rad, angle_x_rad, angle_y_rad):
    """Holds the present position and heading; the present heading is forward."""
    s.rate_rad_s[0] = 0.0
    s.rate_rad_s[1] = 0.0
    s.angle_rad[0] = angle_x_rad
    s.angle_rad[1] = angle_y_rad
    s.yaw_rad = yaw_rad
    s.yaw_rate_rad_s = 0.0
    s.yaw_rate_first_rad_s = 0.0
    s.forward_yaw_rad = yaw_rad


@njit
def step(p, s, velocity_x_m_s, velocity_y_m_s, yaw_rate_rad_s, estimate):
    """One tick: shape the commands, integrate them, keep the references near the robot.

    Args:
        velocity_x_m_s, velocity_y_m_s: commanded velocity relative to the forward heading (x forward, y left).
        yaw_rate_rad_s: commanded yaw rate.
        estimate: (10,) the estimate in control (robots.mbbr_frame.ESTIMATE_NAMES).

    Returns:
        True where a reference waits for the robot.
    """
    cosine = math.cos(s.forward_yaw_rad)
    sine = math.sin(s.forward_yaw_rad)
    inertial_x = cosine * velocity_x_m_s - sine * velocity_y_m_s
    inertial_y = sine * velocity_x_m_s + cosine * velocity_y_m_s
    s.rate_rad_s[0] = low_pass(s.rate_rad_s[0], -inertial_y / p.ball_radius_m, p.shaping_pole)
    s.rate_rad_s[1] = low_pass(s.rate_rad_s[1], inertial_x / p.ball_radius_m, p.shaping_pole)
    s.yaw_rate_first_rad_s = low_pass(s.yaw_rate_first_rad_s, yaw_rate_rad_s, p.shaping_pole)
    s.yaw_rate_rad_s = low_pass(s.yaw_rate_rad_s, s.yaw_rate_first_rad_s, p.shaping_pole)
    held = False
    for i in range(2):
        ahead = s.angle_rad[i] + p.dt_s * s.rate_rad_s[i] - estimate[8 + i]
        held |= abs(ahead) > p.angle_error_limit_rad
        s.angle_rad[i] = estimate[8 + i] + limit(ahead, p.angle_error_limit_rad)
    ahead = s.yaw_rad + p.dt_s * s.yaw_rate_rad_s - estimate[2]
    held |= abs(ahead) > p.yaw_error_limit_rad
    s.yaw_rad = estimate[2] + limit(ahead, p.yaw_error_limit_rad)
    return held
