"""The exact MBBR model against an independent derivation (Kane's method, by complex-step derivatives) and against its own invariants."""

import numpy as np
import pytest

from mip_rt.models import mbbr

pytestmark = pytest.mark.armhf
H = 1e-30


def rotation(q):
    """Rz(yaw) Ry(pitch) Rx(roll), complex-safe."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(q[:3]), np.cos(q[:3])
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return rz, rz @ ry @ rx


def motion(q, v, p):
    """(body rate, centre of mass velocity, ball rate, ball velocity, phi_B', angular momentum of the body), inertial axes but phi_B'."""
    rz, R = rotation(q)
    sx, cx, sy, cy = np.sin(q[0]), np.cos(q[0]), np.sin(q[1]), np.cos(q[1])
    body = np.array([v[0] - sy * v[2], cx * v[1] + cy * sx * v[2], -sx * v[1] + cx * cy * v[2]])
    ball_rate = rz @ np.array([v[3], v[4], 0 * v[0]])
    ball = p.ball_radius_m * np.array([ball_rate[1], -ball_rate[0], 0 * v[0]])
    rate = R @ body
    com = ball + np.cross(rate, R @ np.array([0, 0, p.com_height_m]))
    return rate, com, ball_rate, ball, R.T @ ball_rate - body, R @ (np.asarray(p.body_inertia_kg_m2) * body)


def kane_residual(x, vdot, torque, p):
    """Generalised active plus inertia forces of the five speeds; zero for the true accelerations."""
    q, v = x[:3].astype(complex), x[5:].astype(complex)
    advanced = motion(q + 1j * H * x[5:8], v + 1j * H * vdot, p)
    _, a_com, alpha_ball, a_ball, phi_dd, momentum_rate = (part.imag / H for part in advanced)
    Jw = p.wheel_inertia_kg_m2 * (p.ball_radius_m / p.wheel_radius_m) ** 2
    weight = np.array([0, 0, -p.body_mass_kg * p.gravity_m_s2])
    residual = np.empty(5)
    for r in range(5):
        unit = np.zeros(5)
        unit[r] = 1.0
        d_rate, d_com, d_ball_rate, d_ball, d_phi, _ = (part.real for part in motion(q, v * 0 + unit, p))
        residual[r] = (
            (p.body_mass_kg * a_com - weight) @ d_com + momentum_rate @ d_rate
            + p.ball_mass_kg * a_ball @ d_ball + p.ball_inertia_kg_m2 * alpha_ball @ d_ball_rate
            + (Jw * phi_dd - torque) @ d_phi
        )  # fmt: skip
    return residual


def random_states(count, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield np.concatenate([rng.uniform(-1.2, 1.2, 3), rng.normal(size=2), rng.normal(size=5) * 5]), rng.normal(size=3)


def test_exact_variant_satisfies_kane_equations():
    p = mbbr.parameters(body_inertia_kg_m2=(2.4e-3, 2.1e-3, 0.8e-3))[0]
    for x, u in random_states(60):
        rate = mbbr.encoder_rate(x)
        torque = p.torque_per_command_n_m * u - p.damping_n_m_s_rad * rate
        assert np.abs(kane_residual(x, mbbr.acceleration(x, u, p), torque, p)).max() < 1e-12


@pytest.mark.parametrize(("variant", "least"), [(mbbr.INERTIAL_LAGRANGE, 1.0), (mbbr.PLAIN_LAGRANGE, 100.0)])
def test_printed_variants_are_the_wrong_ones_they_are(variant, least):
    """The thesis's derivations must differ from the exact model by as much as the errata say, or they compare nothing."""
    exact, other = mbbr.parameters()[0], mbbr.parameters(variant=variant)[0]
    worst = max(np.abs(mbbr.acceleration(x, u, exact) - mbbr.acceleration(x, u, other)).max() for x, u in random_states(200))
    assert worst > least


@pytest.mark.parametrize("variant", [mbbr.EXACT, mbbr.INERTIAL_LAGRANGE, mbbr.PLAIN_LAGRANGE])
def test_energy_is_conserved_without_torque(variant):
    p = mbbr.parameters(torque_per_command_n_m=0.0, damping_n_m_s_rad=0.0, variant=variant)[0]
    x = np.array([0.1, -0.05, 0.2, 0, 0, 0.3, -0.2, 4.0, 2, -3.0])
    before = mbbr.energy(x, p)

    def f(state):
        return mbbr.derivative(state, np.zeros(3), p)

    h = 2.5e-4
    for _ in range(800):
        a = f(x)
        b = f(x + h / 2 * a)
        c = f(x + h / 2 * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + f(x + h * c))
    assert mbbr.energy(x, p) == pytest.approx(before, rel=1e-7)


def test_heading_does_not_matter():
    p = mbbr.parameters()[0]
    for x, u in random_states(20):
        turned = x.copy()
        turned[2] += 1.234
        assert mbbr.acceleration(turned, u, p) == pytest.approx(mbbr.acceleration(x, u, p), rel=1e-12)


def test_gyro_and_encoder_follow_from_kinematics():
    p = mbbr.parameters()[0]
    for x, _ in random_states(20):
        rate, _, _, _, phi, _ = motion(x[:3].astype(complex), x[5:].astype(complex), p)
        _, R = rotation(x)
        assert mbbr.gyro(x) == pytest.approx((R.T @ rate).real)
        assert mbbr.encoder_rate(x) == pytest.approx(phi.real)


def test_accelerometer_is_minus_specific_force_at_the_imu():
    p = mbbr.parameters(imu_position_m=(0.01, -0.02, 0.13))[0]
    lever = np.asarray(p.imu_position_m)
    for x, u in random_states(20):
        xdd = mbbr.acceleration(x, u, p)
        q, v = x[:3] + 1j * H * x[5:8], x[5:] + 1j * H * xdd
        rate, _, _, ball, _, _ = motion(q, v, p)
        acceleration = (ball + np.cross(rate, rotation(q)[1] @ lever)).imag / H
        wanted = rotation(x)[1].T @ (np.array([0, 0, -p.gravity_m_s2]) - acceleration)
        assert mbbr.accelerometer(x, xdd, p) == pytest.approx(wanted, abs=1e-10)


def test_level_and_still_reads_gravity_downwards():
    p = mbbr.parameters()[0]
    assert mbbr.accelerometer(np.zeros(10), np.zeros(5), p) == pytest.approx([0, 0, -9.8])


def test_unknown_parameter_is_refused():
    with pytest.raises(KeyError, match="mass"):
        mbbr.parameters(mass=1.0)
