"""The complementary filter: gyro above a corner frequency, accelerometer below.

    tilt = c (tilt + rate dt) + (1 - c) tilt_acc,   c = exp(-corner dt)

Source: dissertation (3.28), (3.29) with the high-pass half corrected (the two halves must add up to one); corner 4 rad/s there.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf

GYRO_VALID, ACCELEROMETER_VALID = 1, 2
ALL_VALID = GYRO_VALID | ACCELEROMETER_VALID

PARAMETERS = np.dtype([("pole", "f8"), ("dt_s", "f8")], align=True)


def configure(p, corner_rad_s: float, dt_s: float) -> None:
    """Derives the constants, once."""
    p.pole, p.dt_s = math.exp(-corner_rad_s * dt_s), dt_s


def init(p, x0, P0=None):
    """A state with tilt x0 (1,); the filter has no covariance."""
    state = np.zeros(1, ekf.STATE).view(np.recarray)[0]
    state.x[0] = x0[0]
    return state


@njit
def accelerometer_tilt(ay, az):
    """Lean that an accelerometer (papers' sign) at rest would show, (3.28)."""
    return math.atan2(-ay, -az)


@njit
def reset(p, state, tilt):
    """Starts at this tilt."""
    for i in range(ekf.ROW):
        state.x[i] = 0.0
    state.x[0] = tilt
    state.status = 0


@njit
def step(p, state, u, y, valid):
    """One tick.

    Args:
        p: record of PARAMETERS.
        state: record of ekf.STATE, of which x[0] is the tilt.
        u: (1,) body rate from the gyro.
        y: (1,) `accelerometer_tilt`.
        valid: GYRO_VALID, ACCELEROMETER_VALID where they are fresh.
    """
    state.status = 0
    tilt = state.x[0]
    if valid & GYRO_VALID:
        if abs(u[0]) < math.inf:
            tilt += p.dt_s * u[0]
        else:
            state.status |= ekf.NOT_FINITE
    if valid & ACCELEROMETER_VALID:
        if abs(y[0]) < math.inf:
            tilt = p.pole * tilt + (1.0 - p.pole) * y[0]
        else:
            state.status |= ekf.NOT_FINITE
    state.x[0] = tilt
    if not abs(tilt) < math.inf:
        state.status |= ekf.UNHEALTHY
