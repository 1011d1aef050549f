"""The MBBR at high yaw rate: first order in roll, pitch and their rates, exact in the yaw rate; the model of the EKF.

Thirteen states: [roll x, pitch y, yaw z, phi*_x, phi*_y, x', y', z', w_x, w_y, x11, x12, x13] with the augmentations x11' = y z', x12' = -x z',
x13' = y w_x - x w_y; u = [u_x, u_y, u_z] body commands; eight outputs: gyro (3), encoder ball angles (3), accelerometer x and y in the papers'
sign y = R'([0, 0, -g] - p'').

Every row of f and h is a sum of coefficient times monomial, so one kernel serves every variant; a variant is a set of
coefficients:
  exact                Lagrange-d'Alembert, agrees with Newton-Euler
  inertial-lagrange    the derivation behind the paper's chapter 5 (rolling substituted before variation)
  printed              the digits of dissertation (5.32), (5.33), with their errors: 410 for 502, the missing rotation of the ball
                       rates in f9 and f10, pitch for roll in h2
  flown                the printed digits as the robot author's program had them: 502, and roll in h2; the rotation is missing there, too

Source: dissertation (5.31) to (5.33); corrected as section I.3 of the equations, coefficients in its table B.3.
"""

import numpy as np

from mip_rt.compiled import njit

STATES = 13
OUTPUTS = 8
STATE_NAMES = ("roll", "pitch", "yaw", "phi_x", "phi_y", "roll_rate", "pitch_rate", "yaw_rate", "w_x", "w_y",
               "x11", "x12", "x13")  # fmt: skip

# Monomials of the x rows (x'', w_x', a2): x, x'-w_x, u_x, y z', y u_z, y' z', w_y z', x z'^2. The y rows (y'', w_y', a1) have
# the same with x and y exchanged. Monomials of the spin row: u_z, z', y u_x, x u_y, y w_x, x w_y, y' w_x, x' w_y, z' x w_x, z' y w_y.
COEFFICIENTS = np.dtype(
    [
        ("tilt_x", "f8", (8,)),
        ("ball_x", "f8", (8,)),
        ("accel_x", "f8", (8,)),  # a2: it hangs on the x rows
        ("tilt_y", "f8", (8,)),
        ("ball_y", "f8", (8,)),
        ("accel_y", "f8", (8,)),  # a1
        ("spin", "f8", (10,)),
        ("gyro_y_roll", "f8"),  # h2 = y' + (gyro_y_roll x + gyro_y_pitch y) z': 1 and 0; as printed 0 and 1
        ("gyro_y_pitch", "f8"),
    ],
    align=True,
)

_FULL = (0, 1, 5, 6, 7, 8, 9)
DERIVATIVE_PATTERN = (
    (0, (5,)), (1, (6,)), (2, (7,)), (3, (8,)), (4, (9,)),
    (5, _FULL), (6, _FULL), (7, _FULL), (8, _FULL), (9, _FULL),
    (10, (1, 7)), (11, (0, 7)), (12, (0, 1, 8, 9)),
)  # fmt: skip
OUTPUT_PATTERN = (
    (0, (1, 5, 7)), (1, (0, 1, 6, 7)), (2, (7,)), (3, (0, 3, 10)), (4, (1, 4, 11)), (5, (2, 12)), (6, _FULL), (7, _FULL),
)  # fmt: skip

# (5.32), (5.33) as printed, in the order of the monomials above.
_PRINTED_TILT = (130.0, -8.9, -130.0, -12.0, -310.0, 1.8, 0.0029, 0.80)
_PRINTED_BALL = (-280.0, 34.0, 410.0, -6.5, 400.0, 0.44, -0.0062, 0.44)
_PRINTED_ACCEL_Y = (-4.6, 0.5, 7.8, 0.32, -3.1, -0.022, 0.00032, 0.022)
_PRINTED_SPIN = (-220.0, -15.0, 7.5, -140.0, 14.0, -5.2, 0.015, -0.015, 0.012, 0.015)
# x -> y, y -> -x turns an x row into a y row: the four mixed monomials change their sign.
_TO_Y = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0, 1.0])
# a1 -> a2 likewise, and the accelerometer's axes turn as well.
_TO_ACCEL_X = -_TO_Y

