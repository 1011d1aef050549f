"""The pendulum EKF of Aoyagi and Choi: angle, rate and acceleration of a pendulum from an IMU at a known distance from the pivot.

States [angle, rate, acceleration], acceleration a random walk; measurements [gyro, transverse, radial specific force] with the lever arm r:
[rate, g sin(angle) - r acceleration, g cos(angle) - r rate^2]. Its difference from a complementary filter is that it knows the lever arm.

Printed, the acceleration's process noise is 1e-5 a step, far too small for a hand: 1 is wanted (section H of the equations).

Source: Aoyagi and Choi (2018), (1) to (5) and steps 1 to 9.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf

STATES = 3
MEASUREMENTS = 3
ALL_VALID = (1 << MEASUREMENTS) - 1

PARAMETERS = np.dtype([("noise", ekf.NOISE), ("lever_m", "f8"), ("gravity_m_s2", "f8")], align=True)

F_START, F_COLUMNS = ekf.pattern([(0, (1, 2)), (1, (2,)), (2, ())])
H_START, H_COLUMNS = ekf.pattern([(0, (1,)), (1, (0, 2)), (2, (0, 1))])


def init(p, x0, P0):
    """A filter state with x = x0 (3,) and P = diag(P0) (3,)."""
    return ekf.init(p.noise, STATES, x0, P0)


@njit
def reset(p, state, angle, rate):
    """Fresh covariance, angle and rate as measured."""
    ekf.reset(state, p.noise, STATES)
    state.x[0] = angle
    state.x[1] = rate


@njit
def step(p, state, u, y, valid):
    """One cycle; y is (3,), there is no input (u is not read), bit k of `valid` set where y[k] is fresh."""
    state.status = 0
    dt = p.noise.dt_s
    x = state.x
    A = state.A
    x[0] += dt * (x[1] + 0.5 * dt * x[2])
    x[1] += dt * x[2]
    A[0, 1] = 1.0
    A[0, 2] = 0.5 * dt
    A[1, 2] = 1.0
    ekf.predict(state, p.noise, F_START, F_COLUMNS, STATES)
    H = state.H
    sine = math.sin(x[0])
    cosine = math.cos(x[0])
    state.h[0] = x[1]
    state.h[1] = p.gravity_m_s2 * sine - p.lever_m * x[2]
    state.h[2] = p.gravity_m_s2 * cosine - p.lever_m * x[1] * x[1]
    H[0, 1] = 1.0
    H[1, 0] = p.gravity_m_s2 * cosine
    H[1, 2] = -p.lever_m
    H[2, 0] = -p.gravity_m_s2 * sine
    H[2, 1] = -2.0 * p.lever_m * x[1]
    ekf.update(state, p.noise, H_START, H_COLUMNS, STATES, MEASUREMENTS, y, valid)
    ekf.bound(state, p.noise, STATES)
