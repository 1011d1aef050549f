"""The micro ball-balancing robot: exact nonlinear dynamics and sensors.

State x = [roll, pitch, yaw, phi_x, phi_y, roll', pitch', yaw', w_x, w_y]: body rotation R = Rz(yaw) Ry(pitch) Rx(roll), inertial ball
angles phi, and the ball's rates w in the yaw-rotated frame (the papers' phi*', which are quasi-velocities: their integrals mean nothing).
The ball rolls without slip or spin; position = r (phi_y, -phi_x). Body commands u are torques in units of k1.

Variants of the ball rows (all conserve energy, so only a comparison in maximal coordinates tells them apart):
  EXACT               Lagrange-d'Alembert, agrees with Newton-Euler to rounding
  INERTIAL_LAGRANGE   rolling substituted before variation (the derivation behind dissertation chapter 5)
  PLAIN_LAGRANGE      dissertation (A.6) to (A.12) term by term: w taken for the rate of a coordinate; for comparison only

Source: dissertation (5.14) to (5.26), A.2, corrected as in section I.2 of the equations.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.models.mbbr_yaw import (  # noqa: F401  (part of this module's interface)
    high_yaw_derivative,
    high_yaw_derivative_jacobian,
    high_yaw_output,
    high_yaw_output_jacobian,
)

EXACT, INERTIAL_LAGRANGE, PLAIN_LAGRANGE = 0, 1, 2

PARAMETERS = np.dtype(
    [
        ("body_mass_kg", "f8"),  # m_t
        ("ball_mass_kg", "f8"),  # m_b
        ("ball_radius_m", "f8"),  # r
        ("wheel_radius_m", "f8"),  # r_w
        ("com_height_m", "f8"),  # l, from the ball's centre to the body's centre of mass
        ("body_inertia_kg_m2", "f8", (3,)),  # I_t about the body's centre of mass
        ("ball_inertia_kg_m2", "f8"),  # I_b
        ("wheel_inertia_kg_m2", "f8"),  # I_w with its rotor, about the wheel's axis
        ("torque_per_command_n_m", "f8"),  # k1
        ("damping_n_m_s_rad", "f8"),  # K2 = k2 (r / r_w)^2 of the back EMF
        ("gravity_m_s2", "f8"),
        ("imu_position_m", "f8", (3,)),  # l_a, from the ball's centre, body axes
        ("variant", "i8"),
    ],
    align=True,
)
TABLE_5_2 = {
    "body_mass_kg": 0.55,
    "ball_mass_kg": 0.15,
    "ball_radius_m": 0.032,
    "wheel_radius_m": 0.0125,
    "com_height_m": 0.1,
    "body_inertia_kg_m2": (2.42e-3, 2.42e-3, 0.79e-3),
    "ball_inertia_kg_m2": 8.46e-5,
    "wheel_inertia_kg_m2": 1.2e-5,
    "torque_per_command_n_m": 0.176,
    "damping_n_m_s_rad": 0.011,
    "gravity_m_s2": 9.8,
    "imu_position_m": (0.0, 0.0, 0.130),
    "variant": EXACT,
}


def parameters(**overrides):
    """Parameter set of dissertation Table 5.2 with changes, (1,) record array of PARAMETERS; KeyError for an unknown name."""
    unknown = set(overrides) - set(TABLE_5_2)
    if unknown:
        raise KeyError(f"no such model parameter: {', '.join(sorted(unknown))}")
    p = np.zeros(1, PARAMETERS).view(np.recarray)
    for name, value in {**TABLE_5_2, **overrides}.items():
        p[name] = value
    return p


def printed_parameters(**overrides):
    """The constants that the printed coefficients (5.28) to (5.33) were made with: J_w without (r/r_w)^2, K2 0.0117965, l_az 0.18 m."""
    ratio = TABLE_5_2["ball_radius_m"] / TABLE_5_2["wheel_radius_m"]
    used = {
        "wheel_inertia_kg_m2": 1.2e-5 / ratio**2,
        "damping_n_m_s_rad": 0.0117965,
        "imu_position_m": (0.0, 0.0, 0.180),
    }
    return parameters(**{**used, **overrides})


@njit
def acceleration_from_torque(x, torque, p, out):
    """v' = [roll'', pitch'', yaw'', w_x', w_y'] under the body torques torque (3,) on the ball, section I.2.

    The mass matrix has a scalar block for the ball (m44 = m55, m45 = 0) and m12 = 0: eliminating the ball's rows leaves a symmetric
    3x3 system, solved in closed form.
    """
    sx = math.sin(x[0])
    cx = math.cos(x[0])
    sy = math.sin(x[1])
    cy = math.cos(x[1])
    a, b, z, wx, wy = x[5], x[6], x[7], x[8], x[9]
    ratio = p.ball_radius_m / p.wheel_radius_m
    Jw = p.wheel_inertia_kg_m2 * ratio * ratio
    mt = p.body_mass_kg
    length = p.com_height_m
    It1 = p.body_inertia_kg_m2[0]
    It2 = p.body_inertia_kg_m2[1]
    It3 = p.body_inertia_kg_m2[2]
    D = length * length * mt
    kappa = length * mt * p.ball_radius_m
    gamma = p.gravity_m_s2 * length * mt
    J = It2 - It3 + D
    Cb = p.ball_inertia_kg_m2 + (p.ball_mass_kg + mt) * p.ball_radius_m * p.ball_radius_m
    cxx = cx * cx
    cyy = cy * cy
    c2x = 2.0 * cxx - 1.0
    s2x = 2.0 * sx * cx

    m11 = It1 + Jw + D
    m13 = -m11 * sy
    m14 = kappa * cx - Jw * cy
    m15 = -kappa * sx * sy
    m22 = It2 * cxx + It3 * sx * sx + Jw + D * cxx
    m23 = J * sx * cx * cy
    m25 = kappa * cx * cy - Jw
    m33 = Jw + It1 * sy * sy + (It2 * sx * sx + It3 * cxx) * cyy + D * (1.0 - cxx * cyy)
    m34 = -kappa * cx * sy
    m35 = kappa * sx

    X = (It1 + Jw + D + J * c2x) * cy * z - Jw * sy * wx
    b1 = gamma * cy * sx - J * sx * cx * b * b + J * sx * cx * cyy * z * z + b * X + kappa * z * (sx * sy * wx + cx * wy)
    b2 = (
        gamma * cx * sy + J * s2x * a * b + sy * cy * (It1 + 0.5 * (-It2 - It3 + D + J * c2x)) * z * z
        - a * X - kappa * cx * cy * z * wx
    )  # fmt: skip
    b3 = (
        J * sx * cx * sy * b * b - sy * cy * (2.0 * It1 - It2 - It3 + D + J * c2x) * b * z
        + a * ((It1 + Jw + D - J * c2x) * cy * b - J * cyy * s2x * z)
    )  # fmt: skip
    if p.variant == PLAIN_LAGRANGE:
        b3 -= kappa * (sx * sy * a * wx + cx * a * wy - cx * cy * b * wx)
        b4 = kappa * (sx * a * a - sx * sy * a * z + cx * cy * b * z) - Jw * sy * a * b
        b5 = kappa * (cx * sy * (a * a + b * b) + 2.0 * sx * cy * a * b - cx * a * z)
    else:
        b3 += Jw * (b * wx - cy * a * wy) - kappa * z * (sx * wx + cx * sy * wy)
        b4 = (
            kappa * (sx * (a * a + z * z) - 2.0 * sx * sy * a * z + 2.0 * cx * cy * b * z)
            + Cb * z * wy - Jw * (sy * a * b + b * z) + Jw * sy * a * wy
        )  # fmt: skip
        b5 = (
            kappa * (cx * sy * (a * a + b * b + z * z) + 2.0 * sx * cy * a * b - 2.0 * cx * a * z)
            - Cb * z * wx + Jw * cy * a * z - Jw * sy * a * wx
        )  # fmt: skip
        if p.variant == INERTIAL_LAGRANGE:
            spin = Jw * (z - sy * a)
            b4 += spin * wy
            b5 -= spin * wx

    t0, t1, t2 = torque[0], torque[1], torque[2]
    b1 -= t0
    b2 += -cx * t1 + sx * t2
    b3 += sy * t0 - cy * (sx * t1 + cx * t2)
    b4 += cy * t0 + sy * (sx * t1 + cx * t2)
    b5 += cx * t1 - sx * t2

    inverse = 1.0 / (Cb + Jw)
    g4 = b4 * inverse
    g5 = b5 * inverse
    s11 = m11 - (m14 * m14 + m15 * m15) * inverse
    s12 = -m15 * m25 * inverse
    s13 = m13 - (m14 * m34 + m15 * m35) * inverse
    s22 = m22 - m25 * m25 * inverse
    s23 = m23 - m25 * m35 * inverse
    s33 = m33 - (m34 * m34 + m35 * m35) * inverse
    r1 = b1 - m14 * g4 - m15 * g5
    r2 = b2 - m25 * g5
    r3 = b3 - m34 * g4 - m35 * g5
    k11 = s22 * s33 - s23 * s23
    k12 = s13 * s23 - s12 * s33
    k13 = s12 * s23 - s13 * s22
    scale = 1.0 / (s11 * k11 + s12 * k12 + s13 * k13)
    out[0] = scale * (k11 * r1 + k12 * r2 + k13 * r3)
    out[1] = scale * (k12 * r1 + (s11 * s33 - s13 * s13) * r2 + (s12 * s13 - s11 * s23) * r3)
    out[2] = scale * (k13 * r1 + (s12 * s13 - s11 * s23) * r2 + (s11 * s22 - s12 * s12) * r3)
    out[3] = g4 - (m14 * out[0] + m34 * out[2]) * inverse
    out[4] = g5 - (m15 * out[0] + m25 * out[1] + m35 * out[2]) * inverse


@njit
def encoder_rate_into(x, out):
    """phi_B', the ball's rate relative to the body in body axes (3,): what the encoders see, (5.6)."""
    sx = math.sin(x[0])
    cx = math.cos(x[0])
    sy = math.sin(x[1])
    cy = math.cos(x[1])
    a, b, z, wx, wy = x[5], x[6], x[7], x[8], x[9]
    out[0] = -a + sy * z + cy * wx
    out[1] = -cx * b - cy * sx * z + sx * sy * wx + cx * wy
    out[2] = sx * b - cx * cy * z + cx * sy * wx - sx * wy


@njit
def gyro_into(x, out):
    """Body rates in body axes (3,), (5.25)."""
    sx = math.sin(x[0])
    cx = math.cos(x[0])
    sy = math.sin(x[1])
    cy = math.cos(x[1])
    out[0] = x[5] - sy * x[7]
    out[1] = cx * x[6] + cy * sx * x[7]
    out[2] = -sx * x[6] + cx * cy * x[7]


@njit
def accelerometer_into(x, xdd, p, out):
    """y = R'([0, 0, -g] - a) at the IMU (3,), the papers' sign (a real chip reports the negative), (5.26).

    Args:
        xdd: (5,) accelerations as `acceleration_from_torque` gives them.
    """
    sx = math.sin(x[0])
    cx = math.cos(x[0])
    sy = math.sin(x[1])
    cy = math.cos(x[1])
    a, b, z, wx, wy = x[5], x[6], x[7], x[8], x[9]
    # Everything in the yaw-rotated frame; lever = Ry Rx l_a.
    lx, ly, lz = p.imu_position_m[0], p.imu_position_m[1], p.imu_position_m[2]
    turned = sx * ly + cx * lz
    px = cy * lx + sy * turned
    py = cx * ly - sx * lz
    pz = -sy * lx + cy * turned
    ox = cy * a
    oy = b
    oz = z - sy * a
    dx = cy * xdd[0] - sy * b * a - z * b
    dy = xdd[1] + z * cy * a
    dz = xdd[2] - sy * xdd[0] - cy * a * b
    vx = oy * pz - oz * py
    vy = oz * px - ox * pz
    vz = ox * py - oy * px
    ax = p.ball_radius_m * (xdd[4] + z * wx) + dy * pz - dz * py + oy * vz - oz * vy
    ay = -p.ball_radius_m * (xdd[3] - z * wy) + dz * px - dx * pz + oz * vx - ox * vz
    az = dx * py - dy * px + ox * vy - oy * vx + p.gravity_m_s2
    out[0] = -(cy * ax - sy * az)
    down = sy * ax + cy * az
    out[1] = -(sx * down + cx * ay)
    out[2] = -(cx * down - sx * ay)


def acceleration(x, u, p) -> np.ndarray:
    """v' (5,) under body commands u (3,): torque = k1 u - K2 phi_B', (5.13), (5.14). p: record of PARAMETERS."""
    x = np.asarray(x, float)
    rate = np.empty(3)
    encoder_rate_into(x, rate)
    out = np.empty(5)
    torque = p.torque_per_command_n_m * np.asarray(u, float) - p.damping_n_m_s_rad * rate
    acceleration_from_torque(x, torque, p, out)
    return out


def derivative(x, u, p) -> np.ndarray:
    """x' (10,)."""
    x = np.asarray(x, float)
    cosine, sine = math.cos(x[2]), math.sin(x[2])
    rolling = [cosine * x[8] - sine * x[9], sine * x[8] + cosine * x[9]]
    return np.concatenate([x[5:8], rolling, acceleration(x, u, p)])


