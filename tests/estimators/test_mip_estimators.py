"""The eduMIP's estimators: arithmetic against textbook filters, missing and non-finite sensors, hours."""

import math

import numpy as np
import pytest

from mip_rt.estimators import complementary, complementary_kf, ekf, mip_ekf, mip_inertial_ekf, mip_planar_kf
from mip_rt.models import mip, mip_yaw

pytestmark = pytest.mark.armhf
DT = 0.005
Q6, R4 = [1e-11, 1e-7, 1e-7, 1e-5, 1e-7, 1e-7], [1e-5, 2.62e-7, 5.44e-3, 1e-5]
Q4, R3 = [1e-11, 1e-7, 1e-5, 1e-7], [1e-5, 3.07e-6, 3.04e-3]
MODEL = mip.parameters(imu_position_m=(0.004, -0.016, 0.02))[0]
LEVER = np.array([0.004, -0.016, 0.02 + MODEL.com_height_m])


def record(dtype, q, r):
    p = np.zeros(1, dtype).view(np.recarray)[0]
    p.noise.Q[: len(q)], p.noise.R[: len(r)] = q, r
    p.noise.P_limit[:], p.noise.gate_squared, p.noise.dt_s = 10.0, 1e18, DT
    return p


def made(name, variant="exact"):
    """(module, parameters, state, size of u, size of y)."""
    c = mip_yaw.coefficients(MODEL, variant)[0]
    if name == "ekf":
        p = record(mip_ekf.PARAMETERS, Q6, R4)
        for field in mip_yaw.COEFFICIENTS.names:
            p.model[field] = c[field]
        return mip_ekf, p, mip_ekf.init(p, np.zeros(6), np.full(6, 1e-5)), 2, 4
    if name == "planar":
        p = record(mip_planar_kf.PARAMETERS, Q4, R3)
        mip_planar_kf.configure_model(p.model, c)
        return mip_planar_kf, p, mip_planar_kf.init(p, np.zeros(4), np.full(4, 1e-5)), 2, 3
    if name == "complementary_kf":
        p = record(complementary_kf.PARAMETERS, [1e-8, 1e-10], [1e-4])
        return complementary_kf, p, complementary_kf.init(p, np.zeros(2), np.full(2, 1e-5)), 1, 1
    if name == "inertial":
        p = np.zeros(1, mip_inertial_ekf.PARAMETERS).view(np.recarray)[0]
        mip_inertial_ekf.configure(p, DT, LEVER, MODEL.wheel_radius_m)
        return mip_inertial_ekf, p, mip_inertial_ekf.init(p, np.zeros(7), np.asarray(p.noise.P0)[:7]), 4, 2
    p = np.zeros(1, complementary.PARAMETERS).view(np.recarray)[0]
    complementary.configure(p, 4.0, DT)
    return complementary, p, complementary.init(p, [0.0]), 1, 1


def dense(x, P, F, h, H, Q, R, y):
    """Joseph form, joint update."""
    P = F @ P @ F.T + np.diag(Q)
    S = H @ P @ H.T + np.diag(R)
    K = np.linalg.solve(S, H @ P).T
    A = np.eye(len(x)) - K @ H
    return x + K @ (y - h), A @ P @ A.T + K @ np.diag(R) @ K.T


@pytest.mark.parametrize("variant", mip_yaw.VARIANTS)
def test_ekf_equals_a_textbook_dense_filter(variant):
    _, p, state, _, _ = made("ekf", variant)
    rng, x, P = np.random.default_rng(1), np.zeros(6), np.eye(6) * 1e-5
    for k in range(300):
        u = rng.normal(size=2) * 0.2
        y = np.array([math.sin(0.02 * k), 0.1 * rng.normal(), rng.normal(), 0.05 * k])
        F = np.eye(6) + DT * mip.high_yaw_derivative_jacobian(x, u, MODEL, variant)
        x = x + DT * mip.high_yaw_derivative(x, u, MODEL, variant)
        h, H = mip.high_yaw_output(x, u, MODEL, variant), mip.high_yaw_output_jacobian(x, u, MODEL, variant)
        x, P = dense(x, P, F, h, H, Q6, R4, y)
        mip_ekf.step(p, state, u, y, mip_ekf.ALL_VALID)
        assert np.asarray(state.x[:6]) == pytest.approx(x, rel=1e-8, abs=1e-9)
        assert np.asarray(state.P)[:6, :6] == pytest.approx(P, rel=1e-6, abs=1e-11)


