"""The mobile inverted pendulum (eduMIP): exact nonlinear dynamics and sensors.

State x = [pitch, phi, yaw, pitch', phi', yaw']. Body axes: x to the left, y to the back, z up; pitch > 0 leans forward (towards -y), phi is
the mean angle of the wheels relative to the body (what the encoders see), phi' > 0 rolls forward, yaw > 0 turns left. Body rotation
R = Rz(yaw) Rx(pitch). Commands u = [u_x, u_z]: the right wheel (1) gets u_x + u_z, the left one (2) u_x - u_z; a command of 1 is a torque k1.

The robot cannot slip sideways, a non-holonomic constraint: putting it into the Lagrangian before the variation, as the papers do, loses the centripetal
force of the offset centre of mass. Variants (both conserve energy, so only a comparison with constraint forces tells them apart):
  EXACT    with these terms; agrees with Newton-Euler to rounding
  THESIS   the papers' Lagrangian, misprints removed; for comparison only

A wheel's inertia about its axle may be read in two ways: all of it turns with the wheel (rigid), or a part of it is the geared rotor as seen through
the gear, which turns with phi' and not with the body (`rotor_inertia_kg_m2`, included in the wheel's).

Source: dissertation chapter 3 and A.1, corrected as in section I.1 of the equations.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.models.mip_yaw import (  # noqa: F401  (part of this module's interface)
    high_yaw_derivative,
    high_yaw_derivative_jacobian,
    high_yaw_output,
    high_yaw_output_jacobian,
)

EXACT, THESIS = 0, 1

PARAMETERS = np.dtype(
    [
        ("body_mass_kg", "f8"),  # m_b
        ("wheel_mass_kg", "f8"),  # m_w, each
        ("wheel_radius_m", "f8"),  # r
        ("track_m", "f8"),  # d, between the wheels
        ("com_height_m", "f8"),  # l, above the axle
        ("body_inertia_kg_m2", "f8", (3,)),  # I_b about the centre of mass
        ("wheel_inertia_kg_m2", "f8", (3,)),  # I_w of one wheel, first about the axle
        ("rotor_inertia_kg_m2", "f8"),  # part of I_w1 that belongs to the geared rotor
        ("torque_per_command_n_m", "f8"),  # k1, a wheel
        ("damping_n_m_s_rad", "f8"),  # k2, a wheel
        ("gravity_m_s2", "f8"),
        ("imu_position_m", "f8", (3,)),  # rho, from the centre of mass, body axes
        ("variant", "i8"),
    ],
    align=True,
)
TABLE_3_2 = {
    "body_mass_kg": 0.218,
    "wheel_mass_kg": 0.024,
    "wheel_radius_m": 0.035,
    "track_m": 0.070,
    "com_height_m": 0.046,
    "body_inertia_kg_m2": (5.91e-4, 2.99e-4, 2.91e-4),
    "wheel_inertia_kg_m2": (6.42e-5, 7.48e-6, 7.48e-6),
    "rotor_inertia_kg_m2": 0.0,
    "torque_per_command_n_m": 0.12,
    "damping_n_m_s_rad": 0.003,
    "gravity_m_s2": 9.8,
    "imu_position_m": (0.0, 0.0, 0.0),
    "variant": EXACT,
}


def parameters(**overrides):
    """Parameter set of dissertation Table 3.2 with changes, (1,) record array of PARAMETERS; KeyError for an unknown name."""
    unknown = set(overrides) - set(TABLE_3_2)
    if unknown:
        raise KeyError(f"no such model parameter: {', '.join(sorted(unknown))}")
    p = np.zeros(1, PARAMETERS).view(np.recarray)
    for name, value in {**TABLE_3_2, **overrides}.items():
        p[name] = value
    return p


def rotor_inertia(wheel_inertia_kg_m2, reading: str) -> float:
    """What of I_w1 belongs to the rotor: nothing ("rigid"), or what a flat disc of the other two moments cannot have ("rotor")."""
    about_axle, second, third = wheel_inertia_kg_m2
    return max(0.0, about_axle - second - third) if reading == "rotor" else 0.0


@njit
def acceleration_from_torque(x, total, difference, p, out):
    """[pitch'', phi'', yaw''] (3,) under the wheels' torques total = tau_1 + tau_2, difference = tau_1 - tau_2, section I.1."""
    st = math.sin(x[0])
    ct = math.cos(x[0])
    pitch_rate, phi_rate, yaw_rate = x[3], x[4], x[5]
    r = p.wheel_radius_m
    d = p.track_m
    length = p.com_height_m
    mb = p.body_mass_kg
    mw = p.wheel_mass_kg
    Ib2 = p.body_inertia_kg_m2[1]
    Ib3 = p.body_inertia_kg_m2[2]
    Iw1 = p.wheel_inertia_kg_m2[0]
    Iw2 = p.wheel_inertia_kg_m2[1]
    Iw3 = p.wheel_inertia_kg_m2[2]
    kappa = mb * length * r
    J = Ib2 - Ib3 + 2.0 * Iw2 - 2.0 * Iw3 + length * length * mb
    rigid = 2.0 * (Iw1 - p.rotor_inertia_kg_m2)
    rolling = (mb + 2.0 * mw) * r * r
    m11 = p.body_inertia_kg_m2[0] + rigid + rolling + mb * length * length + 2.0 * kappa * ct
    m12 = rigid + rolling + kappa * ct
    m22 = 2.0 * Iw1 + rolling
    m33 = (
        r / d * (Ib2 + Ib3 + 2.0 * Iw2 + 2.0 * Iw3 + length * length * mb)
        + d / r * (Iw1 + mw * r * r) - r / d * J * (1.0 - 2.0 * st * st)
    )  # fmt: skip
    b1 = st * (J * ct * yaw_rate * yaw_rate + length * mb * p.gravity_m_s2 + kappa * pitch_rate * pitch_rate)
    b2 = total + kappa * st * pitch_rate * pitch_rate
    b3 = difference - 2.0 * r / d * J * 2.0 * st * ct * yaw_rate * pitch_rate
    if p.variant == EXACT:
        b1 += kappa * st * yaw_rate * yaw_rate
        b2 += kappa * st * yaw_rate * yaw_rate
        b3 -= 2.0 * r / d * kappa * st * yaw_rate * (pitch_rate + phi_rate)
    inverse = 1.0 / (m11 * m22 - m12 * m12)
    out[0] = inverse * (m22 * b1 - m12 * b2)
    out[1] = inverse * (m11 * b2 - m12 * b1)
    out[2] = b3 / m33


