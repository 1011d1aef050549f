"""The promises of the design, each as a fault on a fake boundary and the time it takes until the motors are off."""

import errno
import math
from types import SimpleNamespace

import pytest
from helpers import DryRun, make_config

from mip_rt import frame
from mip_rt.config.scenario import Event, Scenario
from mip_rt.prearm import CHECKS, failing
from mip_rt.supervisor import State


def script(*events):
    return Scenario("test", "", 10.0, [Event(**event) for event in events])


def fault(dry):
    return dry.session.supervisor.fault.code


def test_never_arms_by_itself(tmp_path):
    with DryRun(tmp_path, scenario=script({"at_s": 0.0, "speed_m_s": [0.2, 0.0], "yaw_rate_hz": 1.0})) as dry:
        dry.run(8.0)
        assert dry.state is State.DISARMED
        assert not dry.session.ring.rows["applied_ns"].any()


def test_does_not_arm_with_a_deflected_stick(tmp_path):
    events = ({"at_s": 0.0, "speed_m_s": [0.2, 0.0]}, {"at_s": 2.0, "press": "arm"})
    with DryRun(tmp_path, scenario=script(*events)) as dry:
        dry.run(5.0)
        assert dry.state is State.DISARMED
        assert "remote_not_centred" in [check.code for check in failing(int(dry.row["refusals"]))]


def test_arming_waits_until_upright(tmp_path):
    config = make_config(estimator__shadows="[]", dry_run__initial_lean_rad="[0.4, 0.0]")
    with DryRun(tmp_path, config=config) as dry:
        dry.run(6.0)
        assert dry.state is State.ARMING and not dry.session.ring.rows["applied_ns"].any()


def test_imu_silence_switches_off_within_50_ms(balancing):
    kernel = balancing.bench.kernel
    kernel.chip.sample = lambda packet, raw: False  # the interrupt line goes dead
    last_edge_ns = int(balancing.row["edge_ns"])
    balancing.until(lambda: not balancing.motors_on(), 0.2)
    assert (kernel.monotonic_ns() - last_edge_ns) * 1e-9 <= 0.050
    assert balancing.state is State.FAULT and fault(balancing) == "imu_silent"


@pytest.mark.parametrize("error", [errno.EREMOTEIO, errno.EIO, errno.ETIMEDOUT])
def test_dead_bus_switches_off_within_50_ms(balancing, error):
    def refuse(messages):
        raise OSError(error, "injected")

    balancing.bench.kernel.bus.before = refuse
    assert balancing.until(lambda: not balancing.motors_on(), 0.2) <= 0.050
    assert fault(balancing) == ("i2c_timeout" if error == errno.ETIMEDOUT else "i2c_error")


def test_one_lost_packet_is_coasted_over(balancing):
    bus, left = balancing.bench.kernel.bus, [2]
    before = abs(balancing.row["duty"]).max()

    def refuse_twice(messages):
        if left[0]:
            left[0] -= 1
            raise OSError(errno.EREMOTEIO, "injected")

    bus.before = refuse_twice
    balancing.session.loop.tick()
    assert balancing.row["limits"] & frame.LIMIT_IMU_MISSING
    assert abs(balancing.row["duty"]).max() < before + 0.3
    assert balancing.until(lambda: balancing.session.loop.ticks % 100 == 0, 1.0) > 0
    assert balancing.state is State.BALANCING


def test_frozen_packets_switch_off(balancing):
    chip, whole = balancing.bench.kernel.chip, balancing.bench.kernel.chip.sample
    packet = bytes(balancing.bench.world.packet)
    chip.sample = lambda _, raw: whole(packet, raw)
    assert balancing.until(lambda: not balancing.motors_on(), 0.5) <= 0.10
    assert fault(balancing) == "imu_frozen"


def test_tip_over_switches_off_within_two_ticks(balancing):
    world = balancing.bench.world
    world.state[0].x[0] = math.radians(75)  # the DMP lags by 5 ms
    assert balancing.until(lambda: balancing.state is State.FAULT, 0.5) <= 0.010 + 1e-9
    assert not balancing.motors_on() and fault(balancing) == "tipped"


def test_lost_remote_stops_the_robot_within_half_a_second(tmp_path):
    events = ({"at_s": 2.0, "press": "arm"}, {"at_s": 4.0, "speed_m_s": [0.2, 0.0], "yaw_rate_hz": 1.0})
    with DryRun(tmp_path, scenario=script(*events)) as dry:
        dry.until(lambda: dry.row["remote_yaw_rate_rad_s"] > 6.0)
        dry.bench.kernel.operator._send = None  # the link stays open, but nothing comes any more
        elapsed = dry.until(lambda: not dry.row["remote_yaw_rate_rad_s"] and not dry.row["remote_velocity_m_s"].any(), 2.0)
        assert elapsed <= 0.5
        assert dry.row["limits"] & frame.LIMIT_REMOTE_LOST
        dry.until(lambda: abs(dry.bench.world.truth[dry.bench.world.truth_row].yaw_rate_rad_s) < 0.3, 8.0)
        assert dry.state is State.BALANCING


