"""From u_x, u_z to the duties of the right and the left wheel: limits, friction compensation, voltage scaling, brake or coast inverse.

Balance comes first: what u_x needs is taken from the battery before u_z gets its share. Estimators are told the command after clipping, less what
friction compensation added: their models know no friction.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.controllers.filters import limit
from mip_rt.controllers.wheel_drive import CLIPPED, duties
from mip_rt.models.friction import compensation

PARAMETERS = np.dtype(
    [
        ("friction_level", "f8"),  # compensated part of mu_c / k1, in commands
        ("friction_smoothing_s_rad", "f8"),
        ("half_track_in_radii", "f8"),  # d / 2 r
        ("steering_limit", "f8"),  # largest u_z
        ("drive", "i8"),
        ("resistance_ohm", "f8"),
        ("torque_constant_n_m_a", "f8"),
        ("nominal_voltage_v", "f8"),
        ("time_ratio", "f8"),
        ("diode_drop_v", "f8"),
        ("command_limit", "f8"),
        ("period_ns", "f8"),
        ("motor_sign", "f8", (2,)),
    ],
    align=True,
)


@njit
def friction_add(p, phi_rate, yaw_rate, added):
    """(2,) out: the wheel commands that cancel Coulomb friction at the estimated rates of the wheels relative to the body."""
    for i in range(2):
        rate = phi_rate + (p.half_track_in_radii if i == 0 else -p.half_track_in_radii) * yaw_rate
        added[i] = p.friction_level * compensation(rate, p.friction_smoothing_s_rad)


@njit
def step(p, command, added, scale, wheel_rate_rad_s, battery_v, wheel_command, applied, duty, duty_ns):
    """One tick for both wheels; arguments and result bits as `wheel_drive.step`, command (2,) is u_x, u_z."""
    bits = 0
    available = min(p.command_limit, battery_v / p.nominal_voltage_v)
    forward = limit(scale * command[0], available)
    room = min(available - abs(forward), p.steering_limit)
    turn = limit(scale * command[1], room)
    if not (abs(forward - scale * command[0]) < 1e-12 and abs(turn - scale * command[1]) < 1e-12):
        bits |= CLIPPED
    for i in range(2):
        wanted = forward + (turn if i == 0 else -turn) + scale * added[i]
        wheel_command[i] = limit(wanted, available)
    right = wheel_command[0] - scale * added[0]
    left = wheel_command[1] - scale * added[1]
    applied[0] = 0.5 * (right + left)
    applied[1] = 0.5 * (right - left)
    return bits | duties(p, wheel_command, wheel_rate_rad_s, battery_v, duty, duty_ns)
