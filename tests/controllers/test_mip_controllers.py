"""The eduMIP's controllers: designed gains against independent solutions, filters against their published stability, limits, NaN."""

import math

import numpy as np
import pytest
from helpers import make_config

from mip_rt.config.schema_edumip import FILTERS
from mip_rt.controllers import lqr, mip_drive, mip_feedback, mip_reference, pid, successive_loop, wheel_drive
from mip_rt.models import mip, mip_yaw
from mip_rt.robots import edumip_setup

pytestmark = pytest.mark.armhf


@pytest.fixture(scope="module")
def edumip_config():
    return make_config("edumip")


def record(dtype):
    return np.zeros(1, dtype).view(np.recarray)[0]


def test_exponential_is_that_of_a_rotation_and_of_a_nilpotent_matrix():
    turn = lqr.exponential(np.array([[0.0, -2.0], [2.0, 0.0]]))
    assert turn == pytest.approx(np.array([[math.cos(2), -math.sin(2)], [math.sin(2), math.cos(2)]]), abs=1e-14)
    Ad, Bd = lqr.discretise([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], 0.1)
    assert Ad == pytest.approx(np.array([[1, 0.1], [0, 1]])) and Bd[:, 0] == pytest.approx([0.005, 0.1])


def test_riccati_solution_satisfies_its_equation_and_is_optimal():
    """Doubling must land where the plain iteration lands, and any other gain must cost more."""
    rng = np.random.default_rng(1)
    A, B, Q, R = rng.normal(size=(4, 4)), rng.normal(size=(4, 2)), np.eye(4), np.diag([1.0, 0.3])
    P = lqr.riccati(A, B, Q, R)
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    assert P == pytest.approx(Q + A.T @ P @ A - A.T @ P @ B @ K, rel=1e-9)
    x0 = rng.normal(size=4)

    def cost(gain):
        x, total = x0, 0.0
        for _ in range(400):
            u = -gain @ x
            total += x @ Q @ x + u @ R @ u
            x = A @ x + B @ u
        return total

    assert cost(K) == pytest.approx(x0 @ P @ x0, rel=1e-9)
    for _ in range(5):
        assert cost(K + 1e-3 * rng.normal(size=K.shape)) > cost(K)


def test_a_model_that_cannot_be_stabilised_is_refused():
    with pytest.raises(ValueError, match="stabilised|stable"):
        lqr.gains([[1.0, 0.0], [0.0, -1.0]], [[0.0], [1.0]], [1.0, 1.0], [1.0], 0.005)


@pytest.mark.parametrize("rate_hz", [100.0, 200.0])
@pytest.mark.parametrize("reading", ["rigid", "rotor"])
def test_designed_gains_stabilise_both_readings_at_every_yaw_rate(edumip_config, rate_hz, reading):
    """Gains from one reading of the wheel inertia must hold the robot of the other (30 % in the command's effect)."""
    true = mip_yaw.coefficients(edumip_setup.model_parameters(edumip_config, reading)[0])[0]
    for yaw_rate in (0.0, 5.0, 10.0, 15.0, 20.0):
        K = edumip_setup.design(edumip_config, 1.0 / rate_hz, yaw_rate)
        Ad, Bd = lqr.discretise(*edumip_setup.balance_model(true, yaw_rate), 1.0 / rate_hz)
        assert np.abs(np.linalg.eigvals(Ad - Bd @ K[None])).max() < 1.0


def loop_growth(filters, used_hz: float, sign: float = 1.0, yaw_rate: float = 0.0, reading: str = "rigid", spin: float = 0.0) -> float:
    """ln(spectral radius) / dt of the small-angle eduMIP at a yaw rate under the two filters: negative is stable."""
    f = dict(filters)
    dt = 1.0 / used_hz
    rotor = mip.rotor_inertia(mip.TABLE_3_2["wheel_inertia_kg_m2"], reading)
    c = mip_yaw.coefficients(mip.parameters(rotor_inertia_kg_m2=rotor)[0])[0]
    A, B = np.zeros((4, 4)), np.zeros((4, 1))  # lean, phi, their rates
    A[0, 2] = A[1, 3] = 1.0
    for row, (lean, damping, centrifugal, command) in ((2, c.tilt), (3, c.wheel)):
        A[row, 0], A[row, 3], B[row, 0] = lean + centrifugal * yaw_rate**2, damping, command
    Ad, Bd = lqr.discretise(A, B, dt)
    b1, a1 = successive_loop.resample(f["inner_numerator"], f["inner_denominator"], f["made_hz"], used_hz)
    b2, a2 = successive_loop.resample(f["outer_numerator"], f["outer_denominator"], f["made_hz"], used_hz)
    b1, b2 = f["inner_gain"] * (1.0 + spin * yaw_rate**2) * b1, sign * f["outer_gain"] * b2
    # Canonical state of each filter; inputs wheel = phi + pitch, lean.
    n = 8
    M = np.zeros((n, n))

    def companion(a):
        return np.array([[-a[1], -a[2]], [1.0, 0.0]])

    def output(b, a):
        return np.array([b[1] - a[1] * b[0], b[2] - a[2] * b[0]])

    wheel = np.zeros(n)
    wheel[[0, 1]] = -1.0
    lean_ref = b2[0] * wheel
    lean_ref[6:8] += output(b2, a2)
    error = lean_ref.copy()
    error[0] -= 1.0
    u = b1[0] * error
    u[4:6] += output(b1, a1)
    M[:4] = np.outer(Bd[:, 0], u)
    M[:4, :4] += Ad
    M[4:6, 4:6] = companion(a1)
    M[4] += error
    M[6:8, 6:8] = companion(a2)
    M[6] += wheel
    return math.log(np.abs(np.linalg.eigvals(M)).max()) / dt


