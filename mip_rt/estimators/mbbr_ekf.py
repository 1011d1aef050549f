"""The 13-state EKF of the MBBR: high-yaw-rate model, eight measurements.

States: [roll, pitch, yaw, phi*_x, phi*_y, and the five rates, x11, x12, x13]; measurements: gyro (3), encoder ball angle phi_B (3),
accelerometer x and y (papers' sign). Which model constants (exact, the paper's Lagrangian, the paper's printed coefficients) is a matter of the
coefficient record alone.

Source: dissertation (5.32) to (5.35), corrected; the arithmetic is `estimators.ekf`. Three directions are unobservable
(yaw with x13, phi* with x11 and x12); their variance is bounded, see there.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf
from mip_rt.models import mbbr_yaw

STATES = 13
MEASUREMENTS = 8
ALL_VALID = (1 << MEASUREMENTS) - 1

F_START, F_COLUMNS = ekf.pattern(mbbr_yaw.DERIVATIVE_PATTERN)
H_START, H_COLUMNS = ekf.pattern(mbbr_yaw.OUTPUT_PATTERN)

PARAMETERS = np.dtype([("noise", ekf.NOISE), ("model", mbbr_yaw.COEFFICIENTS)], align=True)


def init(p, x0, P0):
    """A filter state with x = x0 (13,) and P = diag(P0) (13,)."""
    return ekf.init(p.noise, STATES, x0, P0)


@njit
def reset(p, state, roll, pitch, yaw, body_angle, gyro):
    """Fresh covariance; attitude, body rates and encoder angles as measured, ball at rest."""
    ekf.reset(state, p.noise, STATES)
    x = state.x
    x[0] = roll
    x[1] = pitch
    x[2] = yaw
    x[3] = body_angle[0] + roll
    x[4] = body_angle[1] + pitch
    x[5] = gyro[0] + pitch * gyro[2]
    x[6] = gyro[1] - roll * gyro[2]
    x[7] = gyro[2]
    x[12] = body_angle[2] + yaw


@njit
def step(p, state, u, y, valid):
    """One cycle: predict with the command of the previous tick, update with the measurements whose bit is set in `valid`.

    Args:
        p: record of PARAMETERS.
        state: record of ekf.STATE.
        u: (3,) body command of the previous tick, after clipping and before friction and coast compensation.
        y: (8,) measurements.
        valid: bit k set where y[k] is a fresh measurement.
    """
    state.status = 0
    x = state.x
    c = p.model
    mbbr_yaw.derivative_jacobian_into(x, u, c, state.A)
    mbbr_yaw.derivative_into(x, u, c, state.dx)
    for i in range(STATES):
        x[i] += p.noise.dt_s * state.dx[i]
    ekf.predict(state, p.noise, F_START, F_COLUMNS, STATES)
    mbbr_yaw.output_into(x, u, c, state.h)
    mbbr_yaw.output_jacobian_into(x, u, c, state.H)
    ekf.update(state, p.noise, H_START, H_COLUMNS, STATES, MEASUREMENTS, y, valid)
    ekf.bound(state, p.noise, STATES)
