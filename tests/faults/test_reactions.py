"""Every fault of the table: injected at its boundary while the robot balances, on virtual time; which fault, and within its bound."""

import errno
import math

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt import frame
from mip_rt.config.scenario import Event, Scenario
from mip_rt.faults import FAULTS
from mip_rt.supervisor import State


def script(*events):
    return Scenario("test", "", 10.0, [Event(**event) for event in events])


def settled(dry, seconds=1.0):
    ticks = dry.session.loop.ticks + round(seconds * 200)
    dry.until(lambda: dry.session.loop.ticks >= ticks, 2 * seconds + 1.0)
    assert dry.state is State.BALANCING


def ends_in(dry, code, slack_s=0.005):
    """Runs until the fault; asserts which, that the motors are off, and how long it took from now (the cause acts from the next sample)."""
    took = dry.until(lambda: dry.state is State.FAULT, 12.0)
    assert dry.session.supervisor.fault.code == code
    assert not dry.motors_on() and not dry.session.devices.motors.enabled
    assert took <= FAULTS[code].bound_s + slack_s, took
    return took


def survives(dry, seconds):
    settled(dry, seconds)
    assert not dry.session.supervisor.events[-1][1] is State.FAULT


class Counts:
    """Between the wheels and what the encoders show: change(counts) -> counts, from when it is installed."""

    def __init__(self, dry, change):
        wiring = dry.bench.kernel.motor_wiring
        whole = wiring.show_encoders
        wiring.show_encoders = lambda counts: whole(change(np.array(counts)))


def drive(tmp_path, yaw_rate_hz=0.0, **overrides):
    """A robot that drives (and spins), settled."""
    events = [{"at_s": 2.0, "press": "arm"}, {"at_s": 3.5, "speed_m_s": [0.2, 0.0], "yaw_rate_hz": yaw_rate_hz}]
    return DryRun(tmp_path, make_config(estimator__shadows="[]", **overrides), script(*events))


# -- IMU ---------------------------------------------------------------------------------------------------------------
def test_out_of_step_fifo_is_a_fault_and_is_set_right_afterwards(balancing):
    settled(balancing)
    chip = balancing.bench.kernel.chip
    chip.fifo += bytes(5)
    ends_in(balancing, "fifo_misaligned")
    balancing.until(lambda: balancing.row["imu_status"] & 1, 3.0)  # the FIFO was reset while the motors were off
    balancing.session.supervisor.press()
    balancing.until(lambda: balancing.state is State.DISARMED, 1.0)


def test_invalid_quaternion(balancing):
    settled(balancing)
    chip, whole = balancing.bench.kernel.chip, balancing.bench.kernel.chip.sample
    chip.sample = lambda packet, raw: whole(bytes([packet[0] ^ 0x20]) + bytes(packet[1:]), raw)
    ends_in(balancing, "quaternion_invalid")


def test_interrupts_without_data(balancing):
    settled(balancing)
    chip, whole = balancing.bench.kernel.chip, balancing.bench.kernel.chip.sample

    def empty(packet, raw):
        fell = whole(packet, raw)
        chip.fifo.clear()
        return fell

    chip.sample = empty
    ends_in(balancing, "imu_no_data")


def test_different_failures_in_a_row_are_one_fault(balancing):
    settled(balancing)
    chip, whole, turn = balancing.bench.kernel.chip, balancing.bench.kernel.chip.sample, [0]

    def spoil(packet, raw):
        turn[0] += 1
        if turn[0] % 2:
            return whole(bytes([packet[0] ^ 0x20]) + bytes(packet[1:]), raw)
        fell = whole(packet, raw)
        chip.fifo.clear()
        return fell

    chip.sample = spoil
    ends_in(balancing, "imu_bad")


def test_half_of_the_packets_unusable(balancing):
    settled(balancing)
    bus, turn = balancing.bench.kernel.bus, [0]

    def refuse_half(messages):
        turn[0] += 1
        if turn[0] % 8 < 4:  # a refused tick costs two transfers, an undisturbed one makes two
            raise OSError(errno.EREMOTEIO, "injected")

    bus.before = refuse_half
    ends_in(balancing, "imu_unreliable")


