"""Ways to estimate the MBBR that do not ship, each a function of one recorded run: the papers' EKF with better noise and more states; no model.

A candidate takes (rows, config) of a run and returns (n, 8) estimates in the order of mbbr_frame.ESTIMATE_NAMES. Plain dense filters, written for
comparison (`lab.beyond`) and not for a tick.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.models import mbbr_yaw
from mip_rt.robots import mbbr_setup

DT_S = 0.005
STATES, MODEL_STATES = 18, 13  # the EKF's, then the torque disturbances (3) as commands, then the gyro's bias x, y
ENCODER_VARIANCE = 4e-6  # counts and rollers: (2 mrad)^2
KINEMATIC_RAD_S = 150.0  # of the filter behind the encoders: of 40, 80, 120 and 200 the middle ones were best


@njit
def scalar_updates(x, P, H, h, y, R):
    """Measurements y one after the other, H (m, n), h at the present x; Joseph's form is not needed: optimal gains, symmetrised."""
    n = len(x)
    start = x.copy()
    for k in range(len(y)):
        innovation = y[k] - h[k]
        variance = R[k]
        gain = np.zeros(n)
        for i in range(n):
            innovation -= H[k, i] * (x[i] - start[i])
            for j in range(n):
                gain[i] += P[i, j] * H[k, j]
        for i in range(n):
            variance += H[k, i] * gain[i]
        for i in range(n):
            x[i] += gain[i] * innovation / variance
            for j in range(n):
                P[i, j] -= gain[i] * gain[j] / variance


@njit
def _multiply(a, b):
    out = np.zeros((len(a), b.shape[1]))
    for i in range(len(a)):
        for k in range(a.shape[1]):
            if a[i, k] != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += a[i, k] * b[k, j]
    return out


@njit
def _augmented(model, y, u, Q, torque_variance, torque_walk, bias_walk, R, out):
    n, m = STATES, MODEL_STATES
    x, P = np.zeros(n), np.zeros((n, n))
    x[3], x[4], x[12] = y[0, 3], y[0, 4], y[0, 5]
    for i in range(n):
        P[i, i] = 1e-5
    f, ahead, behind, h, command = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(8), np.zeros(3)
    A, H, F, G = np.zeros((m, m)), np.zeros((8, m)), np.zeros((n, n)), np.zeros((m, 3))
    full = np.zeros((8, n))
    for k in range(len(y)):
        if k:
            for j in range(3):
                command[j] = u[k - 1, j] + x[m + j]
            mbbr_yaw.derivative_jacobian_into(x, command, model, A)
            for j in range(3):
                command[j] += 0.5
                mbbr_yaw.derivative_into(x, command, model, ahead)
                command[j] -= 1.0
                mbbr_yaw.derivative_into(x, command, model, behind)
                command[j] += 0.5
                for i in range(m):
                    G[i, j] = DT_S * (ahead[i] - behind[i])
            mbbr_yaw.derivative_into(x, command, model, f)
            for i in range(n):
                for j in range(n):
                    F[i, j] = 1.0 if i == j else 0.0
            for i in range(m):
                x[i] += DT_S * f[i]
                for j in range(m):
                    F[i, j] += DT_S * A[i, j]
                for j in range(3):
                    F[i, m + j] = G[i, j]
            P = _multiply(_multiply(F, P), F.T)
            for i in range(m):
                P[i, i] += Q[i]
                for j in range(m):
                    for c in range(3):
                        P[i, j] += torque_variance * G[i, c] * G[j, c]
            for j in range(3):
                P[m + j, m + j] += torque_walk
            for j in range(2):
                P[m + 3 + j, m + 3 + j] += bias_walk
        mbbr_yaw.output_into(x, command, model, h)
        mbbr_yaw.output_jacobian_into(x, command, model, H)
        for i in range(8):
            for j in range(m):
                full[i, j] = H[i, j]
        for j in range(2):
            h[j] += x[m + 3 + j]
            full[j, m + 3 + j] = 1.0
        scalar_updates(x, P, full, h, y[k], R)
        for i in range(n):
            P[i, i] = min(P[i, i], 10.0)
            for j in range(i):
                P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
        for i in range(3):
            out[k, i] = x[i]
        for i in range(5):
            out[k, 3 + i] = x[5 + i]


def measured(rows) -> np.ndarray:
    """(n, 8) measurements of the 13-state EKF."""
    return np.concatenate([rows["gyro_rad_s"], rows["body_angle_rad"], rows["acceleration_m_s2"][:, :2]], axis=1)


def _run_augmented(rows, config, torque_variance, torque_walk, bias_walk, rates):
    model = mbbr_yaw.coefficients(mbbr_setup.model_parameters(config)[0])[0]
    Q = np.array([1e-10] * 3 + [1e-8] * 2 + [rates] * 5 + [1e-8] * 3)
    R = np.array([2.08e-6] * 3 + [ENCODER_VARIANCE] * 3 + [1.41] * 2)
    out = np.zeros((len(rows), 8))
    _augmented(model, measured(rows), np.ascontiguousarray(rows["command_applied"]), Q, torque_variance, torque_walk, bias_walk, R, out)
    return out


def torque_noise(rows, config):
    """The 13-state EKF with process noise where it arises: in the torques (Q = G G' s^2, not diagonal), and the encoders' own noise."""
    return _run_augmented(rows, config, 0.04, 0.0, 0.0, 1e-4)


def torque_states(rows, config):
    """The same with three torques that nobody commanded and the gyro's bias as states."""
    return _run_augmented(rows, config, 0.1, 1e-5, 1e-8, 1e-4)


@njit
def _kinematic(turn, gains, out):
    place, rate, push, sum_ = 0.0, 0.0, 0.0, 0.0
    for k in range(len(turn)):
        sum_ += turn[k]
        place += DT_S * rate + 0.5 * DT_S * DT_S * push
        rate += DT_S * push
        error = sum_ - place
        place += gains[0] * error
        rate += gains[1] * error
        push += gains[2] * error
        out[k] = rate


def kinematic(rows, config):
    """No model at all: the ball's turn from encoders and gyro, differentiated in inertial axes by three poles; lean and yaw are the DMP's."""
    gyro, angle, (roll, pitch, yaw) = rows["gyro_rad_s"], rows["body_angle_rad"], rows["attitude_rad"].T
    turn = np.diff(angle[:, :2], axis=0, prepend=angle[:1, :2])
    turn[1:] += 0.5 * DT_S * (gyro[1:, :2] + gyro[:-1, :2])
    x = turn[:, 0] / np.cos(pitch)
    y = (turn[:, 1] - np.sin(roll) * np.sin(pitch) * x) / np.cos(roll)
    middle = yaw - 0.5 * DT_S * gyro[:, 2]
    pole = np.exp(-KINEMATIC_RAD_S * DT_S)
    gains = np.array([1.0 - pole**3, 1.5 * (1.0 - pole) ** 2 * (1.0 + pole) / DT_S, (1.0 - pole) ** 3 / DT_S**2])
    rates = np.zeros((2, len(rows)))
    _kinematic(np.cos(middle) * x - np.sin(middle) * y, gains, rates[0])
    _kinematic(np.sin(middle) * x + np.cos(middle) * y, gains, rates[1])
    out = np.zeros((len(rows), 8))
    out[:, :3], out[:, 3:6] = rows["attitude_rad"], gyro
    out[:, 6] = np.cos(yaw) * rates[0] + np.sin(yaw) * rates[1]
    out[:, 7] = -np.sin(yaw) * rates[0] + np.cos(yaw) * rates[1]
    return out