def test_planar_filter_equals_a_textbook_dense_filter():
    _, p, state, _, _ = made("planar")
    A6, B6, C6, D6 = mip.linear_matrices(MODEL)
    keep = [0, 1, 3, 4]
    A, B, C, D = A6[np.ix_(keep, keep)], B6[keep, 0], C6[:3, keep], D6[:3, 0]
    rng, x, P = np.random.default_rng(1), np.zeros(4), np.eye(4) * 1e-5
    for k in range(300):
        u = rng.normal(size=2) * 0.2
        y = np.array([math.sin(0.02 * k), 0.1 * rng.normal(), rng.normal()])
        x = x + DT * (A @ x + B * u[0])
        x, P = dense(x, P, np.eye(4) + DT * A, C @ x + D * u[0], C, Q4, R3, y)
        mip_planar_kf.step(p, state, u, y, mip_planar_kf.ALL_VALID)
        assert np.asarray(state.x[:4]) == pytest.approx(x, rel=1e-8, abs=1e-9)


def test_complementary_kf_equals_a_textbook_filter_and_finds_the_bias():
    _, p, state, _, _ = made("complementary_kf")
    x, P, rng = np.zeros(2), np.eye(2) * 1e-5, np.random.default_rng(2)
    F = np.array([[1.0, -DT], [0.0, 1.0]])
    for k in range(40000):
        rate, seen = 0.02, 0.1 + 0.01 * rng.normal()
        if k < 200:
            x = F @ x + [DT * rate, 0.0]
            x, P = dense(x, P, F, x[:1], np.eye(2)[:1], [1e-8, 1e-10], [1e-4], np.array([seen]))
        complementary_kf.step(p, state, np.array([rate]), np.array([seen]), complementary_kf.ALL_VALID)
        if k < 200:
            assert np.asarray(state.x[:2]) == pytest.approx(x, rel=1e-8)
    assert state.x[1] == pytest.approx(0.02, abs=0.005) and state.x[0] == pytest.approx(0.1, abs=0.005)


def test_complementary_halves_add_up_to_one():
    """As printed the gyro's half weighs 2 % too much: a lean that both sensors agree on must come out exactly."""
    _, p, state, _, _ = made("complementary")
    tilt = 0.0
    for k in range(400):
        tilt = 0.2 * math.sin(3.0 * DT * (k + 1))
        rate = (tilt - 0.2 * math.sin(3.0 * DT * k)) / DT
        complementary.step(p, state, np.array([rate]), np.array([tilt]), complementary.ALL_VALID)
    assert state.x[0] == pytest.approx(tilt, abs=1e-12)
    assert complementary.accelerometer_tilt(-9.8 * math.sin(0.3), -9.8 * math.cos(0.3)) == pytest.approx(0.3)


def resting(nu):
    """Inputs of a robot that stands: none, or gyro and accelerometer."""
    return np.array([0.0, 0.0, 0.0, -9.8]) if nu == 4 else np.zeros(nu)


@pytest.mark.parametrize("name", ["ekf", "planar", "complementary", "complementary_kf", "inertial"])
class TestConformance:
    """The slot interface that every estimator keeps."""

    def test_nothing_non_finite_gets_in(self, name):
        module, p, state, nu, ny = made(name)
        u, y = resting(nu), np.zeros(ny)
        for bad in (math.nan, math.inf, -math.inf):
            for k in range(ny):
                z = y.copy()
                z[k] = bad
                module.step(p, state, u, z, module.ALL_VALID)
                assert state.status & ekf.NOT_FINITE and not state.status & ekf.UNHEALTHY
                assert np.isfinite(np.asarray(state.x)).all()
        module.step(p, state, u, y, module.ALL_VALID)
        assert state.status == 0

    def test_missing_sensors_change_nothing_but_the_prediction(self, name):
        module, p, state, nu, ny = made(name)
        module.step(p, state, resting(nu), np.full(ny, 1e3), 0)
        assert np.abs(np.asarray(state.x)).max() == 0.0 and state.status == 0

    @pytest.mark.slow
    def test_six_minutes_keep_the_covariance_sound(self, name):
        module, p, state, nu, ny = made(name)
        rng = np.random.default_rng(4)
        noise = rng.normal(size=(1000, ny)) * [0.003, 0.0005, 0.07, 0.003][:ny]
        for k in range(72000):
            module.step(p, state, resting(nu), noise[k % 1000], module.ALL_VALID)
            if k % 5000 == 0:
                P = np.asarray(state.P)
                assert np.isfinite(P).all() and np.allclose(P, P.T, rtol=1e-9, atol=1e-18) and np.linalg.eigvalsh(P).min() > -1e-15
        assert not state.status & ekf.UNHEALTHY and abs(state.x[0]) < 0.05