_FLOWN_BALL_COMMAND = 502.0  # the program's discrete row has 2.50624 a step of 5 ms
VARIANTS = ("exact", "inertial-lagrange", "printed", "flown")


def coefficients(p, variant: str = "exact"):
    """The coefficient set of a variant, (1,) record array of COEFFICIENTS.

    Args:
        p: record of models.mbbr.PARAMETERS; not used for "printed" and "flown", whose digits are what they are.
        variant: one of VARIANTS.
    """
    c = np.zeros(1, COEFFICIENTS).view(np.recarray)
    if variant in ("printed", "flown"):
        ball = np.array(_PRINTED_BALL)
        if variant == "flown":
            ball[2] = _FLOWN_BALL_COMMAND
        c.tilt_x, c.ball_x = _PRINTED_TILT, ball
        c.tilt_y, c.ball_y = _TO_Y * _PRINTED_TILT, _TO_Y * ball
        c.accel_y, c.accel_x = _PRINTED_ACCEL_Y, _TO_ACCEL_X * _PRINTED_ACCEL_Y
        c.spin = _PRINTED_SPIN
        c.gyro_y_roll, c.gyro_y_pitch = (1.0, 0.0) if variant == "flown" else (0.0, 1.0)
        return c
    if variant not in VARIANTS:
        raise ValueError(f"variant {variant!r} is none of {', '.join(VARIANTS)}")
    k1, K2, r, La, g = p.torque_per_command_n_m, p.damping_n_m_s_rad, p.ball_radius_m, p.imu_position_m[2], p.gravity_m_s2
    mt, mb, l = p.body_mass_kg, p.ball_mass_kg, p.com_height_m  # noqa: E741
    It1, It2, It3 = p.body_inertia_kg_m2
    Jw = p.wheel_inertia_kg_m2 * (r / p.wheel_radius_m) ** 2
    D, kappa, gamma = l * l * mt, l * mt * r, g * l * mt
    A1, A2, B, Iz, J, J2 = It1 + Jw + D, It2 + Jw + D, kappa - Jw, It3 + Jw, It2 - It3 + D, It1 - It3 + D
    Cb = p.ball_inertia_kg_m2 + (mb + mt) * r * r
    C = Cb + Jw
    rolling = Cb if variant == "exact" else C
    # Rows r1, r4 (x) and r2, r5 (y) of the torque balance over the monomials.
    r1 = np.array([gamma, -K2, -k1, K2 - A1 * K2 / Iz, -A1 * k1 / Iz, A1 + J, kappa, J])
    r4 = np.array([0.0, K2, k1, -kappa * K2 / Iz, k1 - kappa * k1 / Iz, 2 * kappa - Jw, rolling, kappa])
    r2 = np.array([gamma, -K2, -k1, J * K2 / Iz, k1 + J * k1 / Iz, -(A1 + J), -kappa, J2])
    r5 = np.array([0.0, K2, k1, kappa * K2 / Iz, -k1 + kappa * k1 / Iz, -2 * kappa + Jw, -rolling, kappa])
    det1, det2 = A1 * C - B * B, A2 * C - B * B
    c.tilt_x, c.ball_x = (C * r1 - B * r4) / det1, (A1 * r4 - B * r1) / det1
    c.tilt_y, c.ball_y = (C * r2 - B * r5) / det2, (A2 * r5 - B * r2) / det2
    # a1 = g y + La (y z'^2 - 2 x' z' - y'' - x alpha) - r (w_y' + z' w_x), alpha = -(k1 u_z + K2 z') / Iz; a2 likewise.
    own1 = np.array([g, 0.0, 0.0, La * K2 / Iz, La * k1 / Iz, -2 * La, -r, La])
    own2 = np.array([-g, 0.0, 0.0, La * K2 / Iz, La * k1 / Iz, -2 * La, -r, -La])
    c.accel_y = own1 - La * c.tilt_y[0] - r * c.ball_y[0]
    c.accel_x = own2 + La * c.tilt_x[0] + r * c.ball_x[0]
    # Zeroth-order accelerations (X0, W0; Y0, V0): factors of u, w and z' w_other.
    xu, xw, xz = -k1 * (C + B) / det1, K2 * (C + B) / det1, (C * kappa - B * rolling) / det1
    wu, ww, wz = k1 * (A1 + B) / det1, -K2 * (A1 + B) / det1, (A1 * rolling - B * kappa) / det1
    yu, yw, yz = -k1 * (C + B) / det2, K2 * (C + B) / det2, (C * kappa - B * rolling) / det2
    vu, vw, vz = k1 * (A2 + B) / det2, -K2 * (A2 + B) / det2, (A2 * rolling - B * kappa) / det2
    c.spin = np.array(
        [
            -k1,
            -K2,
            k1 + A1 * xu + kappa * wu,
            -k1 - J * yu - kappa * vu,
            A1 * xw + kappa * ww,
            -J * yw - kappa * vw,
            Jw,
            -Jw,
            -kappa + J * yz + kappa * vz,
            -kappa + A1 * xz + kappa * wz,
        ]
    ) / Iz
    c.gyro_y_roll = 1.0
    return c


