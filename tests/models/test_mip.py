"""The exact eduMIP model against an independent derivation (Kane's method with complex-step derivatives) and against its own invariants."""

import numpy as np
import pytest

from mip_rt.models import mip, mip_yaw

pytestmark = pytest.mark.armhf
H = 1e-30


def rotations(q):
    """(Rz(yaw), Rz(yaw) Rx(pitch)), complex-safe."""
    st, ct, sp, cp = np.sin(q[0]), np.cos(q[0]), np.sin(q[2]), np.cos(q[2])
    rz = np.array([[cp, -sp, 0], [sp, cp, 0], [0, 0, 1]])
    return rz, rz @ np.array([[1, 0, 0], [0, ct, -st], [0, st, ct]])


def motion(q, v, p, point=(0.0, 0.0, 0.0)):
    """Body rate, velocity of the centre of mass (or of a point of the body relative to it), body's angular momentum, then for each wheel
    velocity, rate, angular momentum without rotor, angle's rate relative to the body; all inertial axes."""
    rz, R = rotations(q)
    x, y, z = rz @ [1, 0, 0], rz @ [0, 1, 0], np.array([0, 0, 1])
    axle = -p.wheel_radius_m * (v[0] + v[1]) * y
    rate = v[0] * x + v[2] * z
    com = axle + np.cross(rate, R @ (np.array([0, 0, p.com_height_m]) + point))
    parts = [rate, com, R @ (np.asarray(p.body_inertia_kg_m2) * (R.T @ rate))]
    about_axle, second, third = p.wheel_inertia_kg_m2
    for side in (-1, 1):  # right, left; x points to the left
        velocity = axle + np.cross(v[2] * z, side * 0.5 * p.track_m * x)
        forward = -velocity @ y
        spin = forward / p.wheel_radius_m  # rolls without slip
        momentum = (about_axle - p.rotor_inertia_kg_m2) * spin * x + third * v[2] * z + 0 * second * y
        parts += [velocity, spin * x + v[2] * z, momentum, spin - v[0]]
    return parts


def kane_residual(x, vdot, torque, p):
    """Generalised active plus inertia forces of the three speeds; zero for the true accelerations."""
    q, v = x[:3].astype(complex), x[3:].astype(complex)
    advanced = [part.imag / H for part in motion(q + 1j * H * x[3:], v + 1j * H * vdot, p)]
    _, a_com, body_torque = advanced[:3]
    weight = np.array([0, 0, -p.body_mass_kg * p.gravity_m_s2])
    residual = np.empty(3)
    for r in range(3):
        unit = np.zeros(3)
        unit[r] = 1.0
        partial = [part.real for part in motion(q, v * 0 + unit, p)]
        residual[r] = (p.body_mass_kg * a_com - weight) @ partial[1] + body_torque @ partial[0]
        for i in range(2):
            velocity, _, momentum_rate, angle = advanced[3 + 4 * i : 7 + 4 * i]
            d_velocity, d_rate, _, d_angle = partial[3 + 4 * i : 7 + 4 * i]
            residual[r] += p.wheel_mass_kg * velocity @ d_velocity + momentum_rate @ d_rate + (p.rotor_inertia_kg_m2 * angle - torque[i]) * d_angle
    return residual