def test_rearming_after_a_fall_needs_two_presses_and_starts_fresh(balancing):
    world, supervisor = balancing.bench.world, balancing.session.supervisor
    world.state[0].x[0] = math.radians(60)
    balancing.until(lambda: balancing.state is State.FAULT, 0.5)
    supervisor.press()
    with pytest.raises(AssertionError, match="nothing happened"):  # still lying: the button does nothing
        balancing.until(lambda: balancing.state is not State.FAULT, 1.0)
    world.hold()
    world.state[0].x[3:5] = 1.0
    supervisor.press()
    balancing.until(lambda: balancing.state is State.DISARMED, 1.0)
    supervisor.press()
    balancing.until(lambda: balancing.state is State.BALANCING, 2.0)
    balancing.until(lambda: balancing.row["request"] & frame.REQUEST_ENGAGED, 0.1)
    assert not balancing.row["reference_lean_rad"].any() or abs(balancing.row["reference_lean_rad"]).max() < 0.05
    assert abs(balancing.row["estimates"][0, 8:]).max() < 0.2
    balancing.until(lambda: balancing.session.loop.ticks % 400 == 0, 3.0)
    assert balancing.state is State.BALANCING


def test_refused_pwm_write_is_a_fault(balancing):
    import os

    channel = balancing.session.devices.motors._pwm[1]
    readable = os.open(channel.folder / "duty_cycle", os.O_RDONLY)
    os.dup2(readable, channel._fd)  # writing to it now fails with EBADF
    os.close(readable)
    balancing.until(lambda: balancing.state is State.FAULT, 0.2)
    assert fault(balancing) == "motor_write" and not balancing.session.devices.motors.enabled


@pytest.mark.parametrize("reading", ["0\n", "garbage\n", "\n", "4095\n"])
def test_implausible_battery_is_no_divisor(balancing, reading):
    kernel = balancing.bench.kernel
    kernel.motor_wiring.show_battery = lambda raw: None
    kernel.sysfs.adc[balancing.config.battery.adc_channel].put(reading.encode())
    balancing.until(lambda: balancing.row["limits"] & frame.LIMIT_BATTERY_UNKNOWN, 1.0)
    balancing.until(lambda: balancing.session.loop.ticks % 200 == 0, 2.0)
    assert balancing.state is State.BALANCING and math.isnan(balancing.session.devices.battery_v)
    assert abs(balancing.row["duty"]).max() <= 1.0


def test_encoder_jump_is_masked_not_believed(balancing):
    wiring = balancing.bench.kernel.motor_wiring
    whole, wiring.show_encoders = wiring.show_encoders, lambda counts: whole(counts + [0, 5000, 0])
    balancing.session.loop.tick()
    assert balancing.row["limits"] & frame.LIMIT_ENCODER_JUMP
    balancing.until(lambda: balancing.session.loop.ticks % 200 == 0, 2.0)
    assert balancing.state is State.BALANCING and not balancing.row["limits"] & frame.LIMIT_ENCODER_JUMP


def test_serial_garbage_never_moves_the_robot(balancing):
    import random

    source = random.Random(7)
    balancing.bench.kernel.operator._send = lambda *_: balancing.bench.remote.send_bytes(
        bytes(source.randrange(1, 256) for _ in range(20))
    )
    balancing.until(lambda: balancing.session.loop.ticks % 400 == 0, 3.0)
    assert balancing.state is State.BALANCING


def test_motors_are_off_after_an_exception(tmp_path):
    with DryRun(tmp_path) as dry:
        dry.until(lambda: dry.state is State.BALANCING)
        dry.session.robot.step = lambda index: 1 / 0
        with pytest.raises(ZeroDivisionError):
            dry.run(1.0)
        assert not dry.motors_on() and not dry.session.devices.motors.enabled


class FakeMotors(SimpleNamespace):
    """Remembers what was written."""

    def __init__(self):
        super().__init__(written=[], enabled=False)

    def write(self, duty):
        self.written.append(duty)
        return True

    def enable(self):
        self.enabled = True
        return True

    def off(self):
        self.enabled = False


@pytest.mark.parametrize("state", [state for state in State if state is not State.BALANCING])
def test_no_duty_leaves_the_supervisor_outside_balancing(state):
    from mip_rt.supervisor import Condition, Supervisor

    motors = FakeMotors()
    supervisor = Supervisor(motors, make_config().limits, 0.005, 0.3)
    supervisor.state = state
    supervisor.refusals = CHECKS["battery_low"].bit
    for tick in range(3):
        assert supervisor.apply(tick, Condition.IMU_GOOD, True, 0) is False
    assert motors.written == [] and not motors.enabled
