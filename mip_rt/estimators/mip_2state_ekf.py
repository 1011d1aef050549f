"""The 2-state EKF of O'Murchadha: lean and lean rate from the direction of gravity and the gyro, without a model of the robot.

States [lean, rate], rate a random walk; measurements [sin(lean), cos(lean), rate], the first two the accelerometer in units of g. The
robot's own acceleration is no part of the model and is taken for lean.

Source: O'Murchadha, (11), (12), with K = P H' (H P H' + R)^-1 as in section H of the equations.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf

STATES = 2
MEASUREMENTS = 3
ALL_VALID = (1 << MEASUREMENTS) - 1

PARAMETERS = np.dtype([("noise", ekf.NOISE)], align=True)

F_START, F_COLUMNS = ekf.pattern([(0, (1,)), (1, ())])
H_START, H_COLUMNS = ekf.pattern([(0, (0,)), (1, (0,)), (2, (1,))])


def init(p, x0, P0):
    """A filter state with x = x0 (2,) and P = diag(P0) (2,)."""
    return ekf.init(p.noise, STATES, x0, P0)


@njit
def reset(p, state, lean, rate):
    """Fresh covariance, lean and rate as measured."""
    ekf.reset(state, p.noise, STATES)
    state.x[0] = lean
    state.x[1] = rate


@njit
def step(p, state, u, y, valid):
    """One cycle; y is (3,), there is no input (u is not read), bit k of `valid` set where y[k] is fresh."""
    state.status = 0
    x = state.x
    x[0] += p.noise.dt_s * x[1]
    state.A[0, 1] = 1.0
    ekf.predict(state, p.noise, F_START, F_COLUMNS, STATES)
    H = state.H
    sine = math.sin(x[0])
    cosine = math.cos(x[0])
    state.h[0] = sine
    state.h[1] = cosine
    state.h[2] = x[1]
    H[0, 0] = cosine
    H[1, 0] = -sine
    H[2, 1] = 1.0
    ekf.update(state, p.noise, H_START, H_COLUMNS, STATES, MEASUREMENTS, y, valid)
    ekf.bound(state, p.noise, STATES)
