"""The 8-state linear Kalman filter of the MBBR, as printed and with the yaw rotation that the paper's model lacks.

States: [roll, pitch, phi*_x, phi*_y, roll', pitch', w_x, w_y]; measurements: gyro x, y, encoder ball angle x, y, accelerometer x, y.
The linear model has no yaw: while the robot spins at z', the yaw-rotated ball rates turn into each other,
w_x' += z' w_y, w_y' -= z' w_x. The printed filter omits that (so its ball velocity turns with the robot); `rotation` = 1 adds it,
with z' from the gyro.

Source: dissertation (5.28) to (5.30), (6.32), with the linear model of section I.3.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf

STATES = 8
MEASUREMENTS = 6
ALL_VALID = (1 << MEASUREMENTS) - 1

MODEL = np.dtype(
    [
        ("tilt_tilt", "f8"),  # theta'' = tilt_tilt theta + tilt_rate (theta' - w) + tilt_u u
        ("tilt_rate", "f8"),
        ("tilt_u", "f8"),
        ("ball_tilt", "f8"),  # w' = ball_tilt theta + ball_rate (theta' - w) + ball_u u
        ("ball_rate", "f8"),
        ("ball_u", "f8"),
        ("accel_tilt", "f8"),  # a1 = accel_tilt pitch + accel_rate (pitch' - w_y) + accel_u u_y; a2 = -(the same in x)
        ("accel_rate", "f8"),
        ("accel_u", "f8"),
        ("rotation", "f8"),  # 1: rotate the ball rates with the measured yaw rate; 0: as printed
    ],
    align=True,
)
PARAMETERS = np.dtype([("noise", ekf.NOISE), ("model", MODEL)], align=True)

# The rotation's places are structural; they hold zeros in the filter as printed.
F_START, F_COLUMNS = ekf.pattern(
    [
        (0, (4,)),
        (1, (5,)),
        (2, (6,)),
        (3, (7,)),
        (4, (0, 4, 6)),
        (5, (1, 5, 7)),
        (6, (0, 4, 6, 7)),
        (7, (1, 5, 6, 7)),
    ]
)
H_START, H_COLUMNS = ekf.pattern([(0, (4,)), (1, (5,)), (2, (0, 2)), (3, (1, 3)), (4, (1, 5, 7)), (5, (0, 4, 6))])


def configure_model(model, A, B, C, D, rotation: bool) -> None:
    """Fills a MODEL record from the matrices of `models.mbbr_linear.linear_matrices`.

    State order there is that of this filter: A (8, 8), B (8, 2), C (6, 8), D (6, 2) with u = [u_x, u_y].
    """
    model.tilt_tilt, model.tilt_rate, model.tilt_u = A[4, 0], A[4, 4], B[4, 0]
    model.ball_tilt, model.ball_rate, model.ball_u = A[6, 0], A[6, 4], B[6, 0]
    model.accel_tilt, model.accel_rate, model.accel_u = C[4, 1], C[4, 5], D[4, 1]
    model.rotation = 1.0 if rotation else 0.0


def init(p, x0, P0):
    """A filter state with x = x0 (8,) and P = diag(P0) (8,)."""
    return ekf.init(p.noise, STATES, x0, P0)


@njit
def reset(p, state, roll, pitch, body_angle, gyro):
    """Fresh covariance; attitude, body rates and encoder angles as measured, ball at rest."""
    ekf.reset(state, p.noise, STATES)
    x = state.x
    x[0] = roll
    x[1] = pitch
    x[2] = body_angle[0] + roll
    x[3] = body_angle[1] + pitch
    x[4] = gyro[0] + pitch * gyro[2]
    x[5] = gyro[1] - roll * gyro[2]


@njit
def step(p, state, u, y, valid, yaw_rate_rad_s):
    """One cycle, as `mbbr_ekf.step`; y is (6,), u (3,) of which the first two count.

    Args:
        yaw_rate_rad_s: measured yaw rate; used only where the model's `rotation` is 1.
    """
    state.status = 0
    m = p.model
    dt = p.noise.dt_s
    x = state.x
    z = m.rotation * yaw_rate_rad_s
    A = state.A
    dx = state.dx
    for i in range(2):
        slip = x[4 + i] - x[6 + i]
        dx[i] = x[4 + i]
        dx[2 + i] = x[6 + i]
        dx[4 + i] = m.tilt_tilt * x[i] + m.tilt_rate * slip + m.tilt_u * u[i]
        dx[6 + i] = m.ball_tilt * x[i] + m.ball_rate * slip + m.ball_u * u[i]
        A[i, 4 + i] = 1.0
        A[2 + i, 6 + i] = 1.0
        A[4 + i, i] = m.tilt_tilt
        A[4 + i, 4 + i] = m.tilt_rate
        A[4 + i, 6 + i] = -m.tilt_rate
        A[6 + i, i] = m.ball_tilt
        A[6 + i, 4 + i] = m.ball_rate
        A[6 + i, 6 + i] = -m.ball_rate
    dx[6] += z * x[7]
    dx[7] -= z * x[6]
    A[6, 7] = z
    A[7, 6] = -z
    for i in range(STATES):
        x[i] += dt * dx[i]
    ekf.predict(state, p.noise, F_START, F_COLUMNS, STATES)

    h = state.h
    H = state.H
    h[0] = x[4]
    h[1] = x[5]
    h[2] = x[2] - x[0]
    h[3] = x[3] - x[1]
    h[4] = m.accel_tilt * x[1] + m.accel_rate * (x[5] - x[7]) + m.accel_u * u[1]
    h[5] = -(m.accel_tilt * x[0] + m.accel_rate * (x[4] - x[6]) + m.accel_u * u[0])
    H[0, 4] = 1.0
    H[1, 5] = 1.0
    H[2, 0] = -1.0
    H[2, 2] = 1.0
    H[3, 1] = -1.0
    H[3, 3] = 1.0
    H[4, 1] = m.accel_tilt
    H[4, 5] = m.accel_rate
    H[4, 7] = -m.accel_rate
    H[5, 0] = -m.accel_tilt
    H[5, 4] = -m.accel_rate
    H[5, 6] = m.accel_rate
    ekf.update(state, p.noise, H_START, H_COLUMNS, STATES, MEASUREMENTS, y, valid)
    ekf.bound(state, p.noise, STATES)
