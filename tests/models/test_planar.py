"""The planar lab model against a derivation of its own, and the pendulum rig and the switched bridge against independent arithmetic."""

import math

import numpy as np
import pytest

from mip_rt.models import motor, pendulum_rig, planar, switched_bridge

P = planar.parameters()[0]


def constrained(x, torque):
    """[theta'', phi''] in maximal coordinates: body at (X, Z, lean), massless wheel at place s; unknowns X'', Z'', lean'', s'' and the axle's force.

    The wheel has no mass: the axle's force and the ground's contact force on it balance, and about the axle the motor's torque equals
    the contact force times the radius.
    """
    _, lean, _, lean_rate = x
    r, length, m = P.wheel_radius_m, P.com_height_m, P.body_mass_kg
    push = torque / r  # of the axle on the body, horizontally
    # unknowns: X'', Z'', lean'', s'', upward force of the axle
    M, b = np.zeros((5, 5)), np.zeros(5)
    M[0, 0], b[0] = m, push
    M[1, 1], M[1, 4], b[1] = m, -1.0, -m * P.gravity_m_s2
    # about the centre of mass: the forces at the axle, (-l sin, -l cos) from it, and the reaction of the motor on the body (backward)
    M[2, 2], M[2, 4] = P.body_inertia_kg_m2, -length * math.sin(lean)
    b[2] = -torque - push * length * math.cos(lean)
    M[3, :4], b[3] = [1, 0, -length * math.cos(lean), -1], -length * math.sin(lean) * lean_rate**2
    M[4, :4], b[4] = [0, 1, length * math.sin(lean), 0], -length * math.cos(lean) * lean_rate**2
    found = np.linalg.solve(M, b)
    return np.array([found[3] / r - found[2], found[2]])


def test_planar_model_is_that_of_the_force_balance():
    random = np.random.default_rng(1)
    for _ in range(50):
        x, torque = random.uniform(-3, 3, 4), random.uniform(-0.2, 0.2)
        assert planar.derivative(x, torque, P)[2:] == pytest.approx(constrained(x, torque), rel=1e-9, abs=1e-9)


def test_printed_equations_are_another_robot():
    """The two errors of (6): if the flag did nothing, the reproduction would compare a thing with itself."""
    x = np.array([0.0, 0.3, 0.0, 1.0])
    assert not np.allclose(planar.derivative(x, 0.05, P, True)[2:], constrained(x, 0.05), rtol=0.1)


def test_without_torque_energy_and_momentum_stay():
    x = np.array([0.2, 1.0, 3.0, -2.0])
    before = planar.energy(x, P), planar.momentum(x, P)
    planar.advance(x, 0.0, P, 0, 2.0, 20000)  # the light wheel makes it stiff
    assert (planar.energy(x, P), planar.momentum(x, P)) == pytest.approx(before, rel=1e-6)


@pytest.mark.parametrize("printed", [False, True])
def test_linear_matrices_are_the_slopes(printed):
    A, B = planar.linear_matrices(P, printed)
    h = 1e-6
    for j in range(4):
        step = h * np.eye(4)[j]
        slope = (planar.derivative(step, 0, P, printed) - planar.derivative(-step, 0, P, printed)) / (2 * h)
        assert A[:, j] == pytest.approx(slope, rel=1e-6, abs=1e-5)
    slope = (planar.derivative(np.zeros(4), h, P, printed) - planar.derivative(np.zeros(4), -h, P, printed)) / (2 * h)
    assert B[:, 0] == pytest.approx(slope, rel=1e-6)


def test_rig_sensors_are_the_second_derivative_of_the_place():
    """Specific force = acceleration of the point minus gravity, in the pendulum's axes, from differences of the position alone."""
    angle = lambda t: 0.3 * math.sin(5.0 * t)  # noqa: E731
    place = lambda t: pendulum_rig.LEVER_M * np.array([math.sin(angle(t)), math.cos(angle(t))])  # noqa: E731
    t, h = 0.37, 1e-4
    force = (place(t + h) - 2 * place(t) + place(t - h)) / h**2 + [0.0, pendulum_rig.GRAVITY_M_S2]
    a, v, w = angle(t), 1.5 * math.cos(5 * t), -7.5 * math.sin(5 * t)
    transverse, radial = np.array([math.cos(a), -math.sin(a)]), np.array([math.sin(a), math.cos(a)])
    rate, fy, fz = pendulum_rig.output(a, v, w)
    assert (rate, fy, fz) == pytest.approx((v, -force @ transverse, force @ radial), abs=1e-4)  # y points against the motion


def test_rig_sensor_lags_and_saturates():
    time = np.arange(0, 5, 0.001)
    angle, rate, acceleration = pendulum_rig.hand(np.radians(5) * np.sin(2 * np.pi * 2 * time), 0.001)
    late = pendulum_rig.Sensor(0.05, 0.0, 0.0, 10.0, 0.0, 0.0)
    times, y = pendulum_rig.measure(late, time, angle, rate, acceleration, np.random.default_rng(1))
    assert y[200:, 0] == pytest.approx(np.interp(times[200:] - 0.05, time, rate), abs=1e-9)
    assert np.abs(y[:, 1:]).max() <= 10.0


@pytest.mark.parametrize("delta", [0.0, 0.15])
def test_switched_bridge_agrees_with_the_closed_form(delta):
    """Two derivations of one number: the averaged equations and the events. A wrong branch in either shows."""
    random = np.random.default_rng(2)
    for _ in range(400):
        u, omega, t_r = random.uniform(-1, 1), random.uniform(-1.6, 1.6), 10 ** random.uniform(-1.5, 1.5)
        assert switched_bridge.settled(u, omega, t_r, delta) == pytest.approx(motor.coast_current(u, omega, t_r, delta), abs=1e-9)
        assert switched_bridge.settled(u, omega, t_r, brake=True) == pytest.approx(motor.brake_current(u, omega), abs=1e-9)
