"""Drive/coast: the average current against a finely stepped switched circuit, the inverse against the forward equation."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mip_rt.models import friction, motor, omniwheels

pytestmark = pytest.mark.armhf
DUTY = st.floats(-1.0, 1.0)
SPEED = st.floats(-2.0, 2.0)
PERIOD = st.floats(-2.0, 2.0).map(lambda e: 10.0**e)
DROP = st.floats(0.0, 0.2)


def switched(u, omega, t_r, delta, steps=20000):
    """Average current of one periodic PWM cycle, integrated step by step: di/dt = (voltage - omega - i) in units of L/R."""
    on = abs(u)
    sign = 1.0 if u > 0 else -1.0
    h = t_r / steps
    current = 0.0
    for cycle in range(400 if t_r < 1 else 40):
        total = 0.0
        start = current
        for k in range(steps // 20):
            step = h * 20
            gone = math.exp(-step)
            driving = (k + 0.5) * 20 < on * steps
            if driving:
                target = sign - omega
            elif current > 0.0:
                target = -1.0 - delta - omega
            elif current < 0.0:
                target = 1.0 + delta - omega
            elif abs(omega) > 1.0 + delta:
                target = math.copysign(1.0 + delta, omega) - omega
            else:
                target = 0.0
            new = target + (current - target) * gone
            if not driving and current * new < 0.0 and abs(omega) <= 1.0 + delta:
                new = 0.0
            total += 0.5 * (current + new)
            current = new
        average = total / (steps // 20)
        if abs(current - start) < 1e-9:
            break
    return average


@pytest.mark.parametrize("delta", [0.0, 0.1])
@pytest.mark.parametrize("t_r", [0.05, 0.289, 2.0, 20.0])
@pytest.mark.parametrize("omega", [-1.6, -0.7, -0.2, 0.0, 0.4, 0.95, 1.5])
@pytest.mark.parametrize("u", [-0.9, -0.3, 0.0, 0.15, 0.5, 1.0])
def test_average_current_is_that_of_the_switched_circuit(u, omega, t_r, delta):
    assert motor.coast_current(u, omega, t_r, delta) == pytest.approx(switched(u, omega, t_r, delta), abs=6e-3)


@given(DUTY, SPEED, PERIOD, DROP)
def test_inverse_gives_the_current_back(u, omega, t_r, delta):
    current = motor.coast_current(u, omega, t_r, delta)
    duty, saturated = motor.coast_inverse(current, omega, t_r, delta)
    assert -1.0 <= duty <= 1.0
    if not saturated:
        assert motor.coast_current(duty, omega, t_r, delta) == pytest.approx(current, abs=1e-9) or abs(omega) >= 1.0


@given(st.floats(-10, 10), st.floats(-5, 5), PERIOD, DROP)
def test_inverse_is_bounded_and_signed_for_any_target(current, omega, t_r, delta):
    duty, _ = motor.coast_inverse(current, omega, t_r, delta)
    assert math.isfinite(duty) and abs(duty) <= 1.0
    assert duty * current >= 0.0


@given(st.floats(0.02, 0.98), st.floats(-0.95, 0.95), PERIOD)
def test_unreachable_targets_saturate(fraction, omega, t_r):
    duty, saturated = motor.coast_inverse((1.0 - omega) * (1.0 + fraction), omega, t_r)
    assert (duty, saturated) == (1.0, True)


@given(st.floats(-0.999, 0.999), PERIOD, DROP, st.floats(0.001, 0.998), st.floats(0.001, 1.0), st.sampled_from((-1.0, 1.0)))
def test_current_grows_with_duty(omega, t_r, delta, low, share, sign):
    high = low + 0.001 + share * (0.999 - low)
    slow = sign * motor.coast_current(sign * low, omega, t_r, delta)
    fast = sign * motor.coast_current(sign * high, omega, t_r, delta)
    assert fast > slow - 1e-12


def test_short_period_limit_is_continuous():
    for u in (0.2, 0.6, 0.9):
        for omega in (-0.5, 0.0, 0.5):
            assert motor.coast_current(u, omega, 0.99e-4) == pytest.approx(motor.coast_current(u, omega, 1.01e-4), abs=1e-4)


def test_long_period_limit_does_not_overflow():
    assert motor.coast_current(0.5, 0.2, 1e5) == pytest.approx(0.5 * 0.8, abs=1e-3)
    assert motor.coast_current(1.0, 0.2, 1e5) == pytest.approx(0.8)


def test_nan_gives_nan_and_never_a_duty():
    assert math.isnan(motor.coast_inverse(math.nan, 0.1, 0.3)[0])
    assert math.isnan(motor.coast_inverse(0.1, math.nan, 0.3)[0])


def test_constants_of_the_robot_motor():
    """Dissertation (6.16): i_s 2.3634 A, no-load 107.82 rad/s, T_r 0.28932 at 20 kHz."""
    assert 8.0 / 3.385 == pytest.approx(2.3634, rel=1e-4)
    assert 8.0 / 0.0742 == pytest.approx(107.82, rel=1e-4)
    assert 3.385 / (0.585e-3 * 20000.0) == pytest.approx(0.28932, rel=1e-4)


@pytest.mark.parametrize(("alpha", "beta"), [(45, 35.2644), (60, 48.1897), (70, 52.0914), (80, 54.1082)])
def test_table_2_1_in_closed_form(alpha, beta):
    tilt = omniwheels.orthogonal_tilt(math.radians(alpha))
    assert math.degrees(tilt) == pytest.approx(beta, abs=1e-4)
    axes = omniwheels.wheel_axes(math.radians(alpha), tilt)
    assert axes.T @ axes == pytest.approx(np.eye(3), abs=1e-12)


def test_no_orthogonal_axes_below_35_degrees():
    with pytest.raises(ValueError, match="35.264"):
        omniwheels.orthogonal_tilt(math.radians(35.0))
    ratio = omniwheels.normal_force(1, 9.8, math.radians(70)) / omniwheels.normal_force(1, 9.8, math.radians(45))
    assert ratio == pytest.approx(2.067, abs=1e-3)  # dissertation, text to (2.2)


@given(st.floats(-50, 50), st.floats(0.1, 10))
def test_compensation_is_an_odd_smoothed_sign(rate, k):
    value = friction.compensation(rate, k)
    assert abs(value) <= 1.0 and value * rate >= 0.0
    assert friction.compensation(-rate, k) == pytest.approx(-value)


def test_friction_opposes_motion():
    assert friction.torque(5.0, 0.05, 0.001) == pytest.approx(-0.055)
    assert friction.torque(0.0, 0.05, 0.001) == 0.0
