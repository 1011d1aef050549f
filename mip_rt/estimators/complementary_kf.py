"""The complementary Kalman filter: tilt and gyro bias, the gyro as input, the accelerometer's tilt as measurement.

    x = [tilt, bias],  tilt' = rate - bias,  y = tilt_acc

Source: dissertation (3.35) to (3.38), ACC 2018 (42) to (45).
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf
from mip_rt.estimators.complementary import ACCELEROMETER_VALID, GYRO_VALID

STATES = 2
MEASUREMENTS = 1
ALL_VALID = GYRO_VALID | ACCELEROMETER_VALID

PARAMETERS = np.dtype([("noise", ekf.NOISE)], align=True)

F_START, F_COLUMNS = ekf.pattern([(0, (1,)), (1, ())])
H_START, H_COLUMNS = ekf.pattern([(0, (0,))])


def init(p, x0, P0):
    """A filter state with x = x0 (2,) and P = diag(P0) (2,)."""
    return ekf.init(p.noise, STATES, x0, P0)


@njit
def reset(p, state, tilt):
    """Fresh covariance, this tilt, no bias."""
    ekf.reset(state, p.noise, STATES)
    state.x[0] = tilt


@njit
def step(p, state, u, y, valid):
    """One tick; arguments as `complementary.step`."""
    state.status = 0
    flags = 0
    if valid & GYRO_VALID:
        if abs(u[0]) < math.inf:
            state.x[0] += p.noise.dt_s * (u[0] - state.x[1])
        else:
            flags = ekf.NOT_FINITE
    state.A[0, 1] = -1.0
    ekf.predict(state, p.noise, F_START, F_COLUMNS, STATES)
    state.h[0] = state.x[0]
    state.H[0, 0] = 1.0
    ekf.update(state, p.noise, H_START, H_COLUMNS, STATES, MEASUREMENTS, y, 1 if valid & ACCELEROMETER_VALID else 0)
    ekf.bound(state, p.noise, STATES)
    state.status |= flags
