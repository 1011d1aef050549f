"""The onboard attitude: arithmetic against a textbook filter, motions whose truth is known, missing and non-finite sensors, hours."""

import math
import tracemalloc

import numpy as np
import pytest

from mip_rt.estimators import attitude, ekf

pytestmark = pytest.mark.armhf
DT = 0.005
G = 9.81
LEVEL = np.array([0.0, 0.0, G, 0.0, 0.0])


def made(dt_s=DT, **settings):
    p = np.zeros(1, attitude.PARAMETERS).view(np.recarray)[0]
    attitude.configure(p, dt_s, **settings)
    return p, attitude.init(p)


def product(a, b):
    w, x, y, z = a
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]) @ b


def rotation(vector):
    angle = np.linalg.norm(vector)
    return np.array([math.cos(angle / 2), *(np.asarray(vector) * (math.sin(angle / 2) / angle if angle else 0.5))])


def matrix(q):
    w, x, y, z = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])  # fmt: skip


def tilt_error(truth, q):
    """Angle between the vertical axes."""
    return math.acos(min(1.0, float(matrix(truth)[2] @ matrix(q)[2])))


def test_equals_a_textbook_dense_filter():
    """A wrong entry of the Jacobian or a wrong sign of a correction would only make the filter a little worse, and stay unseen."""
    p, state = made(gyro_delay_s=0.002)
    rng = np.random.default_rng(1)
    P = np.diag(np.asarray(p.noise.P0)[:10])
    x, q, last = np.zeros(10), None, None
    for k in range(300):
        u = rng.normal(size=3) * 2.0
        y = np.concatenate([rng.normal(size=3) + [0.5, 0.0, G], rng.normal(size=2) * 0.3])
        if q is None:
            up = y[:3] / np.linalg.norm(y[:3])
            axis = np.cross(up, [0, 0, 1])
            q, last = rotation(axis / np.linalg.norm(axis) * math.acos(up[2])), u
        trusted = (1 - x[7:]) * u - x[2:5]
        q = product(q, rotation(DT * trusted + 0.002 * (u - last)))
        last = u
        R = matrix(q)
        force = R @ y[:3]
        F = np.eye(10)
        F[:2, 2:5], F[:2, 7:] = -DT * R[:2], -DT * R[:2] * u
        F[5, 1], F[6, 0] = DT * force[2], -DT * force[2]
        Q = np.array([0.0] * 2 + [2.2e-4**2 * DT] * 3 + [0.02**2 * DT] * 2 + [0.0] * 3)
        Q[:2] = (2e-4**2 + 2.2e-3**2 * trusted @ trusted) * DT
        x[5:7] += DT * force[:2]
        P = F @ P @ F.T + np.diag(Q)
        H = np.zeros((2, 10))
        H[0, 5] = H[1, 6] = 1.0
        noise = np.eye(2) * 0.35**2 / DT
        K = np.linalg.solve(H @ P @ H.T + noise, H @ P).T
        x = x + K @ (y[3:] - x[5:7])
        A = np.eye(10) - K @ H
        P = A @ P @ A.T + K @ noise @ K.T
        error, x[:2] = x[:2].copy(), 0.0
        q = q + product(np.array([0.0, *error / 2, 0.0]), q)
        q /= np.linalg.norm(q)
        attitude.step(p, state, u, y, attitude.ALL_VALID)
        assert np.asarray(state.filter.x)[:10] == pytest.approx(x, rel=1e-8, abs=1e-9)
        assert np.asarray(state.filter.P)[:10, :10] == pytest.approx(P, rel=1e-6, abs=1e-12)
        assert np.asarray(state.quaternion) / np.linalg.norm(state.quaternion) == pytest.approx(q, abs=1e-9)


@pytest.mark.parametrize("force", [(0, 0, G), (0, 0, -G), (G, 0, 0), (0, -G, 0), (3, -4, -8), (1e-3, 0, -G)])
def test_starts_level_in_any_position(force):
    """A robot that lies or hangs upside down: the shortest turn to the vertical is not unique there."""
    p, state = made()
    for _ in range(400):
        attitude.step(p, state, np.zeros(3), np.array([*force, 0.0, 0.0]), attitude.ALL_VALID)
    assert matrix(state.quaternion) @ np.array(force) / np.linalg.norm(force) == pytest.approx([0, 0, 1], abs=1e-3)


def test_waits_for_a_sample_that_says_something():
    p, state = made()
    for force in (np.zeros(5), np.full(5, math.nan)):
        attitude.step(p, state, np.zeros(3), force, attitude.ALL_VALID)
    attitude.step(p, state, np.zeros(3), LEVEL, attitude.GYRO_VALID)
    assert state.started == 0 and not np.asarray(state.quaternion).any()
    attitude.step(p, state, np.zeros(3), LEVEL, attitude.ALL_VALID)
    assert state.started == 1


def swung(rate_hz, seconds=30.0, bias=(0.01, -0.006, 0.004), seed=3, **settings):
    """Largest tilt error after 10 s of a sensor that rolls, pitches and turns and is shaken to and fro, with bias and noise."""
    dt = 1.0 / rate_hz
    p, state = made(dt, **settings)
    rng, truth, worst = np.random.default_rng(seed), np.array([1.0, 0, 0, 0]), 0.0
    for k in range(round(seconds * rate_hz)):
        t = k * dt
        rate = np.array([0.8 * math.sin(2.1 * t), 0.6 * math.cos(1.3 * t), 0.5])
        truth = product(truth, rotation(rate * dt))
        acceleration = np.array([1.5 * math.sin(5 * t), 1.0 * math.cos(7 * t), 0.0])
        force = matrix(truth).T @ (acceleration + [0, 0, G]) + 0.02 / math.sqrt(dt) * rng.normal(size=3)
        u = rate + bias + 2e-4 / math.sqrt(dt) * rng.normal(size=3)
        attitude.step(p, state, u, np.array([*force, 0.0, 0.0]), attitude.ALL_VALID)
        if t > 10.0:
            worst = max(worst, tilt_error(truth, state.quaternion))
    return worst


