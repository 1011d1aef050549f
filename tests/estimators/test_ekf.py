"""The filter's arithmetic against a textbook dense filter; health over hours; gates, masks and non-finite measurements."""

import math

import numpy as np
import pytest

from mip_rt.compiled import njit
from mip_rt.estimators import ekf, mbbr_ekf, mbbr_kf
from mip_rt.models import mbbr, mbbr_linear, mbbr_yaw

pytestmark = pytest.mark.armhf
DT = 0.005
Q13 = [1e-5, 1e-5, 1e-4, 1e-4, 1e-4, 0.1, 0.1, 2.0, 0.1, 0.1, 1e-3, 1e-3, 1e-3]
R8 = [2.08e-6] * 3 + [7.62e-5] * 3 + [1.41] * 2


def set_noise(noise, q, r, gate=1e9, limit=1e9):
    noise.Q[: len(q)], noise.R[: len(r)] = q, r
    noise.P_limit[:], noise.gate_squared, noise.dt_s = limit, gate**2, DT


def ekf_parameters(variant="exact", **noise):
    p = np.zeros(1, mbbr_ekf.PARAMETERS).view(np.recarray)[0]
    set_noise(p.noise, Q13, R8, **noise)
    for name in mbbr_yaw.COEFFICIENTS.names:
        p.model[name] = mbbr_yaw.coefficients(mbbr.parameters()[0], variant)[0][name]
    return p


def kf_parameters(rotation, **noise):
    p = np.zeros(1, mbbr_kf.PARAMETERS).view(np.recarray)[0]
    set_noise(p.noise, [1e-5, 1e-5, 1e-4, 1e-4, 0.1, 0.1, 1e-3, 1e-3], [2.08e-6] * 2 + [7.62e-5] * 2 + [1.41] * 2, **noise)
    mbbr_kf.configure_model(p.model, *mbbr_linear.linear_matrices(mbbr.parameters()[0]), rotation)
    return p


def dense_step(x, P, F, h, H, Q, R, y):
    """Joseph form, joint update; F, h, H already evaluated."""
    P = F @ P @ F.T + Q
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    x = x + K @ (y - h)
    A = np.eye(len(x)) - K @ H
    P = A @ P @ A.T + K @ R @ K.T
    return x, 0.5 * (P + P.T)


def drive(rng, k):
    u = 0.3 * np.array([math.sin(0.03 * k), math.cos(0.05 * k), 0.5]) + 0.05 * rng.normal(size=3)
    y = np.concatenate([rng.normal(size=3) * 0.3, np.sin(0.01 * k + np.arange(3)), rng.normal(size=2)])
    y[2] = 6.0
    return u, y


@pytest.mark.parametrize("variant", mbbr_yaw.VARIANTS)
def test_equals_a_textbook_dense_filter(variant):
    p, model, rng = ekf_parameters(variant), mbbr.parameters()[0], np.random.default_rng(3)
    x, P = np.zeros(13), np.eye(13) * 1e-5
    state = mbbr_ekf.init(p, x, np.full(13, 1e-5))
    for k in range(400):
        u, y = drive(rng, k)
        mbbr_ekf.step(p, state, u, y, mbbr_ekf.ALL_VALID)
        F = np.eye(13) + DT * mbbr.high_yaw_derivative_jacobian(x, u, model, variant)
        x = x + DT * mbbr.high_yaw_derivative(x, u, model, variant)
        h, H = mbbr.high_yaw_output(x, u, model, variant), mbbr.high_yaw_output_jacobian(x, u, model, variant)
        x, P = dense_step(x, P, F, h, H, np.diag(Q13), np.diag(R8), y)
        assert state.x[:13] == pytest.approx(x, rel=1e-7, abs=1e-9)
        assert np.asarray(state.P)[:13, :13] == pytest.approx(P, rel=1e-6, abs=1e-11)


@pytest.mark.parametrize("rotation", [False, True])
def test_linear_filter_equals_a_textbook_dense_filter(rotation):
    p, rng = kf_parameters(rotation), np.random.default_rng(4)
    A, B, C, D = mbbr_linear.linear_matrices(mbbr.parameters()[0])
    x, P = np.zeros(8), np.eye(8) * 1e-5
    state = mbbr_kf.init(p, x, np.full(8, 1e-5))
    Q, R = np.diag(np.asarray(p.noise.Q)[:8]), np.diag(np.asarray(p.noise.R)[:6])
    for k in range(300):
        u, y = drive(rng, k)
        y6, z = y[[0, 1, 3, 4, 6, 7]], y[2]
        mbbr_kf.step(p, state, u, y6, mbbr_kf.ALL_VALID, z)
        turned = A.copy()
        if rotation:
            turned[6, 7], turned[7, 6] = z, -z
        F = np.eye(8) + DT * turned
        x = F @ x + DT * B @ u[:2]
        x, P = dense_step(x, P, F, C @ x + D @ u[:2], C, Q, R, y6)
        assert state.x[:8] == pytest.approx(x, rel=1e-8, abs=1e-10)
        assert np.asarray(state.P)[:8, :8] == pytest.approx(P, rel=1e-7, abs=1e-13)


def test_covariance_is_exactly_symmetric_and_positive_after_many_steps():
    p, rng = ekf_parameters(limit=10.0), np.random.default_rng(5)
    state = mbbr_ekf.init(p, np.zeros(13), np.full(13, 1e-5))
    for k in range(3000):
        u, y = drive(rng, k)
        mbbr_ekf.step(p, state, u, y, mbbr_ekf.ALL_VALID)
    P = np.asarray(state.P)[:13, :13]
    assert np.abs(P - P.T).max() <= 1e-14 * np.abs(P).max()
    assert np.linalg.eigvalsh(P).min() > 0.0
    assert not np.asarray(state.P)[13:].any() and not np.asarray(state.P)[:, 13:].any()


