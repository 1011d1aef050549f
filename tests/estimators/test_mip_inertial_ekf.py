"""The inertial EKF of the eduMIP: arithmetic against a textbook filter, and what it finds out on motions whose sensors are known exactly."""

import math

import numpy as np
import pytest

from mip_rt.estimators import ekf
from mip_rt.estimators import mip_inertial_ekf as inertial
from mip_rt.models import mip

pytestmark = pytest.mark.armhf
DT, R = 0.005, 0.035
PLACE = np.array([0.004, -0.016, 0.02])
MODEL = mip.parameters(imu_position_m=tuple(PLACE))[0]
LEVER = PLACE + np.array([0.0, 0.0, MODEL.com_height_m])


def made(lever=LEVER, **changes):
    """(parameters, state at rest)."""
    p = np.zeros(1, inertial.PARAMETERS).view(np.recarray)[0]
    inertial.configure(p, DT, lever, R, **changes)
    state = inertial.init(p, np.zeros(7), np.asarray(p.noise.P0)[:7])
    inertial.reset(p, state, 0.0, 0.0, 0.0, 0.0)
    return p, state


def motion(count, yaw_rate=10.0, lever=PLACE):
    """(states (n, 6), gyro (n, 3), accelerometer (n, 3)) of a robot that leans and rolls to and fro while its turning grows to yaw_rate in 2 s."""
    t = DT * np.arange(count)
    ramp = np.clip(t / 2.0, 0.0, 1.0)
    lean, lean1, lean2 = 0.08 * np.sin(4 * t), 0.32 * np.cos(4 * t), -1.28 * np.sin(4 * t)
    phi, phi1, phi2 = 2.0 * np.sin(3 * t), 6.0 * np.cos(3 * t), -18.0 * np.sin(3 * t)
    turn, turn1 = yaw_rate * ramp, np.where((ramp > 0) & (ramp < 1), yaw_rate / 2.0, 0.0)
    x = np.stack([lean, phi, DT * np.cumsum(turn), lean1, phi1, turn], axis=1)
    p = mip.parameters(imu_position_m=tuple(lever))[0]
    force = np.array([mip.accelerometer(row, [a, b, c], p) for row, a, b, c in zip(x, lean2, phi2, turn1)])
    return x, np.array([mip.gyro(row) for row in x]), force


def follow(p, state, x, gyro, force, valid=inertial.ALL_VALID):
    """(n, 10) state vectors of a run through these samples, started in motion; `valid` may differ by tick."""
    u = np.stack([gyro[:, 0], gyro[:, 2], force[:, 1], force[:, 2]], axis=1)
    inertial.reset(p, state, x[0, 0], x[0, 1], x[0, 3], x[0, 5])
    state.x[2] += R * (x[0, 3] + x[0, 4])
    state.x[inertial.PUSH] = rates(np.array(state.x[:7]), u[0])[2]
    seen = np.zeros((len(x), 10))
    seen[0] = state.x[:10]
    for k in range(1, len(x)):
        y = np.array([x[k, 1], gyro[k, 1]])
        inertial.step(p, state, u[k], y, valid if np.isscalar(valid) else int(valid[k]))
        seen[k] = state.x[:10]
    return seen


def rates(x, u):
    """x' as the equations of the module say, of all 7 states; the sample's own inputs."""
    lean, _, speed, bx, _, share, place = x
    rate, turn = u[0] - bx - share * u[1], u[1] / math.cos(lean)
    ahead, up = np.array([[math.cos(lean), -math.sin(lean)], [math.sin(lean), math.cos(lean)]]) @ [LEVER[1] + place, LEVER[2]]
    push = u[2] * math.cos(lean) - u[3] * math.sin(lean) - turn**2 * ahead
    return np.array([rate, (speed + turn * LEVER[0] - rate * up) / R, push, 0.0, 0.0, 0.0, 0.0])


def differentiated(f, x):
    return np.array([(f(x + 1e-6 * e) - f(x - 1e-6 * e)) / 2e-6 for e in np.eye(len(x))]).T