def test_published_filters_have_their_published_stability():
    """Golden: -0.25 /s with phi + pitch at 200 Hz; the printed minus sign of D2 falls at +2.5 /s."""
    dissertation = FILTERS["dissertation"]
    assert loop_growth(dissertation, 200.0) == pytest.approx(-0.25, abs=0.01)
    assert loop_growth(dissertation, 200.0, sign=-1.0) > 2.0
    assert loop_growth(FILTERS["public"], 100.0) == pytest.approx(-0.21, abs=0.03)


@pytest.mark.parametrize("used_hz", [100.0, 200.0])
@pytest.mark.parametrize("reading", ["rigid", "rotor"])
def test_growing_with_the_spin_the_loops_hold_any_yaw_rate(edumip_config, reading, used_hz):
    """As in the papers they fall at 20 rad/s, of the other reading of the wheel inertia at 15; the gain is that of the configured model."""
    robot = edumip_setup.build(edumip_config)
    spin = float(robot.parameters[0]["loops"]["spin_s2_rad2"])
    f = FILTERS["dissertation"]
    assert loop_growth(f, used_hz, yaw_rate=20.0 if reading == "rigid" else 15.0, reading=reading) > 0.2
    for rate in (5.0, 10.0, 15.0, 20.0):
        assert loop_growth(f, used_hz, yaw_rate=rate, reading=reading, spin=spin) < -0.2
    paper = edumip_setup.build(make_config("edumip", control__spin_gain="false"))
    assert paper.parameters[0]["loops"]["spin_s2_rad2"] == 0.0


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("used_hz", [100.0, 200.0, 400.0])
def test_filters_stay_stable_at_other_rates_than_they_were_made_for(name, used_hz):
    """Used as they stand at another rate, the same digits are another controller; carried over, growth stays what it was."""
    assert loop_growth(FILTERS[name], used_hz) == pytest.approx(loop_growth(FILTERS[name], FILTERS[name]["made_hz"]), abs=0.06)


def test_resampling_keeps_the_frequency_response_and_undoes_itself():
    f = FILTERS["public"]
    b, a = successive_loop.resample(f["inner_numerator"], f["inner_denominator"], 100.0, 200.0)
    for rate in (0.5, 2.0, 10.0, 30.0):
        made, used = np.exp(1j * 2.0 * np.arctan(rate / 200.0)), np.exp(1j * 2.0 * np.arctan(rate / 400.0))
        assert np.polyval(b, used) / np.polyval(a, used) == pytest.approx(
            np.polyval(f["inner_numerator"], made) / np.polyval(f["inner_denominator"], made)
        )
    back = successive_loop.resample(b, a, 200.0, 100.0)
    assert back[0] == pytest.approx(f["inner_numerator"]) and back[1] == pytest.approx(f["inner_denominator"])
    same = successive_loop.resample(f["outer_numerator"], f["outer_denominator"], 100.0, 100.0)
    assert same[0] == pytest.approx(f["outer_numerator"])


def test_loops_do_not_wind_up_behind_their_limits():
    p, s = record(successive_loop.PARAMETERS), record(successive_loop.STATE)
    f = FILTERS["dissertation"]
    successive_loop.configure_filter(p.inner, f["inner_numerator"], f["inner_denominator"], 1.0, 1.0, 200.0, 200.0)
    successive_loop.configure_filter(p.outer, f["outer_numerator"], f["outer_denominator"], 1.0, 0.4, 200.0, 200.0)
    for _ in range(2000):
        u, lean = successive_loop.step(p, s, 3.0, 0.5, 0.0)
    assert u == 1.0 and lean == pytest.approx(0.4)
    u, lean = successive_loop.step(p, s, -3.0, -0.5, 0.0)
    assert lean < -0.2 and u < 0.2  # at once and by the whole jump of the errors, after ten seconds at the limits
    successive_loop.reset(s)
    assert successive_loop.step(p, s, 0.0, 0.0, 0.0) == (0.0, 0.0)


