"""The pendulum EKF and the 2-state EKF: arithmetic against textbook filters, missing and non-finite sensors."""

import math

import numpy as np
import pytest

from mip_rt.estimators import ekf, mip_2state_ekf, pendulum_ekf

DT, R, G = 0.01, 0.5, 9.816
NAMES = ("pendulum", "two_state")


def made(name):
    """(module, parameters, state)."""
    module, q, r = {
        "pendulum": (pendulum_ekf, [0.0, 1e-6, 1.0], [2e-6, 1e-3, 1e-3]),
        "two_state": (mip_2state_ekf, [1e-6, 1e-3], [1e-3, 1e-3, 1e-4]),
    }[name]
    p = np.zeros(1, module.PARAMETERS).view(np.recarray)[0]
    p.noise.Q[: len(q)], p.noise.R[: len(r)] = q, r
    p.noise.P_limit[:], p.noise.gate_squared, p.noise.dt_s = 100.0, 1e18, DT
    if name == "pendulum":
        p.lever_m, p.gravity_m_s2 = R, G
    return module, p, module.init(p, np.zeros(module.STATES), np.ones(module.STATES))


def textbook(name):
    """(F, h): the transition by the matrix exponential's terms, the outputs as the papers print them."""
    if name == "pendulum":
        F = np.array([[1, DT, DT**2 / 2], [0, 1, DT], [0, 0, 1]])
        return F, lambda x: np.array([x[1], G * math.sin(x[0]) - R * x[2], G * math.cos(x[0]) - R * x[1] ** 2])
    return np.array([[1, DT], [0, 1]]), lambda x: np.array([math.sin(x[0]), math.cos(x[0]), x[1]])


def jacobian(h, x):
    step = 1e-6
    return np.array([(h(x + step * e) - h(x - step * e)) / (2 * step) for e in np.eye(len(x))]).T


def measurements(name, count):
    t = DT * np.arange(count)
    a, v, w = 0.2 * np.sin(3 * t), 0.6 * np.cos(3 * t), -1.8 * np.sin(3 * t)
    clean = [v, G * np.sin(a) - R * w, G * np.cos(a) - R * v**2] if name == "pendulum" else [np.sin(a), np.cos(a), v]
    return a, np.stack(clean, axis=1) + np.random.default_rng(3).normal(size=(count, 3)) * 0.01


@pytest.mark.parametrize("name", NAMES)
def test_agrees_with_the_textbook_filter(name):
    """Joint Joseph update with differentiated outputs: an error in F, H, gain or covariance shows within 300 steps."""
    module, p, state = made(name)
    F, h = textbook(name)
    n = module.STATES
    x, P = np.zeros(n), np.eye(n)
    Q, noise = np.diag(np.asarray(p.noise.Q[:n])), np.diag(np.asarray(p.noise.R[:3]))
    for y in measurements(name, 300)[1]:
        module.step(p, state, np.zeros(1), y, module.ALL_VALID)
        x, P = F @ x, F @ P @ F.T + Q
        H = jacobian(h, x)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
        x = x + K @ (y - h(x))
        P = (np.eye(n) - K @ H) @ P @ (np.eye(n) - K @ H).T + K @ noise @ K.T
    assert np.asarray(state.x[:n]) == pytest.approx(x, abs=1e-7)
    assert np.asarray(state.P[:n, :n]) == pytest.approx(P, rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_follows_the_motion(name):
    module, p, state = made(name)
    angle, ys = measurements(name, 1000)
    error = []
    for a, y in zip(angle, ys):
        module.step(p, state, np.zeros(1), y, module.ALL_VALID)
        error.append(state.x[0] - a)
    assert np.sqrt(np.mean(np.square(error[200:]))) < 0.02


@pytest.mark.parametrize("name", NAMES)
def test_missing_and_broken_sensors_are_not_used(name):
    module, p, state = made(name)
    module.step(p, state, np.zeros(1), np.array([math.nan, 0.1, 0.1]), module.ALL_VALID)
    assert state.status & ekf.NOT_FINITE and not state.status & ekf.UNHEALTHY and np.isfinite(np.asarray(state.x)).all()
    before = np.asarray(state.x[: module.STATES]).copy()
    module.step(p, state, np.zeros(1), np.full(3, 5.0), 0)
    assert np.asarray(state.x[: module.STATES]) == pytest.approx(textbook(name)[0] @ before, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_thirty_minutes_at_rest_stay_healthy(name):
    module, p, state = made(name)
    still = np.array([0.0, 0.0, G]) if name == "pendulum" else np.array([0.0, 1.0, 0.0])
    for _ in range(180000):
        module.step(p, state, still[:1], still, module.ALL_VALID)
    assert state.status == 0 and abs(state.x[0]) < 1e-9 and 0 < state.P[0, 0] < 0.1