def test_covariance_and_gain_are_those_of_a_textbook_filter():
    """Joseph form with differentiated equations, each step from the filter's own state: an error in one Jacobian entry shows."""
    p, state = made()
    p.noise.gate_squared = np.inf
    state.x[inertial.TURN] = 8.0
    rng = np.random.default_rng(1)
    P = np.diag(np.asarray(p.noise.P0)[:7])
    for k in range(200):
        u = np.array([0.3 * math.sin(0.05 * k), 8.0, 2.0 * math.sin(0.05 * k), -9.8]) + rng.normal(size=4) * 0.05
        y = np.array([0.1 * math.sin(0.05 * k), 0.5]) + rng.normal(size=2) * 0.01
        before = np.array(state.x)
        inertial.step(p, state, u, y, inertial.ALL_VALID)
        # The prediction, redone: lean first, the rest at the new lean with the mean of two samples.
        x = before[:7].copy()
        rate = rates(x, u)[0]
        x[0] += DT * 0.5 * (before[inertial.RATE] + rate)
        push = rates(x, u)[2]
        x[2] += DT * 0.5 * (before[inertial.PUSH] + push)
        mean = np.array([0.5 * (before[inertial.RATE] + rate) + x[3] + x[5] * u[1], u[1], u[2], u[3]])
        halfway = x.copy()
        halfway[2] = 0.5 * (before[2] + x[2])
        x[1] += DT * rates(halfway, mean)[1]
        F = np.eye(7) + DT * differentiated(lambda at: rates(at, mean), halfway)
        P = F @ P @ F.T + np.diag(np.asarray(p.noise.Q)[:7])
        P[0, 0] += p.rate_noise * u[1] ** 2

        def shown(at, turn=u[1]):
            return np.array([at[1] - at[0], at[4] + turn * math.tan(at[0])])

        H, noise = differentiated(shown, x), np.diag(np.asarray(p.noise.R)[:2])
        K = np.linalg.solve(H @ P @ H.T + noise, H @ P).T
        x = x + K @ (y - shown(x))
        P = (np.eye(7) - K @ H) @ P @ (np.eye(7) - K @ H).T + K @ noise @ K.T
        assert np.asarray(state.x[:7]) == pytest.approx(x, rel=1e-6, abs=1e-9)
        assert np.asarray(state.P)[:7, :7] == pytest.approx(P, rel=1e-4, abs=1e-10)


def test_exact_sensors_give_the_exact_lean():
    """Equations of the rigid body against the filter's: what remains is the integration over 5 ms."""
    x, gyro, force = motion(2000)
    seen = follow(*made(), x, gyro, force)
    assert np.abs(seen[:, 0] - x[:, 0]).max() < 2e-4
    assert np.abs(seen[:, inertial.RATE] - x[:, 3]).max() < 2e-3
    assert np.abs(seen[400:, inertial.ROLL] - x[400:, 3] - x[400:, 4]).max() < 0.15


def test_finds_biases_crooked_axes_and_its_own_place():
    """The lean stays right meanwhile: 4 mm at 10 rad/s would be 41 mrad, a share of 0.02 would turn it by 0.2 rad each second."""
    x, gyro, force = motion(5000, lever=PLACE + np.array([0.0, 0.004, 0.0]))
    gyro = gyro + np.array([0.004, -0.003, 0.0])
    gyro[:, 0] += 0.02 * gyro[:, 2]
    rng = np.random.default_rng(2)
    gyro, force = gyro + rng.normal(size=gyro.shape) * 1.75e-3, force + rng.normal(size=force.shape) * 0.074
    seen = follow(*made(), x, gyro, force)
    assert np.sqrt(np.mean((seen[2000:, 0] - x[2000:, 0]) ** 2)) < 1e-3
    assert seen[-1, 3] + 10.0 * seen[-1, 5] == pytest.approx(0.004 + 0.2, abs=2e-3)  # together they are what turns the lean
    assert seen[-1, 6] == pytest.approx(0.004, abs=5e-4)


