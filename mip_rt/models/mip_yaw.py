"""The eduMIP at small lean and any yaw rate: the model of the 6-state EKF, its outputs and their Jacobians.

State [pitch, phi, yaw, and rates], input [u_x, u_z], outputs [phi, pitch', accelerometer y (papers' sign), yaw]; first order in pitch and
exact in yaw rate and input. The accelerometer may sit away from the centre of mass: at 10 rad/s of yaw, 16 mm of displacement are a tilt of 0.16 rad
to a filter that does not know of it.

Variants of the coefficients: exact; the papers' Lagrangian; the papers' printed digits (3.41) to (3.47), whose pitch yaw'^2 terms are too strong.

Source: dissertation (3.41) to (3.47), corrected as in section I.1 of the equations.
"""

import numpy as np

from mip_rt.compiled import njit

COEFFICIENTS = np.dtype(
    [
        ("tilt", "f8", (4,)),  # pitch'' = [pitch, phi', pitch yaw'^2, u_x]
        ("wheel", "f8", (4,)),  # phi'' likewise
        ("yaw", "f8", (3,)),  # yaw'' = [yaw', u_z, pitch yaw' phi']
        ("accel", "f8", (4,)),  # accelerometer y = [pitch, phi', pitch yaw'^2, u_x]
        ("lever", "f8", (2,)),  # ... + [yaw'^2, yaw'']: the IMU behind and beside the centre of mass
    ],
    align=True,
)
VARIANTS = ("exact", "thesis", "printed")
DERIVATIVE_PATTERN = [(0, (3,)), (1, (4,)), (2, (5,)), (3, (0, 4, 5)), (4, (0, 4, 5)), (5, (0, 4, 5))]
OUTPUT_PATTERN = [(0, (1,)), (1, (3,)), (2, (0, 4, 5)), (3, (2,))]
PRINTED_DT_S = 0.005


def coefficients(p, variant: str = "exact", lever_arm: bool = True):
    """(1,) record array of COEFFICIENTS.

    Args:
        p: record of models.mip.PARAMETERS.
        variant: one of VARIANTS.
        lever_arm: model the IMU where imu_position_m says; otherwise in the centre of mass.
    """
    if variant not in VARIANTS:
        raise KeyError(f"no such variant: {variant}")
    c = np.zeros(1, COEFFICIENTS).view(np.recarray)
    if variant == "printed":
        c[0].tilt[:] = np.array([0.629, 0.068, 0.009, -2.72]) / PRINTED_DT_S
        c[0].wheel[:] = np.array([-1.12, 0.813 - 1.0, -0.016, 7.47]) / PRINTED_DT_S
        c[0].yaw[:] = np.array([0.939 - 1.0, 2.44, 0.0]) / PRINTED_DT_S
        c[0].accel[:] = [-7.41, -0.204, -0.0346, 8.17]
        return c
    r, d, length, mb = p.wheel_radius_m, p.track_m, p.com_height_m, p.body_mass_kg
    k1, k2, g = p.torque_per_command_n_m, p.damping_n_m_s_rad, p.gravity_m_s2
    Ib1, Ib2, Ib3 = p.body_inertia_kg_m2
    Iw1, Iw2, Iw3 = p.wheel_inertia_kg_m2
    kappa = mb * length * r
    J = Ib2 - Ib3 + 2.0 * Iw2 - 2.0 * Iw3 + length**2 * mb
    rigid, rolling = 2.0 * (Iw1 - p.rotor_inertia_kg_m2), (mb + 2.0 * p.wheel_mass_kg) * r * r
    m11 = Ib1 + rigid + rolling + mb * length**2 + 2.0 * kappa
    m12 = rigid + rolling + kappa
    m22 = 2.0 * Iw1 + rolling
    m33 = r / d * (Ib2 + Ib3 + 2.0 * Iw2 + 2.0 * Iw3 + length**2 * mb - J) + d / r * (Iw1 + p.wheel_mass_kg * r * r)
    D = m11 * m22 - m12 * m12
    slip = kappa if variant == "exact" else 0.0  # the centripetal terms that the papers' derivation loses
    tilt = np.array([m22 * g * length * mb, 2.0 * k2 * m12, m22 * (J + slip) - m12 * slip, -2.0 * k1 * m12]) / D
    wheel = np.array([-m12 * g * length * mb, -2.0 * k2 * m11, m11 * slip - m12 * (J + slip), 2.0 * k1 * m11]) / D
    px, py, pz = p.imu_position_m if lever_arm else (0.0, 0.0, 0.0)
    accel = (length + r + pz) * tilt + r * wheel
    accel[0] -= g
    accel[2] -= length + pz
    c[0].tilt[:], c[0].wheel[:], c[0].accel[:] = tilt, wheel, accel
    c[0].yaw[:] = np.array([-k2 * d / r, 2.0 * k1, -2.0 * r / d * slip]) / m33
    c[0].lever[:] = [py, -px]
    return c