def random_states(count, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield np.concatenate([rng.uniform(-1.4, 1.4, 1), rng.normal(size=2), rng.normal(size=3) * [5, 20, 10]]), rng.normal(size=2)


@pytest.mark.parametrize("reading", ["rigid", "rotor"])
def test_exact_variant_satisfies_kane_equations(reading):
    rotor = mip.rotor_inertia(mip.TABLE_3_2["wheel_inertia_kg_m2"], reading)
    p = mip.parameters(rotor_inertia_kg_m2=rotor, body_inertia_kg_m2=(5.9e-4, 3.5e-4, 2.5e-4))[0]
    for x, u in random_states(60):
        torque = p.torque_per_command_n_m * np.array([u[0] + u[1], u[0] - u[1]]) - p.damping_n_m_s_rad * mip.encoder_rate(x, p)
        assert np.abs(kane_residual(x, mip.acceleration(x, u, p), torque, p)).max() < 1e-12


def test_the_papers_derivation_is_as_wrong_as_it_is():
    """Variant T differs by up to 112 rad/s^2 on random states; if it did not, the comparison of filters would compare nothing."""
    exact, thesis = mip.parameters()[0], mip.parameters(variant=mip.THESIS)[0]
    worst = max(np.abs(mip.acceleration(x, u, exact) - mip.acceleration(x, u, thesis)).max() for x, u in random_states(300))
    assert worst > 10.0


@pytest.mark.parametrize("variant", [mip.EXACT, mip.THESIS])
@pytest.mark.parametrize("rotor", [0.0, 4.924e-5])
def test_energy_is_conserved_without_torque(variant, rotor):
    p = mip.parameters(torque_per_command_n_m=0.0, damping_n_m_s_rad=0.0, variant=variant, rotor_inertia_kg_m2=rotor)[0]
    x = np.array([0.3, 0.1, 0.2, 0.5, 4.0, 9.0])
    before = mip.energy(x, p)
    h = 2.5e-4
    for _ in range(1200):
        k1 = mip.derivative(x, np.zeros(2), p)
        k2 = mip.derivative(x + h / 2 * k1, np.zeros(2), p)
        k3 = mip.derivative(x + h / 2 * k2, np.zeros(2), p)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + mip.derivative(x + h * k3, np.zeros(2), p))
    assert mip.energy(x, p) == pytest.approx(before, rel=1e-7)


def test_accelerometer_is_minus_specific_force_at_the_imu():
    p = mip.parameters(imu_position_m=(0.004, -0.016, 0.021))[0]
    for x, u in random_states(20):
        xdd = mip.acceleration(x, u, p)
        q, v = x[:3] + 1j * H * x[3:], x[3:] + 1j * H * xdd
        at_imu = motion(q, v, p, np.asarray(p.imu_position_m))[1].imag / H
        wanted = rotations(x)[1].T @ (np.array([0, 0, -p.gravity_m_s2]) - at_imu)
        assert mip.accelerometer(x, xdd, p) == pytest.approx(wanted, abs=1e-9)


def test_gyro_and_encoders_follow_from_kinematics():
    p = mip.parameters()[0]
    for x, _ in random_states(20):
        parts = motion(x[:3].astype(complex), x[3:].astype(complex), p)
        assert mip.gyro(x) == pytest.approx((rotations(x)[1].T @ parts[0]).real)
        assert mip.encoder_rate(x, p) == pytest.approx([parts[6].real, parts[10].real])
    turned = mip.derivative(np.array([0, 0, 0, 0, 0, 0.0]), [0.0, 0.1], p)
    assert turned[5] > 0.0 and turned[4] == 0.0  # u_z > 0 turns left
    pushed = mip.derivative(np.zeros(6), [0.1, 0.0], p)
    assert pushed[4] > 0.0 > pushed[3]  # driving forward leans the body back


def test_coefficients_are_the_golden_ones():
    """The derived figures of the corrected equations, section A, to their five digits; a slip in m, J or k would move them."""
    c = mip_yaw.coefficients(mip.parameters()[0])[0]
    assert c.tilt == pytest.approx([125.815, 13.6166, 0.253617, -544.665], rel=1e-5)
    assert c.wheel == pytest.approx([-223.028, -37.3462, 0.323082, 1493.85], rel=1e-5)
    assert c.yaw == pytest.approx([-12.1664, 486.657, -0.711696], rel=1e-5)
    assert c.accel == pytest.approx([-7.4149, -0.20417, -0.014149, 8.1668], rel=1e-4)
    t = mip_yaw.coefficients(mip.parameters()[0], "thesis")[0]
    assert (t.tilt[2], t.wheel[2], t.accel[2]) == pytest.approx((0.600804, -1.06502, -0.034611), rel=1e-4)
    printed = mip_yaw.coefficients(mip.parameters()[0], "printed")[0]
    assert printed.tilt[2] * 0.005 == pytest.approx(0.009) and printed.wheel[2] * 0.005 == pytest.approx(-0.016)
    poles = np.sort(np.linalg.eigvals(mip.linear_matrices(mip.parameters()[0])[0]).real)
    assert poles == pytest.approx([-39.467, -12.166, -5.5146, 0, 0, 7.6356], abs=2e-3)