@pytest.mark.parametrize(("number", "fault"), [(errno.EIO, "i2c_error"), (errno.ETIMEDOUT, "i2c_timeout")])
def test_dead_bus_names_the_bus(balancing, number, fault):
    """A bus that hangs has already cost a second: there the first tick is enough."""
    settled(balancing)

    def refuse(messages):
        raise OSError(number, "injected")

    balancing.bench.kernel.bus.before = refuse
    ends_in(balancing, fault)


def test_frozen_packets(balancing):
    settled(balancing)
    chip, whole = balancing.bench.kernel.chip, balancing.bench.kernel.chip.sample
    packet = bytes(balancing.bench.world.packet)
    chip.sample = lambda _, raw: whole(packet, raw)
    ends_in(balancing, "imu_frozen")


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_wrong_rate_of_the_interrupts(balancing, factor):
    """A DMP that runs at another rate: every constant of the controller would be wrong."""
    settled(balancing)
    line = balancing.session.devices.imu_line
    whole, first_ns = line.take, line.state["timestamp_ns"][0]

    def stretched():
        count = whole()
        if count:
            line.state["timestamp_ns"] = first_ns + round((line.state["timestamp_ns"][0] - first_ns) * factor)
        return count

    line.take = stretched
    ends_in(balancing, "imu_rate")


def test_lost_packets_are_coasted_over_without_a_jerk(tmp_path):
    """One or two lost samples, while spinning and driving: the command's steps stay those of ordinary driving."""
    with drive(tmp_path, 1.0) as dry:
        dry.until(lambda: dry.session.loop.ticks >= 1600)
        ring = dry.session.ring
        before = np.abs(np.diff(ring.rows["command_feedback"][1200:1600], axis=0)).max(axis=0)
        bus, left = dry.bench.kernel.bus, [0]

        def refuse(messages):
            if left[0]:
                left[0] -= 1
                raise OSError(errno.EREMOTEIO, "injected")

        bus.before = refuse
        for lost in (1, 2):
            for _ in range(10):
                left[0] = 2 * lost  # each tick tries twice
                start = dry.session.loop.ticks
                dry.until(lambda: dry.session.loop.ticks >= start + 25)
                step = np.abs(np.diff(ring.rows["command_feedback"][start - 1 : start + 25], axis=0)).max(axis=0)
                missing = ring.rows["limits"][start : start + lost] & frame.LIMIT_IMU_MISSING
                assert missing.all() and (step < 2.0 * before).all(), (lost, step, before)
        assert dry.state is State.BALANCING


# -- wheels ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("wheel", [0, 1, 2])
def test_dead_encoder(tmp_path, wheel):
    """An unplugged encoder: its count stands still."""
    with drive(tmp_path) as dry:
        dry.until(lambda: dry.session.loop.ticks >= 900)
        stood = int(dry.bench.world.counts[wheel])

        def freeze(counts):
            counts[wheel] = stood
            return counts

        Counts(dry, freeze)
        ends_in(dry, "encoder_static")


def test_wheels_that_do_not_move_under_duty(balancing):
    """All motors unplugged, or the robot held fast: counts stand still while the duties grow."""
    settled(balancing)
    stood = np.array(balancing.bench.world.counts)
    balancing.bench.world.release = lambda: None
    balancing.bench.world.lean_rad = (0.15, 0.0)
    balancing.bench.world.hold()
    Counts(balancing, lambda counts: stood)
    took = balancing.until(lambda: balancing.state is State.FAULT, 3.0)
    assert balancing.session.supervisor.fault.code in ("encoder_static", "saturated") and took < 0.6


@pytest.mark.parametrize("wheel", [0, 1, 2])
def test_reversed_encoder(tmp_path, wheel):
    """A swapped pair of wires: the count runs backwards."""
    with drive(tmp_path) as dry:
        dry.until(lambda: dry.session.loop.ticks >= 900)
        stood = int(dry.bench.world.counts[wheel])

        def reverse(counts):
            counts[wheel] = 2 * stood - counts[wheel]
            return counts

        Counts(dry, reverse)
        ends_in(dry, "encoder_sign")


