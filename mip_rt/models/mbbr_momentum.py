"""The MBBR's angular momentum about the point where the ball touches the floor: what neither motor nor friction nor roller can change.

Torques between ball and body are internal and cancel in the sum of the ball's and the body's equations of motion: what is left knows no
command, no motor constant, no friction, no wheel inertia. In the yaw-rotated frame, w the ball's rates, n the body's upward axis, Omega the
body's rates along its own axes and omega the same along those of this frame (h: the horizontal two):
    L = (C_b + kappa n_z) w + (I + D) omega_h - (I + D - I_3) Omega_z n_h + kappa (n_z omega_h - omega_z n_h)
    L' = gamma (sin roll, sin pitch cos roll) + yaw' (L_y, -L_x) + kappa n_z' w
with C_b, D, kappa, gamma as in section I.2 of the corrected equations, I the mean of I_t1 and I_t2, I_3 = I_t3. Read backwards, the body's rates
tell the ball's: a ball that is pushed one way pushes the body the other way. All is divided by C_b + kappa here, so that l, rad/s, of an upright
robot is w + body Omega_h.

Exact for any lean where I_t1 = I_t2. Not in it are what acts from outside: rolling resistance, a hand, a floor that is not level.

Source: ours; the sum of rows 1 and 4, and of 2 and 5, of section I.2.
"""

import math

import numpy as np

from mip_rt.compiled import njit

PARAMETERS = np.dtype(
    [
        ("body", "f8"),  # (I + D + kappa) / (C_b + kappa)
        ("coupling", "f8"),  # kappa / (C_b + kappa)
        ("spin", "f8"),  # I_3 / (C_b + kappa)
        ("gravity_s2", "f8"),  # gamma / (C_b + kappa), 1/s^2
    ],
    align=True,
)


def configure(p, model) -> None:
    """Fills a record of PARAMETERS from a record of models.mbbr.PARAMETERS."""
    arm = model.body_mass_kg * model.com_height_m
    kappa = arm * model.ball_radius_m
    ball = model.ball_inertia_kg_m2 + (model.ball_mass_kg + model.body_mass_kg) * model.ball_radius_m**2 + kappa
    p.body = (0.5 * (model.body_inertia_kg_m2[0] + model.body_inertia_kg_m2[1]) + arm * model.com_height_m + kappa) / ball
    p.coupling = kappa / ball
    p.spin = model.body_inertia_kg_m2[2] / ball
    p.gravity_s2 = model.gravity_m_s2 * arm / ball


@njit
def momentum(p, scale, roll, pitch, rate, wx, wy):
    """(l_x, l_y) of a body that turns at rate (3,) rad/s, body axes, on a ball that rolls at wx, wy; scale: see `derivative`."""
    sx, cx, sy, cy = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    lean, share, _, _ = _lean(p, scale, sx, cx, sy, cy, rate[0], rate[1], rate[2])
    return share * wx + lean[0], share * wy + lean[1]


@njit
def _lean(p, scale, sx, cx, sy, cy, a, b, c):
    """The body's part of l, the factor of w in it, (coupling n_z)' and yaw'; sines and cosines of roll x and pitch y."""
    turn = sx * b + cx * c
    ox = cy * a + sy * turn
    oy = cx * b - sx * c
    nx = sy * cx
    ny = -sx
    lost = p.coupling * (1.0 - cy * cx)
    level = scale * p.body - lost
    upright = (scale * p.body - p.spin) * c + p.coupling * (cy * turn - sy * a - c)
    return (level * ox - upright * nx, level * oy - upright * ny), 1.0 - lost, p.coupling * (ox * ny - oy * nx), turn / cy


@njit
def ball_rate(p, scale, roll, pitch, a, b, c, lx, ly):
    """(w_x, w_y) of the ball of a robot whose body turns at (a, b, c) rad/s, body axes, with momentum (lx, ly)."""
    sx, cx, sy, cy = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    lean, share, _, _ = _lean(p, scale, sx, cx, sy, cy, a, b, c)
    return (lx - lean[0]) / share, (ly - lean[1]) / share


@njit
def derivative(p, scale, gravity, roll, pitch, a, b, c, lx, ly):
    """(roll', pitch', yaw', l_x', l_y', phi_Bx', phi_By') from the body's rates (a, b, c), rad/s, body axes.

    Args:
        p: record of PARAMETERS.
        scale: true `body` as a multiple of p's.
        gravity: true `gravity_s2` as a multiple of p's.
        lx, ly: momentum l.
    """
    sx, cx, sy, cy = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    lean, share, change, yaw_rate = _lean(p, scale, sx, cx, sy, cy, a, b, c)
    wx = (lx - lean[0]) / share
    wy = (ly - lean[1]) / share
    fall = gravity * p.gravity_s2
    return (
        a + sy * yaw_rate,
        cx * b - sx * c,
        yaw_rate,
        fall * sx + yaw_rate * ly + change * wx,
        fall * sy * cx - yaw_rate * lx + change * wy,
        cy * wx - a,
        sx * sy * wx + cx * wy - b,
    )
