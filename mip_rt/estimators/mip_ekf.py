"""The 6-state EKF of the eduMIP at any yaw rate.

States [pitch, phi, yaw, and rates]; measurements [phi, pitch' (gyro), accelerometer y (papers' sign), yaw], phi and yaw from the encoders. Which model (exact,
the paper's Lagrangian, the paper's printed digits; with or without the IMU's lever arm) is a matter of the coefficient record alone.

Source: dissertation (3.41) to (3.49), ACC 2018 (46) to (52), corrected; the arithmetic is `estimators.ekf`.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf
from mip_rt.models import mip_yaw

STATES = 6
MEASUREMENTS = 4
ALL_VALID = (1 << MEASUREMENTS) - 1

F_START, F_COLUMNS = ekf.pattern(mip_yaw.DERIVATIVE_PATTERN)
H_START, H_COLUMNS = ekf.pattern(mip_yaw.OUTPUT_PATTERN)

PARAMETERS = np.dtype([("noise", ekf.NOISE), ("model", mip_yaw.COEFFICIENTS)], align=True)


def init(p, x0, P0):
    """A filter state with x = x0 (6,) and P = diag(P0) (6,)."""
    return ekf.init(p.noise, STATES, x0, P0)


@njit
def reset(p, state, pitch, phi, yaw, pitch_rate, yaw_rate):
    """Fresh covariance; attitude, encoders and body rates as measured, wheels at rest."""
    ekf.reset(state, p.noise, STATES)
    x = state.x
    x[0] = pitch
    x[1] = phi
    x[2] = yaw
    x[3] = pitch_rate
    x[4] = -pitch_rate
    x[5] = yaw_rate


@njit
def step(p, state, u, y, valid):
    """One cycle: predict with the command of the previous tick, update with the measurements whose bit is set in `valid`.

    Args:
        p: record of PARAMETERS.
        state: record of ekf.STATE.
        u: (2,) [u_x, u_z] of the previous tick, after clipping and before friction compensation.
        y: (4,) measurements.
        valid: bit k set where y[k] is a fresh measurement.
    """
    state.status = 0
    x = state.x
    c = p.model
    mip_yaw.derivative_jacobian_into(x, u, c, state.A)
    mip_yaw.derivative_into(x, u, c, state.dx)
    for i in range(STATES):
        x[i] += p.noise.dt_s * state.dx[i]
    ekf.predict(state, p.noise, F_START, F_COLUMNS, STATES)
    mip_yaw.output_into(x, u, c, state.h)
    mip_yaw.output_jacobian_into(x, u, c, state.H)
    ekf.update(state, p.noise, H_START, H_COLUMNS, STATES, MEASUREMENTS, y, valid)
    ekf.bound(state, p.noise, STATES)