def test_the_other_reading_of_the_wheel_inertia_changes_the_lean_by_a_third():
    rotor = mip.rotor_inertia(mip.TABLE_3_2["wheel_inertia_kg_m2"], "rotor")
    rigid, other = (mip_yaw.coefficients(mip.parameters(rotor_inertia_kg_m2=r)[0])[0].tilt[3] for r in (0.0, rotor))
    assert other / rigid == pytest.approx(0.68, abs=0.005)


@pytest.mark.parametrize("lever", [(0.0, 0.0, 0.0), (0.004, -0.016, 0.02)])
def test_small_angle_model_is_the_first_order_of_the_exact_one(lever):
    p = mip.parameters(imu_position_m=lever, rotor_inertia_kg_m2=2e-5)[0]
    rng = np.random.default_rng(3)
    for _ in range(20):
        direction, yaw_rate, turn = rng.normal(size=5), 5.0 * rng.normal(), rng.normal()
        errors = []
        for e in (1e-3, 1e-4):
            x = np.array([e * direction[0], e * direction[1], 0.3, e * direction[2], e * direction[3], yaw_rate])
            u = np.array([e * direction[4], turn])
            force = mip.accelerometer(x, mip.acceleration(x, u, p), p)
            exact = np.concatenate([mip.derivative(x, u, p), force[1:2]])
            near = np.concatenate([mip.high_yaw_derivative(x, u, p), mip.high_yaw_output(x, u, p)[2:3]])
            errors.append(np.abs(exact - near).max())
        assert errors[1] < 0.011 * errors[0] + 1e-12  # quadratic: ten times smaller, a hundred times nearer


def test_jacobians_are_the_derivatives():
    p = mip.parameters(imu_position_m=(0.004, -0.016, 0.02))[0]
    rng = np.random.default_rng(5)
    for _ in range(10):
        x, u = rng.normal(size=6) * [0.3, 1, 1, 2, 5, 8], rng.normal(size=2)
        for function, jacobian in (
            (mip.high_yaw_derivative, mip.high_yaw_derivative_jacobian), (mip.high_yaw_output, mip.high_yaw_output_jacobian)
        ):  # fmt: skip
            found = np.column_stack([(function(x + d, u, p) - function(x - d, u, p)) / 2e-6 for d in np.eye(6) * 1e-6])
            assert jacobian(x, u, p) == pytest.approx(found, abs=1e-5, rel=1e-6)


def test_patterns_name_every_entry_of_the_jacobians():
    """The filter only multiplies the places that the patterns name: a missing one would be silently zero."""
    p = mip.parameters(imu_position_m=(0.004, -0.016, 0.02))[0]
    x, u = np.array([0.1, 1, 2, 0.3, 4, 5.0]), np.array([0.2, 0.1])
    for matrix, listed in (
        (mip.high_yaw_derivative_jacobian(x, u, p), mip_yaw.DERIVATIVE_PATTERN), (mip.high_yaw_output_jacobian(x, u, p), mip_yaw.OUTPUT_PATTERN)
    ):  # fmt: skip
        assert {(i, k) for i, columns in listed for k in columns} == {(int(i), int(k)) for i, k in np.argwhere(matrix)}


def test_unknown_parameter_is_refused():
    with pytest.raises(KeyError, match="mass"):
        mip.parameters(mass=1.0)
