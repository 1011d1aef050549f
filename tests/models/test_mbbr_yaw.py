"""The high-yaw model: published coefficients, agreement with the exact model to first order, Jacobians by finite differences."""

import numpy as np
import pytest

from mip_rt.models import mbbr, mbbr_linear, mbbr_yaw

pytestmark = pytest.mark.armhf

# Corrected equations, table B.3, to five digits: column N (Table 5.2, exact) and column H0 (printed constants, inertial Lagrange).
COLUMN_N = {
    "tilt_x": [112.61, -6.6890, -107.02, -9.9677, -266.51, 1.7871, 0.047822, 0.78712],
    "ball_x": [-215.15, 25.279, 404.46, -6.2819, 303.95, 0.49607, 0.81927, 0.49607],
    "accel_y": [2.0452, 0.060644, 0.97030, 0.14942, 1.4205, -0.011800, 0.00043356, 0.011800],
    "spin": [-202.61, -12.663, 36.618, -143.64, 10.375, -3.6858, 0.090536, -0.090536, 0.026351, 0.074173],
}
COLUMN_H0 = {
    "tilt_x": [129.09, -8.8964, -132.73, -11.793, -308.68, 1.8018, 0.0028739, 0.80175],
    "ball_x": [-277.40, 33.621, 501.62, -6.4835, 404.88, 0.44079, 0.99382, 0.44079],
    "accel_y": [-4.5584, 0.52547, 7.8399, 0.31741, -3.1043, -0.021579, 0.00031967, 0.021579],
    "spin": [-219.45, -14.709, 7.5055, -140.24, 14.206, -5.3094, 0.014963, -0.014963, 0.011996, 0.014870],
}


def states(count=30, seed=1):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield rng.normal(size=13) * np.array([0.2, 0.2, 1, 1, 1, 1, 1, 6, 5, 5, 1, 1, 1]), rng.normal(size=3)


@pytest.mark.parametrize(
    ("parameters", "variant", "column"),
    [(mbbr.parameters, "exact", COLUMN_N), (mbbr.printed_parameters, "inertial-lagrange", COLUMN_H0)],
)
def test_published_coefficients(parameters, variant, column):
    c = mbbr_yaw.coefficients(parameters()[0], variant)[0]
    for name, wanted in column.items():
        assert c[name] == pytest.approx(wanted, rel=6e-5), name


def test_flown_coefficients_are_the_robot_authors_discrete_model():
    """A step of 5 ms as the author's program has it: phi'_x row 2.50624 u; gyro y = theta_y' + theta_x theta_z'; the ball's velocity does not rotate."""
    c = mbbr_yaw.coefficients(None, "flown")[0]
    assert 0.005 * c.ball_x[2] == pytest.approx(2.50624, rel=2e-3) and c.ball_y[2] == c.ball_x[2]
    assert (c.gyro_y_roll, c.gyro_y_pitch) == (1.0, 0.0) and abs(c.ball_x[6]) < 0.01
    printed = mbbr_yaw.coefficients(None, "printed")[0]
    assert np.delete(c.ball_x, 2) == pytest.approx(np.delete(printed.ball_x, 2)) and c.tilt_x == pytest.approx(printed.tilt_x)


def test_printed_coefficients_hold_the_printed_errors():
    c = mbbr_yaw.coefficients(None, "printed")[0]
    assert c.ball_x[2] == 410.0 and c.ball_x[6] == -0.0062
    assert (c.gyro_y_roll, c.gyro_y_pitch) == (0.0, 1.0)
    x = np.zeros(13)
    x[0], x[1], x[7] = 0.1, 0.2, 3.0
    assert mbbr_yaw.high_yaw_output(x, np.zeros(3), None, "printed")[1] == pytest.approx(0.6)