@njit
def _row(c, tilt, slip, u, tilt_other_z, tilt_other_uz, rate_other_z, ball_other_z, tilt_z2):
    return (
        c[0] * tilt + c[1] * slip + c[2] * u + c[3] * tilt_other_z + c[4] * tilt_other_uz
        + c[5] * rate_other_z + c[6] * ball_other_z + c[7] * tilt_z2
    )  # fmt: skip


@njit
def derivative_into(x, u, c, out):
    """f: time derivative of the state. x and out: at least 13 long; u: (3,); c: record of COEFFICIENTS."""
    roll, pitch, p, q, z, wx, wy = x[0], x[1], x[5], x[6], x[7], x[8], x[9]
    ux, uy, uz = u[0], u[1], u[2]
    zz = z * z
    out[0] = p
    out[1] = q
    out[2] = z
    out[3] = wx
    out[4] = wy
    out[5] = _row(c.tilt_x, roll, p - wx, ux, pitch * z, pitch * uz, q * z, wy * z, roll * zz)
    out[6] = _row(c.tilt_y, pitch, q - wy, uy, roll * z, roll * uz, p * z, wx * z, pitch * zz)
    s = c.spin
    out[7] = (
        s[0] * uz + s[1] * z + s[2] * pitch * ux + s[3] * roll * uy + s[4] * pitch * wx + s[5] * roll * wy
        + s[6] * q * wx + s[7] * p * wy + z * (s[8] * roll * wx + s[9] * pitch * wy)
    )  # fmt: skip
    out[8] = _row(c.ball_x, roll, p - wx, ux, pitch * z, pitch * uz, q * z, wy * z, roll * zz)
    out[9] = _row(c.ball_y, pitch, q - wy, uy, roll * z, roll * uz, p * z, wx * z, pitch * zz)
    out[10] = pitch * z
    out[11] = -roll * z
    out[12] = pitch * wx - roll * wy


@njit
def output_into(x, u, c, out):
    """h: the eight outputs, out (8,)."""
    roll, pitch, p, q, z, wx, wy = x[0], x[1], x[5], x[6], x[7], x[8], x[9]
    uz = u[2]
    zz = z * z
    out[0] = p - pitch * z
    out[1] = q + (c.gyro_y_roll * roll + c.gyro_y_pitch * pitch) * z
    out[2] = z
    out[3] = x[3] - roll + x[10]
    out[4] = x[4] - pitch + x[11]
    out[5] = -x[2] + x[12]
    out[6] = _row(c.accel_y, pitch, q - wy, u[1], roll * z, roll * uz, p * z, wx * z, pitch * zz)
    out[7] = _row(c.accel_x, roll, p - wx, u[0], pitch * z, pitch * uz, q * z, wy * z, roll * zz)


@njit
def _jacobian_x(c, x, uz, out, i):
    """Row i of a Jacobian, for a function over the x monomials."""
    roll, pitch, q, z, wy = x[0], x[1], x[6], x[7], x[9]
    out[i, 0] = c[0] + c[7] * z * z
    out[i, 1] = c[3] * z + c[4] * uz
    out[i, 5] = c[1]
    out[i, 6] = c[5] * z
    out[i, 7] = c[3] * pitch + c[5] * q + c[6] * wy + 2.0 * c[7] * roll * z
    out[i, 8] = -c[1]
    out[i, 9] = c[6] * z


