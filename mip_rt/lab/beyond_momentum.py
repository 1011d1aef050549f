"""Variants of the momentum observer, for comparison (`lab.beyond`): without its learned scales, with further sensors, unscented.

Each takes (rows, config) of a recorded run and returns (n, 8) estimates, as in `lab.beyond_ekf`.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import momentum_observer
from mip_rt.lab.beyond_ekf import DT_S, measured, scalar_updates
from mip_rt.models import mbbr_momentum
from mip_rt.robots import mbbr_setup


@njit
def _momentum(p, state, y, lean, force, lean_variance, force_variance, radius_m, height_m, gravity_m_s2, out):
    x, P = state.filter.x[: momentum_observer.STATES], state.filter.P
    n = momentum_observer.STATES
    H, h, R = np.zeros((2, n)), np.zeros(2), np.zeros(2)
    for k in range(len(y)):
        if k:
            before = state.rate_rad_s.copy()
            momentum_observer.step(p, state, y[k], momentum_observer.ALL_VALID)
            if lean_variance > 0.0:
                H[:] = 0.0
                for i in range(2):
                    H[i, i], h[i], R[i] = 1.0, x[i], lean_variance
                scalar_updates(x, P[:n, :n], H, h, lean[k], R)
            if force_variance > 0.0:
                # y = g lean - height times angular acceleration - radius times the ball's, which is l' less the body's share of l'.
                turn = (state.rate_rad_s - before) / DT_S
                fall = x[9] * p.model.gravity_s2
                spin = state.rate_rad_s[2]
                roll_push = fall * x[0] + spin * x[3] - x[8] * p.model.body * turn[0]
                pitch_push = fall * x[1] - spin * x[2] - x[8] * p.model.body * turn[1]
                H[:] = 0.0
                H[0, 1], H[1, 0] = gravity_m_s2 - radius_m * fall, -gravity_m_s2 + radius_m * fall
                h[0] = gravity_m_s2 * x[1] - height_m * turn[1] - radius_m * pitch_push
                h[1] = -gravity_m_s2 * x[0] + height_m * turn[0] + radius_m * roll_push
                R[:] = force_variance
                scalar_updates(x, P[:n, :n], H, h, force[k], R)
        momentum_observer.show(p, state, out[k])


def _begun(rows, config):
    """(parameters, state after a reset to the run's first row, measurements, room for estimates)."""
    p = np.zeros(1, momentum_observer.PARAMETERS).view(np.recarray)[0]
    gyro, encoder, _ = config.estimator.measurement_noise
    momentum_observer.configure(p, mbbr_setup.model_parameters(config)[0], DT_S, gyro, encoder, config.estimator.gate_sigma)
    state, y, lean = momentum_observer.init(p), measured(rows), rows["attitude_rad"][0]
    momentum_observer.reset(p, state, lean[0], lean[1], y[0, 3:6].copy(), y[0, :3].copy())
    return p, state, y, np.zeros((len(rows), 8))


def _run_momentum(rows, config, learn=True, lean_variance=0.0, force_variance=0.0):
    p, state, y, out = _begun(rows, config)
    if not learn:
        for i in (8, 9):
            state.filter.P[i, i], p.noise.Q[i] = 1e-12, 0.0
    model = mbbr_setup.model_parameters(config)[0]
    lean, force = np.ascontiguousarray(rows["attitude_rad"][:, :2]), np.ascontiguousarray(y[:, 6:8])
    _momentum(p, state, y, lean, force, lean_variance, force_variance, model.ball_radius_m, model.imu_position_m[2], model.gravity_m_s2, out)
    return out


def unlearned(rows, config):
    """The momentum observer that believes its model's inertia and weight."""
    return _run_momentum(rows, config, learn=False)


def with_dmp(rows, config):
    """The momentum observer that is also shown the DMP's lean, as noisy as a wander of 3 mrad over a second makes 200 equal samples."""
    return _run_momentum(rows, config, lean_variance=3.6e-3)


def with_accelerometer(rows, config):
    """The momentum observer that is also shown the accelerometer, with the variance of (6.23)."""
    return _run_momentum(rows, config, force_variance=1.41)


@njit
def _slope(p, x, a, b, c, out):
    found = mbbr_momentum.derivative(p, x[8], x[9], x[0], x[1], a - x[6], b - x[7], c, x[2], x[3])
    out[0], out[1] = found[0], found[1]
    for i in range(4):
        out[2 + i] = found[3 + i]


@njit
def _root(P):
    n = len(P)
    L = np.zeros((n, n))
    for j in range(n):
        total = P[j, j]
        for k in range(j):
            total -= L[j, k] * L[j, k]
        L[j, j] = np.sqrt(total)
        for i in range(j + 1, n):
            total = P[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total / L[j, j]
    return L


@njit
def _unscented(p, state, y, out):
    n, spread = momentum_observer.STATES, np.sqrt(3.0)
    x, P = state.filter.x[:n], state.filter.P[:n, :n]
    points, slope, half = np.zeros((2 * n + 1, n)), np.zeros(n), np.zeros(n)
    H, h, R = np.zeros((2, n)), np.zeros(2), p.noise.R[:2].copy()
    H[0, 4] = H[1, 5] = 1.0
    momentum_observer.show(p, state, out[0])
    for k in range(1, len(y)):
        a, b, c = 0.5 * (y[k, 0] + y[k - 1, 0]), 0.5 * (y[k, 1] + y[k - 1, 1]), 0.5 * (y[k, 2] + y[k - 1, 2])
        change = p.spin_gain * (y[k, 2] - state.spin_rad_s)
        state.spin_rad_s += change
        root = _root(P)
        for m in range(2 * n + 1):
            side = 1.0 if m % 2 else -1.0
            for i in range(n):
                points[m, i] = x[i] + (side * spread * root[i, (m - 1) // 2] if m else 0.0)
            _slope(p.model, points[m], a, b, c, slope)
            for i in range(n):
                half[i] = points[m, i] + 0.5 * DT_S * slope[i]
            _slope(p.model, half, a, b, c, slope)
            for i in range(n):
                points[m, i] += DT_S * slope[i]
        for i in range(n):
            x[i] = points[0, i] * (1.0 - n / 3.0)
            for m in range(1, 2 * n + 1):
                x[i] += points[m, i] / 6.0
        for i in range(n):
            for j in range(n):
                P[i, j] = (1.0 - n / 3.0) * (points[0, i] - x[i]) * (points[0, j] - x[j])
                for m in range(1, 2 * n + 1):
                    P[i, j] += (points[m, i] - x[i]) * (points[m, j] - x[j]) / 6.0
            P[i, i] += p.noise.Q[i]
        for i in range(2):
            P[6 + i, 6 + i] += p.mounting_squared * change * change
            h[i] = x[4 + i]
        scalar_updates(x, P, H, h, y[k, 3:5], R)
        for i in range(3):
            state.gyro_rad_s[i] = state.rate_rad_s[i] = y[k, i]
        momentum_observer.show(p, state, out[k])


def unscented(rows, config):
    """The momentum observer's model in an unscented filter (21 sigma points)."""
    p, state, y, out = _begun(rows, config)
    _unscented(p, state, y, out)
    return out