@njit
def derivative_into(x, u, c, out):
    """x' (6,)."""
    square = x[5] * x[5]
    out[0] = x[3]
    out[1] = x[4]
    out[2] = x[5]
    out[3] = (c.tilt[0] + c.tilt[2] * square) * x[0] + c.tilt[1] * x[4] + c.tilt[3] * u[0]
    out[4] = (c.wheel[0] + c.wheel[2] * square) * x[0] + c.wheel[1] * x[4] + c.wheel[3] * u[0]
    out[5] = c.yaw[0] * x[5] + c.yaw[1] * u[1] + c.yaw[2] * x[0] * x[5] * x[4]


@njit
def derivative_jacobian_into(x, u, c, A):
    """The structural entries of dx'/dx."""
    square = x[5] * x[5]
    A[0, 3] = 1.0
    A[1, 4] = 1.0
    A[2, 5] = 1.0
    A[3, 0] = c.tilt[0] + c.tilt[2] * square
    A[3, 4] = c.tilt[1]
    A[3, 5] = 2.0 * c.tilt[2] * x[0] * x[5]
    A[4, 0] = c.wheel[0] + c.wheel[2] * square
    A[4, 4] = c.wheel[1]
    A[4, 5] = 2.0 * c.wheel[2] * x[0] * x[5]
    A[5, 0] = c.yaw[2] * x[5] * x[4]
    A[5, 4] = c.yaw[2] * x[0] * x[5]
    A[5, 5] = c.yaw[0] + c.yaw[2] * x[0] * x[4]


@njit
def output_into(x, u, c, out):
    """[phi, pitch', accelerometer y, yaw]."""
    square = x[5] * x[5]
    turn = c.yaw[0] * x[5] + c.yaw[1] * u[1] + c.yaw[2] * x[0] * x[5] * x[4]
    out[0] = x[1]
    out[1] = x[3]
    out[2] = (c.accel[0] + c.accel[2] * square) * x[0] + c.accel[1] * x[4] + c.accel[3] * u[0] + c.lever[0] * square + c.lever[1] * turn
    out[3] = x[2]


@njit
def output_jacobian_into(x, u, c, H):
    """The structural entries of the outputs' derivatives."""
    square = x[5] * x[5]
    H[0, 1] = 1.0
    H[1, 3] = 1.0
    H[2, 0] = c.accel[0] + c.accel[2] * square + c.lever[1] * c.yaw[2] * x[5] * x[4]
    H[2, 4] = c.accel[1] + c.lever[1] * c.yaw[2] * x[0] * x[5]
    H[2, 5] = 2.0 * (c.accel[2] * x[0] + c.lever[0]) * x[5] + c.lever[1] * (c.yaw[0] + c.yaw[2] * x[0] * x[4])
    H[3, 2] = 1.0


def _filled(function, shape, x, u, p, variant):
    out = np.zeros(shape)
    function(np.asarray(x, float), np.asarray(u, float), coefficients(p, variant)[0], out)
    return out


def high_yaw_derivative(x, u, p, variant: str = "exact") -> np.ndarray:
    """x' (6,); p: record of models.mip.PARAMETERS."""
    return _filled(derivative_into, 6, x, u, p, variant)


def high_yaw_derivative_jacobian(x, u, p, variant: str = "exact") -> np.ndarray:
    """dx'/dx (6, 6)."""
    return _filled(derivative_jacobian_into, (6, 6), x, u, p, variant)


def high_yaw_output(x, u, p, variant: str = "exact") -> np.ndarray:
    """Outputs (4,)."""
    return _filled(output_into, 4, x, u, p, variant)


def high_yaw_output_jacobian(x, u, p, variant: str = "exact") -> np.ndarray:
    """Derivatives of the outputs (4, 6)."""
    return _filled(output_jacobian_into, (4, 6), x, u, p, variant)
