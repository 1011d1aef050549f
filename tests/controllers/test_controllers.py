"""Filters, schedule, references, feedback and wheel drive, each against its definition."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mip_rt.controllers import filters, gain_schedule, reference, state_feedback, wheel_drive
from mip_rt.models import motor
from mip_rt.robots.robot import orthonormal

pytestmark = pytest.mark.armhf
T_OB = orthonormal([[-0.73445, 0.05830, 0.67615], [0.35671, -0.81441, 0.45770], [0.57735, 0.57735, 0.57735]])


def record(dtype):
    return np.zeros(1, dtype).view(np.recarray)[0]


@pytest.mark.parametrize(("rate", "pole"), [(10, 0.951229), (15, 0.927743), (20, 0.904837)])
def test_published_low_pass_poles(rate, pole):
    assert filters.pole_from_rate(rate, 0.005) == pytest.approx(pole, abs=1e-6)


def test_low_pass_reaches_63_percent_after_its_time_constant_at_any_rate():
    for dt in (0.005, 0.01):
        y, pole = 0.0, filters.pole_from_rate(6.0, dt)
        for _ in range(round(1 / 6.0 / dt)):
            y = filters.low_pass(y, 1.0, pole)
        assert y == pytest.approx(1 - math.exp(-1), rel=0.02)


def test_derivative_has_the_published_weights_and_is_exact_on_lines():
    for k, weight in enumerate((28.5714, 17.1429, 5.71429, -5.71429, -17.1429, -28.5714)):
        history = np.zeros(6)
        values = [filters.derivative(history, 1.0 if i == 0 else 0.0, 200.0) for i in range(k + 1)]
        assert values[k] == pytest.approx(weight, rel=1e-5)
    history = np.zeros(6)
    for i in range(12):
        slope = filters.derivative(history, 3.0 + 0.25 * i, 200.0)
    assert slope == pytest.approx(50.0)


def gains(c1=1.0, pole=0.961, slc=0.2, lowpass=10.0):
    return SimpleNamespace(c1=c1, c2=2.0, c3=3.0, c4=4.0, c5=5.0, c6=6.0, slc_gain=slc, slc_pole=pole, lowpass_rad_s=lowpass)


def test_schedule_interpolates_and_blends_in_rad_per_second():
    p, s = record(gain_schedule.PARAMETERS), record(gain_schedule.STATE)
    gain_schedule.configure(p, [(0.0, gains(10.0)), (1.0, gains(20.0)), (1.5, gains(30.0))], 6.0, 0.005)
    gain_schedule.reset(p, s)
    assert s.gains[0] == 10.0
    gain_schedule.step(p, s, -math.pi)  # half a turn a second, backwards: half way to the second slot
    assert s.gains[0] == pytest.approx(10.0 + 5.0 * (1 - math.exp(-0.03)))
    for _ in range(2000):
        gain_schedule.step(p, s, 100.0)
    assert s.gains[0] == pytest.approx(30.0)


def test_outer_loop_keeps_its_meaning_at_another_rate():
    fast, slow = gain_schedule.gain_row(gains(), 0.005), gain_schedule.gain_row(gains(), 0.01)
    assert fast[gain_schedule.OUTER_GAIN] == pytest.approx(0.2 * 0.000985) and fast[gain_schedule.OUTER_POLE] == 0.961
    assert slow[7] == pytest.approx(0.961**2)
    assert slow[6] / (1 - slow[7]) == pytest.approx(fast[6] / (1 - fast[7]))


def test_schedule_refuses_too_many_slots():
    with pytest.raises(ValueError, match="1 to 8"):
        gain_schedule.configure(record(gain_schedule.PARAMETERS), [(k, gains()) for k in range(9)], 6.0, 0.005)


def test_reference_shapes_integrates_and_turns_with_the_forward_heading():
    p, s = record(reference.PARAMETERS), record(reference.STATE)
    reference.configure(p, 0.005, 0.032, 3.0, 10.0, 3.0)
    reference.reset(s, math.pi / 2, 0.0, 0.0)  # forward is inertial +y
    estimate = np.zeros(10)
    for _ in range(200):
        reference.step(p, s, 0.2, 0.0, 1.0, estimate)
    shaped = 0.2 / 0.032 * (1 - math.exp(-3.0))
    assert s.rate_rad_s == pytest.approx([-shaped, 0.0], abs=1e-9)
    assert s.yaw_rate_rad_s == pytest.approx(1 - math.exp(-3.0) * (1 + 3.0), rel=0.02)
    assert s.angle_rad[0] == pytest.approx(-0.2 / 0.032 * (1 - (1 - math.exp(-3.0)) / 3.0), rel=0.01)


def test_reference_waits_for_a_robot_that_is_held_back():
    p, s = record(reference.PARAMETERS), record(reference.STATE)
    reference.configure(p, 0.005, 0.032, 3.0, 2.0, 1.0)
    reference.reset(s, 0.0, 0.0, 0.0)
    for _ in range(2000):
        reference.step(p, s, 0.25, 0.0, 6.0, np.zeros(10))
    assert s.angle_rad[1] == 2.0 and s.yaw_rad == 1.0


def feedback(filter_frame="inertial"):
    p, s = record(state_feedback.PARAMETERS), record(state_feedback.STATE)
    state_feedback.configure(p, 0.005, filter_frame, 0.3, 2.5)
    state_feedback.reset(s)
    return p, s, record(reference.STATE), np.array([10.0, 0.4, 0.5, 0.1, 0.4, 1.2, 0.2 * 0.000985, 0.97, 0.0])


def run_feedback(p, s, ref, g, estimate):
    error, lean, command = np.zeros(10), np.zeros(4), np.zeros(3)
    limited = state_feedback.step(p, s, ref, g, estimate, error, lean, command)
    return error, lean, command, limited


def test_feedback_is_minus_k_times_reference_minus_estimate():
    estimate = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6, 0.7, -0.8, 0.9, -1.0])
    error, _, command, _ = run_feedback(*feedback(), estimate)
    c, s = math.cos(0.3), math.sin(0.3)
    angle = [-c * 0.9 + s * 1.0, s * 0.9 + c * 1.0]
    assert command[0] == pytest.approx(-(10 * -0.1 + 0.4 * angle[0] + 0.5 * -0.4 + 0.1 * -0.7))
    assert command[1] == pytest.approx(-(10 * 0.2 + 0.4 * angle[1] + 0.5 * 0.5 + 0.1 * 0.8))
    assert command[2] == pytest.approx(-(0.4 * -0.3 + 1.2 * -0.6))
    assert error[:3] == pytest.approx([-0.1, 0.2, -0.3])


def test_outer_loop_leans_towards_the_wanted_speed():
    """Errata item 6: a ball that is too slow in +x rotation asks for a positive roll reference."""
    p, s, ref, g = feedback()
    ref.rate_rad_s[0] = 5.0
    for _ in range(3):
        _, lean, _, _ = run_feedback(p, s, ref, g, np.zeros(10))
    assert lean[0] > 0.0 and lean[1] == 0.0


@pytest.mark.parametrize("frame_name", ["inertial", "yaw"])
def test_filter_frames_agree_without_yaw_and_differ_while_spinning(frame_name):
    outputs = []
    for name in ("inertial", frame_name):
        p, s, ref, g = feedback(name)
        g[8] = 0.95
        commands = []
        for k in range(40):
            estimate = np.zeros(10)
            estimate[6:8] = math.cos(0.03 * k), math.sin(0.03 * k)
            commands.append(run_feedback(p, s, ref, g, estimate)[2].copy())
        outputs.append(np.array(commands))
    assert outputs[0] == pytest.approx(outputs[1])
    p, s, ref, g = feedback("yaw")
    g[8] = 0.95
    spinning = []
    for k in range(40):
        estimate = np.zeros(10)
        estimate[2] = 0.05 * k
        estimate[6] = 1.0
        spinning.append(run_feedback(p, s, ref, g, estimate)[2].copy())
    assert np.abs(np.array(spinning)[-1]).max() > 0.0


def test_lean_reference_is_limited_and_says_so():
    p, s, ref, g = feedback()
    g[6] = 1.0
    ref.rate_rad_s[0] = 100.0
    *_, limited = run_feedback(p, s, ref, g, np.zeros(10))
    _, lean, _, _ = run_feedback(p, s, ref, g, np.zeros(10))
    assert limited and lean[0] == 0.3 and lean[2] == 2.5


def drive(coast=True, friction=0.3):
    p = record(wheel_drive.PARAMETERS)
    p.body_from_wheel[:], p.wheel_ratio = T_OB, 0.0125 / 0.032
    p.friction_level, p.friction_smoothing_s_rad = friction, 2.0
    p.drive = wheel_drive.DRIVE_COAST if coast else wheel_drive.DRIVE_BRAKE
    p.resistance_ohm, p.torque_constant_n_m_a, p.nominal_voltage_v = 3.385, 0.0742, 8.0
    p.time_ratio, p.command_limit, p.period_ns = 0.28932, 1.0, 50000.0
    p.motor_sign[:] = (1, -1, 1)
    return p


def run_drive(p, command, added=(0, 0, 0), scale=1.0, rate=(0, 0, 0), battery=8.0):
    out = [np.zeros(3) for _ in range(3)] + [np.zeros(3, np.int64)]
    bits = wheel_drive.step(p, np.array(command, float), np.array(added, float), scale, np.array(rate, float), battery, *out)
    return bits, *out


VECTOR = st.tuples(*[st.floats(-0.8, 0.8)] * 3)


@given(VECTOR, VECTOR)
def test_applied_command_is_the_command_while_nothing_clips(command, added):
    bits, wheel, applied, duty, _ = run_drive(drive(), command, added)
    if not bits:
        assert applied == pytest.approx(command, abs=1e-9)
    assert np.abs(duty).max() <= 1.0 and np.abs(wheel).max() <= 1.0


@given(VECTOR, st.tuples(*[st.floats(-60, 60)] * 3), st.floats(6.0, 8.4))
def test_coasting_motor_carries_the_current_of_the_linear_motor(command, rate, battery):
    """(8 u - k w) / R is what a drive/brake bridge at 8 V gives; the duty must give the same from the present battery."""
    bits, wheel, _, duty, _ = run_drive(drive(), command, rate=rate, battery=battery)
    for i in range(3):
        wanted = (8.0 * wheel[i] - 0.0742 * rate[i]) / battery
        speed = 0.0742 * rate[i] / battery
        if not bits:
            assert motor.coast_current(duty[i], speed, 0.28932) == pytest.approx(wanted, abs=1e-8)


@pytest.mark.parametrize("coast", [True, False])
def test_low_battery_clips_and_the_estimators_are_told(coast):
    bits, wheel, applied, duty, duty_ns = run_drive(drive(coast), (3.0, 0.0, 0.0), battery=6.4)
    assert bits & wheel_drive.CLIPPED and np.abs(wheel).max() == pytest.approx(0.8)
    assert abs(applied[0]) < 3.0 and np.abs(duty).max() == pytest.approx(1.0)
    assert list(np.sign(duty_ns)) == list(np.sign(duty * (1, -1, 1)))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_non_finite_command_becomes_no_duty(bad):
    bits, _, _, duty, duty_ns = run_drive(drive(), (bad, 0.1, 0.1))
    assert np.isfinite(duty).all() and np.abs(duty_ns).max() <= 50000
    assert bits


def test_friction_compensation_is_level_at_speed_and_zero_at_rest():
    added = np.zeros(3)
    wheel_drive.friction_add(drive(), np.zeros(10), added)
    assert not added.any()
    wheel_drive.friction_add(drive(), np.array([0, 0, 0, 0, 0, -10.0, 10.0, -10.0, 0, 0]), added)
    assert added == pytest.approx([0.3, -0.3, 0.3], rel=1e-3)


def test_soft_start_scales_the_wheels():
    _, full, *_ = run_drive(drive(), (0.5, 0.2, 0.1))
    _, half, *_ = run_drive(drive(), (0.5, 0.2, 0.1), scale=0.5)
    assert half == pytest.approx(0.5 * full)
