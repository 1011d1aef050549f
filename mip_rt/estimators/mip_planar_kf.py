"""The planar Kalman filter of the eduMIP: the dynamics of driving straight, blind to yaw.

States [pitch, phi, pitch', phi']; measurements [phi, pitch' (gyro), accelerometer y (papers' sign)]. While the robot turns, the centrifugal part of
the accelerometer is taken for a lean: 0.1 rad at 10 rad/s with the IMU 16 mm off the centre of mass (published Table 3.3).

Source: dissertation (3.31) to (3.34), ACC 2018 (38) to (41).
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf

STATES = 4
MEASUREMENTS = 3
ALL_VALID = (1 << MEASUREMENTS) - 1

MODEL = np.dtype(
    [
        ("tilt", "f8", (3,)),  # pitch'' = [pitch, phi', u_x]
        ("wheel", "f8", (3,)),  # phi'' likewise
        ("accel", "f8", (3,)),  # accelerometer y likewise
    ],
    align=True,
)
PARAMETERS = np.dtype([("noise", ekf.NOISE), ("model", MODEL)], align=True)

F_START, F_COLUMNS = ekf.pattern([(0, (2,)), (1, (3,)), (2, (0, 3)), (3, (0, 3))])
H_START, H_COLUMNS = ekf.pattern([(0, (1,)), (1, (2,)), (2, (0, 3))])


def configure_model(model, coefficients) -> None:
    """Fills a MODEL record from a record of models.mip_yaw.COEFFICIENTS."""
    for name in ("tilt", "wheel", "accel"):
        model[name] = coefficients[name][[0, 1, 3]]


def init(p, x0, P0):
    """A filter state with x = x0 (4,) and P = diag(P0) (4,)."""
    return ekf.init(p.noise, STATES, x0, P0)


@njit
def reset(p, state, pitch, phi, pitch_rate):
    """Fresh covariance; attitude, encoders and body rate as measured, wheels at rest."""
    ekf.reset(state, p.noise, STATES)
    x = state.x
    x[0] = pitch
    x[1] = phi
    x[2] = pitch_rate
    x[3] = -pitch_rate


@njit
def step(p, state, u, y, valid):
    """One cycle, as `mip_ekf.step`; y is (3,), of u only u[0] counts."""
    state.status = 0
    m = p.model
    x = state.x
    A = state.A
    H = state.H
    tilt = m.tilt[0] * x[0] + m.tilt[1] * x[3] + m.tilt[2] * u[0]
    wheel = m.wheel[0] * x[0] + m.wheel[1] * x[3] + m.wheel[2] * u[0]
    dt = p.noise.dt_s
    x[0] += dt * x[2]
    x[1] += dt * x[3]
    x[2] += dt * tilt
    x[3] += dt * wheel
    A[0, 2] = 1.0
    A[1, 3] = 1.0
    A[2, 0] = m.tilt[0]
    A[2, 3] = m.tilt[1]
    A[3, 0] = m.wheel[0]
    A[3, 3] = m.wheel[1]
    ekf.predict(state, p.noise, F_START, F_COLUMNS, STATES)
    state.h[0] = x[1]
    state.h[1] = x[2]
    state.h[2] = m.accel[0] * x[0] + m.accel[1] * x[3] + m.accel[2] * u[0]
    H[0, 1] = 1.0
    H[1, 2] = 1.0
    H[2, 0] = m.accel[0]
    H[2, 3] = m.accel[1]
    ekf.update(state, p.noise, H_START, H_COLUMNS, STATES, MEASUREMENTS, y, valid)
    ekf.bound(state, p.noise, STATES)
