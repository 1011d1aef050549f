"""Coulomb and viscous friction, and the smoothed sign that compensates the former.

Source: dissertation (5.34), (6.14), (6.15).
"""

import math

from mip_rt.compiled import njit

SMOOTHING_RAD_S = 0.1  # a sign() would make a fixed-step integrator chatter


@njit
def torque(rate_rad_s, coulomb_n_m, viscous_n_m_s_rad):
    """Friction torque opposing the rate, N m; the sign function is smoothed over +-0.1 rad/s."""
    return -coulomb_n_m * math.tanh(rate_rad_s / SMOOTHING_RAD_S) - viscous_n_m_s_rad * rate_rad_s


@njit
def compensation(rate_rad_s, smoothing_s_rad):
    """S(rate) = sgn(rate) (1 - exp(-k |rate|)), (6.15): 0 at rest, towards +-1 with slope k."""
    value = -math.expm1(-smoothing_s_rad * abs(rate_rad_s))
    return value if rate_rad_s >= 0.0 else -value
