"""The composite PID of Lee and Jung: lean, place along the heading, and heading, in one sum for the right and the left wheel.

    u_right, u_left = -(k_lean e_lean + k_lean_rate e_lean' + k_place e_s + k_speed e_v + k_integral int e_s)  +-  (k_yaw e_yaw + k_yaw_rate e_yaw')

with e = reference - measured. Corrected: the place error is projected on the heading (as printed both inertial components push the wheels); the gains of
speed and integral are two, not one; lean and place carry the same, negative sign (a robot that is behind first rolls back, to lean forward).

Source: report on Lee and Jung (14) to (18), corrected as in section H of the equations.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.controllers.filters import limit

PARAMETERS = np.dtype(
    [
        ("dt_s", "f8"),
        ("lean", "f8"),  # per rad
        ("lean_rate", "f8"),
        ("place", "f8"),  # per m
        ("speed", "f8"),
        ("integral", "f8"),
        ("yaw", "f8"),
        ("yaw_rate", "f8"),
        ("integral_limit_m_s", "f8"),
    ],
    align=True,
)
STATE = np.dtype([("integral_m_s", "f8")], align=True)


@njit
def reset(s):
    """No memory."""
    s.integral_m_s = 0.0


@njit
def step(p, s, error, radius_m, command):
    """One tick.

    Args:
        error: (6,) reference - estimate: lean, wheel angle against the ground, yaw, and their rates.
        radius_m: wheel radius.
        command: (2,) out: u_x, u_z.
    """
    place = radius_m * error[1]
    s.integral_m_s = limit(s.integral_m_s + p.dt_s * place, p.integral_limit_m_s)
    command[0] = -(
        p.lean * error[0] + p.lean_rate * error[3] + p.place * place + p.speed * radius_m * error[4] + p.integral * s.integral_m_s
    )
    command[1] = p.yaw * error[2] + p.yaw_rate * error[5]