@njit
def gyro_into(x, out):
    """Body rates in body axes (3,)."""
    out[0] = x[3]
    out[1] = x[5] * math.sin(x[0])
    out[2] = x[5] * math.cos(x[0])


@njit
def encoder_rate_into(x, p, out):
    """Rates of the right and the left wheel relative to the body (2,), (3.14)."""
    turn = 0.5 * p.track_m / p.wheel_radius_m * x[5]
    out[0] = x[4] + turn
    out[1] = x[4] - turn


@njit
def accelerometer_into(x, xdd, p, out):
    """y = R'([0, 0, -g] - a) at the IMU (3,), the papers' sign (a real chip reports the negative); xdd (3,) accelerations.

    The centre of mass by (3.26), the displaced IMU by the rigid body.
    """
    st = math.sin(x[0])
    ct = math.cos(x[0])
    pitch_rate, phi_rate, yaw_rate = x[3], x[4], x[5]
    r = p.wheel_radius_m
    length = p.com_height_m
    g = p.gravity_m_s2
    ax = yaw_rate * ((r + 2.0 * length * ct) * pitch_rate + r * phi_rate) + length * st * xdd[2]
    ay = length * st * ct * yaw_rate * yaw_rate - (length + r * ct) * xdd[0] - r * ct * xdd[1]
    az = -length * st * st * yaw_rate * yaw_rate - length * pitch_rate * pitch_rate + r * st * (xdd[0] + xdd[1])
    ox = pitch_rate
    oy = yaw_rate * st
    oz = yaw_rate * ct
    dx = xdd[0]
    dy = xdd[2] * st + yaw_rate * pitch_rate * ct
    dz = xdd[2] * ct - yaw_rate * pitch_rate * st
    px, py, pz = p.imu_position_m[0], p.imu_position_m[1], p.imu_position_m[2]
    along = ox * px + oy * py + oz * pz
    square = ox * ox + oy * oy + oz * oz
    ax += dy * pz - dz * py + ox * along - px * square
    ay += dz * px - dx * pz + oy * along - py * square
    az += dx * py - dy * px + oz * along - pz * square
    out[0] = -ax
    out[1] = -g * st - ay
    out[2] = -g * ct - az