def test_a_robot_that_is_behind_rolls_back_first_and_leans_forward():
    """The sign that the papers print wrong: place and lean carry the same, negative sign."""
    command, p, s = np.zeros(2), record(pid.PARAMETERS), record(pid.STATE)
    p.dt_s, p.lean, p.lean_rate, p.place, p.speed, p.integral, p.yaw, p.yaw_rate, p.integral_limit_m_s = 0.005, 5, 0.5, 6, 4, 3, 1, 0.05, 0.1
    pid.step(p, s, np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), 0.035, command)
    assert command[0] < 0.0 and command[1] == 0.0
    pid.step(p, s, np.array([-0.1, 0.0, 0.0, 0.0, 0.0, 0.0]), 0.035, command)  # leans forward: catch it by rolling forward
    assert command[0] > 0.0
    for _ in range(10000):
        pid.step(p, s, np.array([0.0, 5.0, 0.3, 0.0, 0.0, 0.0]), 0.035, command)
    assert s.integral_m_s == pytest.approx(0.1) and command[1] == pytest.approx(0.3)


def test_gains_are_interpolated_and_back_emf_is_fed_forward():
    p, s, command = record(mip_feedback.PARAMETERS), record(mip_feedback.STATE), np.zeros(2)
    p.dt_s, p.slots, p.integral_limit_rad_s = 0.005, 2, 1.0
    p.at_rad_s[:2], p.gains[0, 0], p.gains[1, 0] = (0.0, 10.0), 1.0, 3.0
    p.speed_feedforward, p.yaw_feedforward = 0.02, 0.03
    for rate, wanted in ((0.0, 1.0), (5.0, 2.0), (-5.0, 2.0), (40.0, 3.0)):
        mip_feedback.step(p, s, np.array([1.0, 0, 0, 0, 0, 0]), 0.0, rate, command)
        assert command[0] == pytest.approx(wanted) and command[1] == pytest.approx(0.03 * rate)


def test_reference_waits_for_a_robot_that_is_held_and_follows_stick_and_button():
    p, s = record(mip_reference.PARAMETERS), record(mip_reference.STATE)
    mip_reference.configure(p, 0.005, 0.035, 3.0, 10.0, 6.0, 1.5)
    mip_reference.reset(s, 1.0, 2.0)
    for _ in range(2000):
        mip_reference.step(p, s, 0.35, 0.1, 5.0, 1.0, 2.0)
    assert s.wheel_rate_rad_s == pytest.approx(10.0, rel=1e-3) and s.yaw_rate_rad_s == pytest.approx(6.0, rel=1e-3)
    assert s.wheel_rad == pytest.approx(7.0) and s.yaw_rad == pytest.approx(3.5)


def drive():
    p = record(mip_drive.PARAMETERS)
    p.half_track_in_radii, p.steering_limit, p.command_limit, p.period_ns = 1.0, 0.5, 1.0, 50000.0
    p.drive, p.resistance_ohm, p.torque_constant_n_m_a, p.nominal_voltage_v = wheel_drive.DRIVE_BRAKE, 13.3, 0.2, 8.0
    p.motor_sign[:] = (-1, 1)
    return p


def stepped(p, command, rates=(0.0, 0.0), battery_v=8.0, added=(0.0, 0.0), scale=1.0):
    wheel, applied, duty, duty_ns = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2, np.int64)
    bits = mip_drive.step(p, np.array(command), np.array(added), scale, np.array(rates), battery_v, wheel, applied, duty, duty_ns)
    return wheel, applied, duty, duty_ns, bits


def test_balance_gets_the_battery_before_steering():
    wheel, applied, duty, duty_ns, bits = stepped(drive(), [0.9, 0.5])
    assert wheel == pytest.approx([1.0, 0.8]) and applied == pytest.approx([0.9, 0.1]) and bits & wheel_drive.CLIPPED
    assert duty_ns[0] == -50000 and duty_ns[1] == 40000
    wheel, applied, _, _, bits = stepped(drive(), [0.3, 0.2])
    assert wheel == pytest.approx([0.5, 0.1]) and applied == pytest.approx([0.3, 0.2]) and not bits & wheel_drive.CLIPPED


def test_estimators_are_told_the_command_without_the_compensation():
    _, applied, _, _, _ = stepped(drive(), [0.3, 0.1], added=(0.05, -0.02))
    assert applied == pytest.approx([0.3, 0.1])
    _, applied, _, _, _ = stepped(drive(), [0.3, 0.1], battery_v=6.0)  # the current is what counts, whatever the battery
    assert applied == pytest.approx([0.3, 0.1])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_no_non_finite_command_reaches_a_duty(bad):
    for command in ([bad, 0.1], [0.1, bad]):
        _, _, duty, _, bits = stepped(drive(), command)
        assert np.isfinite(duty).all() and np.abs(duty).max() <= 1.0
        assert bits & (wheel_drive.NOT_FINITE | wheel_drive.CLIPPED)
