"""What the eduMIP should do: shaped commands, and the place and heading to hold that follow from integrating them.

The stick commands a speed along the robot's own heading (forward) and a turning rate (to the left); a held button adds a constant spin. Speed
and turning rate pass a first-order filter; their integrals are the wheel angle against the ground (phi + pitch; place = r times it) and the heading to
hold. A reference that runs away from a robot that is held back waits for it at a bounded distance.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.controllers.filters import limit, low_pass, pole_from_rate

PARAMETERS = np.dtype(
    [
        ("dt_s", "f8"),
        ("wheel_radius_m", "f8"),
        ("shaping_pole", "f8"),
        ("turn_rad_m", "f8"),  # turning rate for each m/s that the stick asks for to the left
        ("wheel_error_limit_rad", "f8"),
        ("yaw_error_limit_rad", "f8"),
    ],
    align=True,
)
STATE = np.dtype(
    [("wheel_rad", "f8"), ("wheel_rate_rad_s", "f8"), ("yaw_rad", "f8"), ("yaw_rate_rad_s", "f8")],
    align=True,
)


def configure(p, dt_s, wheel_radius_m, shaping_rad_s, turn_rad_m, wheel_error_limit_rad, yaw_error_limit_rad) -> None:
    """Derives the constants, once."""
    p.dt_s, p.wheel_radius_m, p.turn_rad_m = dt_s, wheel_radius_m, turn_rad_m
    p.shaping_pole = pole_from_rate(shaping_rad_s, dt_s)
    p.wheel_error_limit_rad, p.yaw_error_limit_rad = wheel_error_limit_rad, yaw_error_limit_rad


@njit
def reset(s, wheel_rad, yaw_rad):
    """Holds the present place and heading."""
    s.wheel_rad = wheel_rad
    s.wheel_rate_rad_s = 0.0
    s.yaw_rad = yaw_rad
    s.yaw_rate_rad_s = 0.0


@njit
def step(p, s, forward_m_s, left_m_s, spin_rad_s, wheel_rad, yaw_rad):
    """One tick.

    Args:
        forward_m_s, left_m_s: stick, as speeds.
        spin_rad_s: spin of the held button.
        wheel_rad, yaw_rad: estimates of wheel angle against the ground and heading.
    """
    s.wheel_rate_rad_s = low_pass(s.wheel_rate_rad_s, forward_m_s / p.wheel_radius_m, p.shaping_pole)
    s.yaw_rate_rad_s = low_pass(s.yaw_rate_rad_s, spin_rad_s + p.turn_rad_m * left_m_s, p.shaping_pole)
    wheel = s.wheel_rad + p.dt_s * s.wheel_rate_rad_s
    s.wheel_rad = wheel_rad + limit(wheel - wheel_rad, p.wheel_error_limit_rad)
    yaw = s.yaw_rad + p.dt_s * s.yaw_rate_rad_s
    s.yaw_rad = yaw_rad + limit(yaw - yaw_rad, p.yaw_error_limit_rad)