def test_jumping_encoder(balancing):
    settled(balancing)
    turn = [0]

    def jump(counts):
        turn[0] += 1
        counts[1] += 4000 * (turn[0] % 2)
        return counts

    Counts(balancing, jump)
    ends_in(balancing, "encoder_jump")


def slipping(dry, wheel, counts_per_tick, ticks):
    """The wheel turns by so much more than the ball under it, for so many ticks."""
    extra, left = [0], [ticks]

    def slip(counts):
        if left[0]:
            left[0] -= 1
            extra[0] += counts_per_tick
        counts[wheel] += extra[0]
        return counts

    Counts(dry, slip)


def test_slipping_wheel(balancing):
    settled(balancing)
    slipping(balancing, 0, 30, 1000)
    ends_in(balancing, "wheel_slip")


def test_short_slip_is_masked_and_survived(balancing):
    settled(balancing)
    slipping(balancing, 0, 30, 20)
    before = balancing.session.loop.ticks
    survives(balancing, 2.0)
    rows = balancing.session.ring.rows[before : balancing.session.loop.ticks]
    assert (rows["limits"] & frame.LIMIT_WHEELS_DISAGREE).any()
    assert not rows["limits"][-50:].any() & frame.LIMIT_WHEELS_DISAGREE


def test_lifted_robot(balancing):
    """In the operator's hands: the body stands still whatever the motors do, the wheels run free."""
    settled(balancing)
    world, wiring = balancing.bench.world, balancing.bench.kernel.motor_wiring
    world.release = lambda: None
    world.hold()
    counts = np.array(world.counts, float)
    rate, duty = np.zeros(3), np.zeros(3)
    config = balancing.config
    free = config.motor.nominal_voltage_v / config.motor.torque_constant_n_m_a
    signs, per_turn = np.array(config.encoders.signs), config.encoders.counts_per_turn / (2.0 * math.pi)

    def free_wheels(_):
        wiring.read(duty)
        nonlocal rate, counts
        rate = rate + 0.2 * (free * duty - rate)
        body = np.array(config.wheels.body_from_wheel) @ rate
        body[2] = 0.0  # the ball turns in its socket, not about the vertical
        rate = np.array(config.wheels.body_from_wheel).T @ body
        counts = counts + signs * per_turn * rate * 0.005
        return counts.astype(np.int64)

    Counts(balancing, free_wheels)
    ends_in(balancing, "lifted")


# -- motors, battery, timing --------------------------------------------------------------------------------------------
def test_sustained_saturation(tmp_path):
    """A robot that is held leaning: its motors pull at full voltage in vain."""
    with DryRun(tmp_path, make_config(estimator__shadows="[]", limits__stall_duty_s="10", limits__race_share="2", limits__wheel_mismatch_rad="10")) as dry:
        dry.until(lambda: dry.state is State.BALANCING)
        settled(dry)
        dry.bench.world.release = lambda: None
        dry.bench.world.lean_rad = (0.3, 0.0)
        dry.bench.world.hold()
        dry.until(lambda: dry.row["limits"] & frame.LIMIT_WHEEL_SATURATED, 0.5)
        ends_in(dry, "saturated")
        assert dry.row["limits"] & frame.LIMIT_DRIVE_REDUCED


def test_low_battery_warns_then_slows_then_stops(tmp_path):
    with drive(tmp_path, 0.5) as dry:
        dry.until(lambda: dry.session.loop.ticks >= 1200)
        world = dry.bench.world
        world.set("battery_fade_v_s", 0.0)
        world.set("battery_v", 6.58)
        dry.until(lambda: dry.row["limits"] & frame.LIMIT_BATTERY_WARNING, 5.0)
        assert dry.row["drive_allowed"] == 1.0
        world.set("battery_v", 6.1)
        dry.until(lambda: dry.row["drive_allowed"] < 0.8, 5.0)
        assert dry.state is State.BALANCING and dry.row["limits"] & frame.LIMIT_BATTERY_WARNING and dry.row["limits"] & frame.LIMIT_DRIVE_REDUCED
        world.set("battery_v", 5.4)
        dry.until(lambda: dry.row["drive_allowed"] == 0.0, 5.0)
        took = dry.until(lambda: dry.state is State.FAULT, 5.0)
        assert dry.session.supervisor.fault.code == "battery_low" and 1.5 < took <= FAULTS["battery_low"].bound_s
        truth = world.truth[world.truth_row]
        assert math.hypot(truth.velocity_x_m_s, truth.velocity_y_m_s) < 0.1 and abs(truth.yaw_rate_rad_s) < 1.0  # it stood before it sat down