def acceleration(x, u, p) -> np.ndarray:
    """[pitch'', phi'', yaw''] under commands u = [u_x, u_z]: tau_i = k1 u_i - k2 phi_i'. p: record of PARAMETERS."""
    x = np.asarray(x, float)
    rate, out = np.empty(2), np.empty(3)
    encoder_rate_into(x, p, rate)
    torque = p.torque_per_command_n_m * np.array([u[0] + u[1], u[0] - u[1]]) - p.damping_n_m_s_rad * rate
    acceleration_from_torque(x, torque[0] + torque[1], torque[0] - torque[1], p, out)
    return out


def derivative(x, u, p) -> np.ndarray:
    """x' (6,)."""
    x = np.asarray(x, float)
    return np.concatenate([x[3:], acceleration(x, u, p)])


def gyro(x) -> np.ndarray:
    """Body rates (3,), body axes."""
    out = np.empty(3)
    gyro_into(np.asarray(x, float), out)
    return out


def encoder_rate(x, p) -> np.ndarray:
    """Rates of the right and the left wheel relative to the body (2,)."""
    out = np.empty(2)
    encoder_rate_into(np.asarray(x, float), p, out)
    return out


def accelerometer(x, xdd, p) -> np.ndarray:
    """Accelerometer (3,) in body axes, the papers' sign; xdd (3,) from `acceleration`."""
    out = np.empty(3)
    accelerometer_into(np.asarray(x, float), np.asarray(xdd, float), p, out)
    return out


def energy(x, p) -> float:
    """Kinetic and potential energy in J; constant where u = 0 and k2 = 0. From the bodies' motion, not from the mass matrix."""
    pitch, _, _, pitch_rate, phi_rate, yaw_rate = np.asarray(x, float)
    sine, cosine = math.sin(pitch), math.cos(pitch)
    r, half = p.wheel_radius_m, 0.5 * p.track_m
    forward = r * (pitch_rate + phi_rate)
    rate = np.array([pitch_rate, yaw_rate * sine, yaw_rate * cosine])
    # In the frame that turns with yaw (left, back, up): velocity of the axle's middle plus that of the centre of mass about it.
    lever = p.com_height_m * np.array([0.0, -sine, cosine])
    velocity = np.array([0.0, -forward, 0.0]) + np.cross([pitch_rate, 0.0, yaw_rate], lever)
    total = 0.5 * p.body_mass_kg * velocity @ velocity + 0.5 * rate @ (np.asarray(p.body_inertia_kg_m2) * rate)
    turning = np.asarray(p.wheel_inertia_kg_m2)
    for side in (1.0, -1.0):
        relative = phi_rate + side * half / r * yaw_rate
        total += 0.5 * p.wheel_mass_kg * (forward + side * half * yaw_rate) ** 2
        total += 0.5 * (turning[0] - p.rotor_inertia_kg_m2) * (pitch_rate + relative) ** 2 + 0.5 * p.rotor_inertia_kg_m2 * relative**2
        total += 0.5 * turning[2] * yaw_rate**2
    return float(total + p.body_mass_kg * p.gravity_m_s2 * p.com_height_m * cosine)


def linear_matrices(p):
    """A (6, 6), B (6, 2), C (4, 6), D (4, 2) upright at zero yaw rate; outputs [phi, pitch', accelerometer y, yaw]."""
    from mip_rt.models.mip_yaw import coefficients

    c = coefficients(p, "exact")[0]
    A, B, C, D = np.zeros((6, 6)), np.zeros((6, 2)), np.zeros((4, 6)), np.zeros((4, 2))
    A[0, 3] = A[1, 4] = A[2, 5] = 1.0
    for row, terms in ((3, c.tilt), (4, c.wheel)):
        A[row, 0], A[row, 4], B[row, 0] = terms[0], terms[1], terms[3]
    A[5, 5], B[5, 1] = c.yaw[0], c.yaw[1]
    C[0, 1] = C[1, 3] = C[3, 2] = 1.0
    C[2, 0], C[2, 4], C[2, 5], D[2, 0], D[2, 1] = c.accel[0], c.accel[1], c.lever[1] * c.yaw[0], c.accel[3], c.lever[1] * c.yaw[1]
    return A, B, C, D
