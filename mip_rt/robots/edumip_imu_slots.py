"""The eduMIP's estimators that need no model of its motors: how a row becomes their inputs, and their state an estimate.

The inertial EKF reads gyro, accelerometer and wheels; the pendulum EKF takes the axle for the pivot; the 2-state EKF knows gravity alone.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import mip_2state_ekf, mip_inertial_ekf, pendulum_ekf

KIND_INERTIAL, KIND_PENDULUM, KIND_2STATE = 5, 6, 7
FIRST = KIND_INERTIAL

PARAMETERS = np.dtype(
    [("inertial", mip_inertial_ekf.PARAMETERS), ("pendulum", pendulum_ekf.PARAMETERS), ("two_state", mip_2state_ekf.PARAMETERS)], align=True
)
STATE = np.dtype([("u", "f8", (4,)), ("y", "f8", (3,))], align=True)  # inputs and measurements of the slot at work


@njit
def reset(kind, p, s, row):
    """Starts at the row's attitude, rate and wheels."""
    if kind == KIND_INERTIAL:
        mip_inertial_ekf.reset(p.inertial, s, row.attitude_rad[0], row.phi_rad, row.gyro_rad_s[0], row.gyro_rad_s[2])
    elif kind == KIND_PENDULUM:
        pendulum_ekf.reset(p.pendulum, s, row.attitude_rad[0], row.gyro_rad_s[0])
    else:
        mip_2state_ekf.reset(p.two_state, s, row.attitude_rad[0], row.gyro_rad_s[0])


@njit
def step(kind, p, s, inputs, row, encoders, gyro, accelerometer):
    """One cycle with the sensors that are True; `inputs` is a record of STATE."""
    u = inputs.u
    y = inputs.y
    if kind == KIND_INERTIAL:
        u[0] = row.gyro_rad_s[0]
        u[1] = row.gyro_rad_s[2]
        u[2] = row.acceleration_m_s2[1]
        u[3] = row.acceleration_m_s2[2]
        y[0] = row.phi_rad
        y[1] = row.gyro_rad_s[1]
        valid = (mip_inertial_ekf.PHI_VALID if encoders else 0) | (mip_inertial_ekf.GYRO_VALID if gyro else 0)
        mip_inertial_ekf.step(p.inertial, s, u, y, valid | (mip_inertial_ekf.ACCELEROMETER_VALID if accelerometer else 0))
    elif kind == KIND_PENDULUM:
        y[0] = row.gyro_rad_s[0]
        y[1] = -row.acceleration_m_s2[1]
        y[2] = -row.acceleration_m_s2[2]
        pendulum_ekf.step(p.pendulum, s, u, y, (1 if gyro else 0) | (6 if accelerometer else 0))
    else:
        g = p.pendulum.gravity_m_s2
        y[0] = -row.acceleration_m_s2[1] / g
        y[1] = -row.acceleration_m_s2[2] / g
        y[2] = row.gyro_rad_s[0]
        mip_2state_ekf.step(p.two_state, s, u, y, (3 if accelerometer else 0) | (4 if gyro else 0))


@njit
def estimate(kind, s, row, out):
    """Writes into `out` (6,) what the filter knows better than the sensors, which stand there already."""
    x = s.x
    out[0] = x[0]
    if kind != KIND_INERTIAL:
        out[3] = x[1]
    else:
        out[1] = x[1] - x[0]
        out[3] = x[mip_inertial_ekf.RATE]
        out[4] = x[mip_inertial_ekf.ROLL] - out[3]
        out[5] = row.gyro_rad_s[2] / math.cos(x[0])