@pytest.mark.parametrize("rate_hz", [100.0, 200.0, 285.71])
def test_follows_a_known_motion_at_any_rate(rate_hz):
    """Parameters that secretly are per tick would fit one rate alone."""
    assert swung(rate_hz) < math.radians(1.2)


def test_known_velocity_tells_leaning_from_accelerating():
    """With the velocity taken for zero, 1 m/s^2 for a second looks like a lean."""
    errors = {}
    for known, noise in ((False, attitude.UNKNOWN_VELOCITY), (True, 0.05)):
        p, state = made(velocity_noise=noise)
        worst = 0.0
        for k in range(1200):
            acceleration = 1.0 if 600 <= k < 800 else 0.0
            velocity = max(0.0, min(k + 1 - 600, 200)) * DT if known else 0.0
            attitude.step(p, state, np.zeros(3), np.array([acceleration, 0.0, G, velocity, 0.0]), attitude.ALL_VALID)
            worst = max(worst, tilt_error([1, 0, 0, 0], state.quaternion))
        errors[known] = worst
    assert errors[True] < 1e-6 < 1e-3 < errors[False] < 0.05


def test_gyro_delay_is_made_good():
    errors = []
    for delay in (0.0, 0.0023):
        p, state = made(gyro_delay_s=delay)
        for k in range(400):
            t = k * DT
            attitude.step(p, state, np.array([math.sin(5 * (t - 0.0023)) * 3, 0, 0]), np.array([0, 0, 0, 0, 0.0]) if k else LEVEL,
                          attitude.ALL_VALID if k == 0 else attitude.GYRO_VALID)  # fmt: skip
            lean = 2 * math.atan2(state.quaternion[1], state.quaternion[0])
            errors.append((delay, lean - 0.6 * (1 - math.cos(5 * (t + 0.5 * DT)))))
    spread = [np.ptp([error for d, error in errors if d == delay]) for delay in (0.0, 0.0023)]
    assert spread[1] < 0.25 * spread[0]


def test_calibrated_bias_replaces_what_was_learned():
    p, state = made()
    for _ in range(4000):
        attitude.step(p, state, np.array([0.01, 0.0, 0.0]), LEVEL, attitude.ALL_VALID)
    assert state.filter.x[2] == pytest.approx(0.01, abs=5e-4)
    attitude.forget_bias(state)
    for _ in range(400):
        attitude.step(p, state, np.zeros(3), LEVEL, attitude.ALL_VALID)
        assert tilt_error([1, 0, 0, 0], state.quaternion) < 1e-3
    assert abs(state.filter.x[2]) < 1e-3


class TestConformance:
    """The slot interface that every estimator keeps."""

    def test_nothing_non_finite_gets_in(self):
        p, state = made()
        attitude.step(p, state, np.zeros(3), LEVEL, attitude.ALL_VALID)
        for bad in (math.nan, math.inf, -math.inf):
            for k in range(8):
                u, y = np.zeros(3), LEVEL.copy()
                (u if k < 3 else y)[k % 3 if k < 6 else k - 3] = bad
                attitude.step(p, state, u, y, attitude.ALL_VALID)
                assert state.filter.status & ekf.NOT_FINITE and not state.filter.status & ekf.UNHEALTHY
                assert np.isfinite(np.asarray(state.filter.x)).all() and np.isfinite(np.asarray(state.quaternion)).all()
        attitude.step(p, state, np.zeros(3), LEVEL, attitude.ALL_VALID)
        assert state.filter.status == 0

    def test_missing_samples_are_carried_on_by_the_last_rates(self):
        p, state = made()
        attitude.step(p, state, np.array([0.0, 0.0, 2.0]), LEVEL, attitude.ALL_VALID)
        for _ in range(10):
            attitude.step(p, state, np.full(3, math.nan), np.full(5, 1e6), 0)
        assert 2.0 * math.atan2(state.quaternion[3], state.quaternion[0]) == pytest.approx(11 * 2.0 * DT, abs=1e-6)
        assert np.abs(np.asarray(state.filter.x)).max() == 0.0 and state.filter.status == 0

    @pytest.mark.slow
    def test_half_an_hour_keeps_the_covariance_sound(self):
        p, state = made()
        rng = np.random.default_rng(4)
        gyro, force = rng.normal(size=(1000, 3)) * 0.0015 + [0, 0, 9.4], rng.normal(size=(1000, 3)) * 0.27 + [0, 0, G]
        found = np.empty((1000, 4))
        for _ in range(360):
            attitude.run(p, state, gyro, force, found)
            P = np.asarray(state.filter.P)
            assert np.isfinite(P).all() and np.allclose(P, P.T, rtol=1e-9, atol=1e-18) and np.linalg.eigvalsh(P).min() > -1e-12
        assert not state.filter.status & ekf.UNHEALTHY and tilt_error([1, 0, 0, 0], state.quaternion) < 0.02
        assert np.abs(np.asarray(state.filter.x)[2:5]).max() < attitude.LARGEST_BIAS

    def test_allocates_nothing(self):
        p, state = made()
        u = np.zeros(3)
        attitude.step(p, state, u, LEVEL, attitude.ALL_VALID)
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(2000):
            attitude.step(p, state, u, LEVEL, attitude.ALL_VALID)
        after = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        assert after - before < 2000