def gyro(x) -> np.ndarray:
    """Body rates (3,), body axes."""
    out = np.empty(3)
    gyro_into(np.asarray(x, float), out)
    return out


def encoder_rate(x) -> np.ndarray:
    """phi_B' (3,), body axes."""
    out = np.empty(3)
    encoder_rate_into(np.asarray(x, float), out)
    return out


def accelerometer(x, xdd, p) -> np.ndarray:
    """Accelerometer (3,) in body axes, the papers' sign; xdd (5,) from `acceleration`."""
    out = np.empty(3)
    accelerometer_into(np.asarray(x, float), np.asarray(xdd, float), p, out)
    return out


def energy(x, p) -> float:
    """Kinetic and potential energy in J; constant where u = 0 and K2 = 0."""
    x = np.asarray(x, float)
    sx, cx, sy, cy = math.sin(x[0]), math.cos(x[0]), math.sin(x[1]), math.cos(x[1])
    rotation = np.array([[cy, sy * sx, sy * cx], [0.0, cx, -sx], [-sy, cy * sx, cy * cx]])
    r, mt = p.ball_radius_m, p.body_mass_kg
    body_rate = gyro(x)
    inertial_rate = rotation @ body_rate
    center = rotation @ np.array([0.0, 0.0, p.com_height_m])
    velocity = np.array([r * x[9], -r * x[8], 0.0])
    com_velocity = velocity + np.cross(inertial_rate, center)
    Jw = p.wheel_inertia_kg_m2 * (r / p.wheel_radius_m) ** 2
    rate = encoder_rate(x)
    return float(
        0.5 * mt * com_velocity @ com_velocity
        + 0.5 * body_rate @ (np.asarray(p.body_inertia_kg_m2) * body_rate)
        + 0.5 * (p.ball_mass_kg * r * r + p.ball_inertia_kg_m2) * (x[8] ** 2 + x[9] ** 2)
        + 0.5 * Jw * rate @ rate
        + mt * p.gravity_m_s2 * center[2]
    )