def test_a_gyro_that_lags_is_made_good():
    """At 0.32 rad/s and 2.5 ms the lean would be up to 0.8 mrad late."""
    x, gyro, force = motion(2000, 0.0)
    late = gyro.copy()
    late[1:] = 0.5 * (gyro[1:] + gyro[:-1])  # the mean over a step: half a step late
    error = [np.abs(follow(*made(gyro_delay_s=delay), x, late, force)[400:, 0] - x[400:, 0]).max() for delay in (0.0, 0.0025)]
    assert error[1] < 0.35 * error[0]


def test_a_second_without_wheels_or_accelerometer_is_bridged():
    x, gyro, force = motion(3000, 5.0)
    for missing in (inertial.PHI_VALID, inertial.ACCELEROMETER_VALID):
        valid = np.full(len(x), inertial.ALL_VALID)
        valid[1500:1700] &= ~missing
        seen = follow(*made(), x, gyro, force, valid)
        assert np.abs(seen[1500:, 0] - x[1500:, 0]).max() < 3e-3, missing


def test_without_a_gyro_the_last_rate_holds():
    p, state = made()
    inertial.step(p, state, np.array([0.4, 0.0, 0.0, -9.8]), np.zeros(2), inertial.ALL_VALID)
    lean, rate = state.x[0], state.x[inertial.RATE]
    inertial.step(p, state, np.array([9.0, 9.0, 0.0, -9.8]), np.array([0.0, 9.0]), 0)
    assert state.x[0] == pytest.approx(lean + DT * rate) and state.status == 0


@pytest.mark.parametrize("place, size", [(0, 15.0), (0, -15.0), (1, 3.0), (1, -15.0), (2, 80.0), (3, -80.0)])
def test_spikes_are_no_motion(place, size):
    """One sample in ten, in bursts of up to three: taken for a motion, each of 15 rad/s would turn the lean by 75 mrad."""
    x, gyro, force = motion(2000, 5.0)
    column = (gyro[:, 0], gyro[:, 2], force[:, 1], force[:, 2])[place]
    rng = np.random.default_rng(5)
    for begin in rng.choice(np.arange(500, 1990), 75, replace=False):
        column[begin : begin + rng.integers(1, 4)] += size
    p, state = made()
    seen = follow(p, state, x, gyro, force)
    assert np.abs(seen[:, 0] - x[:, 0]).max() < 5e-3
    assert place > 1 or state.rejected[inertial.GYRO] >= 75


def test_a_gyro_that_stays_where_it_jumped_to_is_believed():
    """A blow is no spike: after PATIENCE samples the filter must follow it."""
    p, state = made()
    for tick in range(inertial.PATIENCE + 1):
        inertial.step(p, state, np.array([6.0, 0.0, 0.0, -9.8]), np.zeros(2), inertial.ALL_VALID & ~inertial.PHI_VALID)
        assert state.status & ekf.REJECTED and (state.x[inertial.RATE] == 6.0) == (tick == inertial.PATIENCE)
    inertial.step(p, state, np.array([6.0, 0.0, 0.0, -9.8]), np.zeros(2), inertial.ALL_VALID & ~inertial.PHI_VALID)
    assert not state.status & ekf.REJECTED


def test_inputs_that_are_not_finite_count_as_missing():
    for place in range(4):
        for bad in (math.nan, math.inf, -math.inf):
            p, state = made()
            u = np.array([0.1, 0.2, 0.3, -9.8])
            u[place] = bad
            inertial.step(p, state, u, np.zeros(2), inertial.ALL_VALID)
            assert state.status == ekf.NOT_FINITE and np.isfinite(np.asarray(state.x)).all() and np.isfinite(np.asarray(state.P)).all()
            inertial.step(p, state, np.array([0.0, 0.0, 0.0, -9.8]), np.zeros(2), inertial.ALL_VALID)
            assert state.status == 0