def test_agrees_with_the_exact_model_to_first_order():
    """Tilt and tilt rates scaled by epsilon: the difference must shrink with epsilon squared."""
    p = mbbr.parameters(body_inertia_kg_m2=(2.42e-3, 2.42e-3, 0.79e-3))[0]
    rng = np.random.default_rng(2)
    for _ in range(10):
        direction, w, z, u = rng.normal(size=4), rng.normal(size=2) * 4, rng.normal() * 8, rng.normal(size=3)
        errors = []
        for epsilon in (1e-3, 1e-4):
            x = np.zeros(10)
            x[[0, 1, 5, 6]] = epsilon * direction
            x[7], x[8:] = z, w
            x13 = np.zeros(13)
            x13[[0, 1]], x13[[5, 6]], x13[7], x13[8:10] = x[:2], x[5:7], z, w
            full = mbbr.acceleration(x, u, p)
            model = mbbr.high_yaw_derivative(x13, u, p)[5:10]
            outputs = mbbr.accelerometer(x, full, p)[:2] - mbbr.high_yaw_output(x13, u, p)[6:]
            errors.append(max(np.abs(full - model).max(), np.abs(outputs).max()))
        assert errors[1] < 0.02 * errors[0] + 1e-9


@pytest.mark.parametrize("variant", mbbr_yaw.VARIANTS)
def test_jacobians(variant):
    p = mbbr.parameters()[0]
    for x, u in states():
        for f, jacobian in (
            (mbbr.high_yaw_derivative, mbbr.high_yaw_derivative_jacobian),
            (mbbr.high_yaw_output, mbbr.high_yaw_output_jacobian),
        ):
            numeric = np.empty_like(jacobian(x, u, p, variant))
            for k in range(13):
                step = np.zeros(13)
                step[k] = 1e-5
                numeric[:, k] = (f(x + step, u, p, variant) - f(x - step, u, p, variant)) / 2e-5
            assert np.abs(numeric - jacobian(x, u, p, variant)).max() < 2e-5


@pytest.mark.parametrize(
    ("jacobian", "pattern"),
    [(mbbr.high_yaw_derivative_jacobian, mbbr_yaw.DERIVATIVE_PATTERN), (mbbr.high_yaw_output_jacobian, mbbr_yaw.OUTPUT_PATTERN)],
)
def test_patterns_name_every_nonzero(jacobian, pattern):
    allowed = {(row, column) for row, columns in pattern for column in columns}
    for variant in mbbr_yaw.VARIANTS:
        for x, u in states(5):
            found = set(zip(*(index.tolist() for index in np.nonzero(jacobian(x, u, mbbr.parameters()[0], variant)))))
            assert found <= allowed


def test_x_and_y_are_the_same_robot_turned_by_a_quarter():
    p = mbbr.parameters()[0]
    for x, u in states(10):
        turned, command = x.copy(), u.copy()
        for i, k in ((0, 1), (3, 4), (5, 6), (8, 9), (10, 11)):
            turned[i], turned[k] = x[k], -x[i]
        command[0], command[1] = u[1], -u[0]
        a, b = mbbr.high_yaw_derivative(x, u, p), mbbr.high_yaw_derivative(turned, command, p)
        # The spin row is left out: roll before pitch, the order of the Euler angles, is not symmetric to second order.
        assert b[[5, 6, 8, 9]] == pytest.approx([a[6], -a[5], a[9], -a[8]], abs=1e-9)


def test_linear_model_is_the_jacobian_at_rest():
    p = mbbr.parameters()[0]
    A, B, C, D = mbbr_linear.linear_matrices(p)
    kept = [0, 1, 3, 4, 5, 6, 8, 9]
    full = mbbr.high_yaw_derivative_jacobian(np.zeros(13), np.zeros(3), p)
    assert A == pytest.approx(full[np.ix_(kept, kept)])
    outputs = mbbr.high_yaw_output_jacobian(np.zeros(13), np.zeros(3), p)
    assert C == pytest.approx(outputs[np.ix_([0, 1, 3, 4, 6, 7], kept)])
    for k in range(2):
        u = np.zeros(3)
        u[k] = 1.0
        assert B[:, k] == pytest.approx(mbbr.high_yaw_derivative(np.zeros(13), u, p)[kept])
        assert D[:, k] == pytest.approx(mbbr.high_yaw_output(np.zeros(13), u, p)[[0, 1, 3, 4, 6, 7]])


def test_open_loop_poles():
    """Corrected equations, end of B.3: +7.560 (twice), -5.467, -34.06, 0."""
    A = mbbr_linear.linear_matrices(mbbr.parameters()[0])[0]
    poles = np.sort(np.linalg.eigvals(A).real)
    assert poles == pytest.approx([-34.06, -34.06, -5.467, -5.467, 0, 0, 7.560, 7.560], abs=6e-3)