def test_low_battery_does_not_arm(tmp_path):
    config = make_config(estimator__shadows="[]", dry_run__battery_v="6.3")
    with DryRun(tmp_path, config) as dry:
        dry.run(4.0)
        assert dry.state is State.DISARMED and [refusal.code for refusal in dry.session.refusals if refusal.check.blocks] == ["battery_low"]


def test_overrun(balancing):
    """A loop that makes every fourth tick only."""
    settled(balancing)
    loop, kernel = balancing.session.loop, balancing.bench.kernel
    begin = kernel.monotonic_ns()
    while balancing.state is State.BALANCING and kernel.monotonic_ns() - begin < 3e9:
        kernel.sleep(0.0148)
        loop.tick()
    assert balancing.session.supervisor.fault.code == "overrun"
    assert (kernel.monotonic_ns() - begin) * 1e-9 <= FAULTS["overrun"].bound_s


# -- the numbers themselves ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("where", ["remote", "gyro_bias"])
def test_numbers_that_are_not_finite_stop_the_robot(balancing, where):
    settled(balancing)
    if where == "remote":
        remote = balancing.session.devices.remote
        remote.receive = lambda now_ns: None
        remote.state["heard"], remote.state["frame_ns"], remote.state["wanted"] = 1, balancing.bench.kernel.monotonic_ns(), math.nan
    else:
        balancing.session.robot.gyro_bias_rad_s[0] = math.nan
    ends_in(balancing, "not_finite", 0.01)
    rows = balancing.session.ring.rows[: balancing.session.loop.ticks]
    assert np.isfinite(rows["duty"]).all()


@pytest.mark.parametrize("poison", [math.nan, math.inf, -1.0])
def test_unhealthy_covariance(balancing, poison):
    settled(balancing)
    step = balancing.session.robot.step

    def poisoned(index):
        balancing.session.robot.estimator_states[0].filter.P[5, 5] = poison * 1e6
        return step(index)

    balancing.session.robot.step = poisoned
    took = balancing.until(lambda: balancing.state is State.FAULT, 0.1)
    assert balancing.session.supervisor.fault.code in ("estimator", "not_finite") and took <= 0.025


# -- losing balance while spinning --------------------------------------------------------------------------------------
def test_a_push_while_spinning_takes_the_spin_away_until_calm(tmp_path):
    events = [{"at_s": 2.0, "press": "arm"}, {"at_s": 3.0, "yaw_rate_hz": 1.0}]
    with DryRun(tmp_path, scenario=script(*events)) as dry:
        dry.until(lambda: dry.session.loop.ticks >= 1600)
        assert abs(dry.row["reference_yaw_rad"][1]) > 6.0
        dry.bench.world.state[0].x[5] += 5.0  # a kick against the body
        dry.until(lambda: dry.row["limits"] & frame.LIMIT_SPIN_DOWN, 0.5)
        begin = dry.session.loop.ticks
        dry.until(lambda: not dry.row["limits"] & frame.LIMIT_SPIN_DOWN, 8.0)
        rows = dry.session.ring.rows[begin : dry.session.loop.ticks]
        assert rows["reference_yaw_rad"][:, 1].min() < 5.9
        error = rows["error"][-1]
        assert math.hypot(error[0], error[1]) < 0.075 and math.hypot(error[8], error[9]) < 2.5
        dry.until(lambda: abs(dry.row["reference_yaw_rad"][1]) > 6.0, 5.0)  # the spin comes back by itself
        assert dry.state is State.BALANCING


def test_every_fault_of_the_table_is_injected_by_a_test():
    """A fault without a test is a promise without proof."""
    from pathlib import Path

    text = "".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))
    missing = [code for code in FAULTS if code != "none" and f'"{code}"' not in text]
    assert missing == []