@njit
def _spin(p, state, u, y, noise, steps):
    """A robot that spins at 1.5 Hz for `steps` ticks; returns the largest variance and whether the filter was ever unhealthy."""
    largest, sick = 0.0, 0
    rate, yaw = 9.42477796076938, 0.0
    for k in range(steps):
        yaw += rate * 0.005
        for i in range(8):
            y[i] = noise[(8 * k + i) % len(noise)]
        y[2] += rate
        y[5] -= yaw
        u[2] = -0.06
        mbbr_ekf.step(p, state, u, y, mbbr_ekf.ALL_VALID)
        sick |= state.status & ekf.UNHEALTHY
        for i in range(13):
            largest = max(largest, state.P[i, i])
    return largest, sick


@pytest.mark.slow
def test_covariance_is_healthy_over_30_minutes_of_spinning():
    """360,000 ticks at 1.5 Hz: finite, positive, bounded for the unobservable states, and as sharp at the end as after a minute."""
    p, random = ekf_parameters(limit=10.0), np.random.default_rng(8)
    state = mbbr_ekf.init(p, np.zeros(13), np.full(13, 1e-5))
    noise = random.normal(size=8 * 4999) * np.tile(np.sqrt(np.asarray(p.noise.R)[:8]), 4999)
    u, y = np.zeros(3), np.zeros(8)
    observable = [0, 1, 5, 6, 7, 8, 9]
    _spin(p, state, u, y, noise, 12000)
    early = np.diag(np.asarray(state.P)).copy()
    largest, sick = _spin(p, state, u, y, noise, 348000)
    P = np.asarray(state.P)[:13, :13]
    assert not sick and largest <= 10.0 * (1 + 1e-12)
    assert np.linalg.eigvalsh(P).min() > 0.0 and np.abs(P - P.T).max() <= 1e-14 * np.abs(P).max()
    assert np.diag(P)[observable] == pytest.approx(early[observable], rel=1e-3)


def test_missing_measurements_are_left_out():
    p = ekf_parameters()
    one, other = (mbbr_ekf.init(p, np.zeros(13), np.full(13, 1e-3)) for _ in range(2))
    y = np.arange(8.0)
    mbbr_ekf.step(p, one, np.zeros(3), y, 0b00000100)
    y[[0, 1, 3, 4, 5, 6, 7]] = 1e6
    mbbr_ekf.step(p, other, np.zeros(3), y, 0b00000100)
    assert np.array_equal(one.x, other.x) and np.array_equal(one.P, other.P)
    assert one.innovation[2] == 2.0 and not one.innovation[3:].any()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("which", range(8))
def test_non_finite_measurement_is_masked_and_flagged(bad, which):
    p = ekf_parameters()
    state = mbbr_ekf.init(p, np.zeros(13), np.full(13, 1e-3))
    y = np.zeros(8)
    y[which] = bad
    mbbr_ekf.step(p, state, np.zeros(3), y, mbbr_ekf.ALL_VALID)
    assert np.isfinite(state.x).all() and np.isfinite(state.P).all()
    assert state.status & ekf.NOT_FINITE and not state.status & ekf.UNHEALTHY


def test_gate_refuses_counts_and_finally_believes():
    p = ekf_parameters(gate=5.0)
    state = mbbr_ekf.init(p, np.zeros(13), np.full(13, 1e-6))
    y = np.zeros(8)
    y[3] = 50.0
    for k in range(ekf.PATIENCE):
        mbbr_ekf.step(p, state, np.zeros(3), y, mbbr_ekf.ALL_VALID)
        assert state.status & ekf.REJECTED and state.rejected[3] == k + 1
    assert abs(state.x[3]) < 1.0
    mbbr_ekf.step(p, state, np.zeros(3), y, mbbr_ekf.ALL_VALID)
    assert state.status & ekf.REACCEPTED and state.x[3] - state.x[0] + state.x[10] > 10.0


def test_non_finite_state_is_reported():
    p = ekf_parameters()
    state = mbbr_ekf.init(p, np.zeros(13), np.full(13, 1e-6))
    state.x[4] = math.nan
    mbbr_ekf.step(p, state, np.zeros(3), np.zeros(8), mbbr_ekf.ALL_VALID)
    assert state.status & ekf.UNHEALTHY


def test_variance_of_unobservable_states_is_bounded():
    p = ekf_parameters(limit=0.05)
    state = mbbr_ekf.init(p, np.zeros(13), np.full(13, 1e-5))
    for k in range(2000):
        mbbr_ekf.step(p, state, np.zeros(3), np.zeros(8), mbbr_ekf.ALL_VALID)
    assert state.status & ekf.BOUNDED
    assert np.diag(np.asarray(state.P)).max() <= 0.05 * (1 + 1e-12)
    assert np.linalg.eigvalsh(np.asarray(state.P)[:13, :13]).min() > 0.0


def test_reset_forgets():
    p = ekf_parameters()
    state = mbbr_ekf.init(p, np.ones(13), np.full(13, 1e-3))
    mbbr_ekf.step(p, state, np.ones(3), np.ones(8), mbbr_ekf.ALL_VALID)
    mbbr_ekf.reset(p, state, 0.1, -0.2, 0.3, np.array([1.0, 2.0, 3.0]), np.zeros(3))
    assert list(state.x[:5]) == [0.1, -0.2, 0.3, 1.1, 1.8] and state.x[12] == 3.3
    h = np.zeros(8)
    mbbr_yaw.output_into(state.x, np.zeros(3), p.model, h)
    assert h[3:6] == pytest.approx([1.0, 2.0, 3.0])