@njit
def _jacobian_y(c, x, uz, out, i):
    """Row i of a Jacobian, for a function over the y monomials."""
    roll, pitch, p, z, wx = x[0], x[1], x[5], x[7], x[8]
    out[i, 0] = c[3] * z + c[4] * uz
    out[i, 1] = c[0] + c[7] * z * z
    out[i, 5] = c[5] * z
    out[i, 6] = c[1]
    out[i, 7] = c[3] * roll + c[5] * p + c[6] * wx + 2.0 * c[7] * pitch * z
    out[i, 8] = c[6] * z
    out[i, 9] = -c[1]


@njit
def derivative_jacobian_into(x, u, c, out):
    """df/dx at (x, u); only the entries of DERIVATIVE_PATTERN are written. out: (>= 13, >= 13)."""
    roll, pitch, p, q, z, wx, wy = x[0], x[1], x[5], x[6], x[7], x[8], x[9]
    for i in range(5):
        out[i, 5 + i] = 1.0
    _jacobian_x(c.tilt_x, x, u[2], out, 5)
    _jacobian_y(c.tilt_y, x, u[2], out, 6)
    s = c.spin
    out[7, 0] = s[3] * u[1] + s[5] * wy + s[8] * z * wx
    out[7, 1] = s[2] * u[0] + s[4] * wx + s[9] * z * wy
    out[7, 5] = s[7] * wy
    out[7, 6] = s[6] * wx
    out[7, 7] = s[1] + s[8] * roll * wx + s[9] * pitch * wy
    out[7, 8] = s[4] * pitch + s[6] * q + s[8] * z * roll
    out[7, 9] = s[5] * roll + s[7] * p + s[9] * z * pitch
    _jacobian_x(c.ball_x, x, u[2], out, 8)
    _jacobian_y(c.ball_y, x, u[2], out, 9)
    out[10, 1] = z
    out[10, 7] = pitch
    out[11, 0] = -z
    out[11, 7] = -roll
    out[12, 0] = -wy
    out[12, 1] = wx
    out[12, 8] = pitch
    out[12, 9] = -roll


@njit
def output_jacobian_into(x, u, c, out):
    """dh/dx at (x, u); only the entries of OUTPUT_PATTERN are written. out: (8, >= 13)."""
    z = x[7]
    out[0, 5] = 1.0
    out[0, 1] = -z
    out[0, 7] = -x[1]
    out[1, 6] = 1.0
    out[1, 0] = c.gyro_y_roll * z
    out[1, 1] = c.gyro_y_pitch * z
    out[1, 7] = c.gyro_y_roll * x[0] + c.gyro_y_pitch * x[1]
    out[2, 7] = 1.0
    for i in range(2):
        out[3 + i, i] = -1.0
        out[3 + i, 3 + i] = 1.0
        out[3 + i, 10 + i] = 1.0
    out[5, 2] = -1.0
    out[5, 12] = 1.0
    _jacobian_y(c.accel_y, x, u[2], out, 6)
    _jacobian_x(c.accel_x, x, u[2], out, 7)


def high_yaw_derivative(x13, u, p, variant="exact") -> np.ndarray:
    """f(x, u), (13,), for model parameters p (record of models.mbbr.PARAMETERS)."""
    out = np.zeros(STATES)
    derivative_into(np.asarray(x13, float), np.asarray(u, float), coefficients(p, variant)[0], out)
    return out


def high_yaw_output(x13, u, p, variant="exact") -> np.ndarray:
    """h(x, u), (8,)."""
    out = np.zeros(OUTPUTS)
    output_into(np.asarray(x13, float), np.asarray(u, float), coefficients(p, variant)[0], out)
    return out


def high_yaw_derivative_jacobian(x13, u, p, variant="exact") -> np.ndarray:
    """df/dx, (13, 13)."""
    out = np.zeros((STATES, STATES))
    derivative_jacobian_into(np.asarray(x13, float), np.asarray(u, float), coefficients(p, variant)[0], out)
    return out


def high_yaw_output_jacobian(x13, u, p, variant="exact") -> np.ndarray:
    """dh/dx, (8, 13)."""
    out = np.zeros((OUTPUTS, STATES))
    output_jacobian_into(np.asarray(x13, float), np.asarray(u, float), coefficients(p, variant)[0], out)
    return out
