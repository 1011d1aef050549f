"""What the whole session makes of its guard, on virtual time; and every orderly or disorderly way out of a run."""

import os

import pytest
from helpers import DryRun

from mip_rt import session
from mip_rt.hardware.boards import GPIO
from mip_rt.supervisor import State


@pytest.fixture
def balancing(tmp_path):
    with DryRun(tmp_path) as dry:
        dry.until(lambda: dry.state is State.BALANCING)
        dry.until(lambda: dry.motors_on(), 1.0)
        yield dry


def fault(dry):
    return dry.session.supervisor.fault.code


def enable_line(dry):
    machine = dry.bench.machine
    bank, offset = machine.pins.enable
    return machine.gpio.line_value(GPIO[bank], offset)


def duties(dry):
    machine = dry.bench.machine
    return [machine.sysfs.duty_ns(*machine.pins.motors[channel].pwm) for channel in dry.config.motors.channels]


def test_a_standstill_of_the_loop_drops_the_line_and_is_a_fault(balancing):
    """Prevents motors that run on while the loop is blocked, and a robot that drives on when the loop comes back."""
    kernel = balancing.bench.kernel
    kernel.sleep(0.045)
    assert enable_line(balancing) == 1
    kernel.sleep(0.025)  # the world goes on, the loop does not: 70 ms since the tick
    assert enable_line(balancing) == 0
    balancing.session.loop.tick()
    assert balancing.state is State.FAULT and fault(balancing) == "guard_dropped"
    assert duties(balancing) == [0, 0, 0] and not balancing.session.devices.motors.enabled


def test_a_short_standstill_is_no_fault(balancing):
    """Prevents false alarms: two lost ticks, and a silent IMU's wait, are shorter than the guard's limit."""
    for _ in range(3):
        balancing.bench.kernel.sleep(0.02)
        for _ in range(20):
            balancing.session.loop.tick()
    assert balancing.state is State.BALANCING


def test_after_a_drop_only_the_whole_gesture_arms_again(balancing):
    """Prevents re-arming by one press, or without asking the guard anew."""
    balancing.bench.kernel.sleep(0.1)
    balancing.session.loop.tick()
    supervisor, world = balancing.session.supervisor, balancing.bench.world
    world.hold()
    balancing.until(lambda: balancing.session.loop.ticks % 100 == 0, 1.0)
    assert balancing.state is State.FAULT
    supervisor.press()
    balancing.until(lambda: balancing.state is State.DISARMED, 1.0)
    balancing.until(lambda: not balancing.session.refusals, 2.0)  # the standstill has left the window in which the rate is measured
    assert balancing.state is State.DISARMED
    supervisor.press()
    balancing.until(lambda: balancing.state is State.BALANCING, 2.0)
    balancing.until(lambda: balancing.motors_on(), 0.1)
    balancing.until(lambda: balancing.session.loop.ticks % 200 == 0, 2.0)
    assert balancing.state is State.BALANCING and enable_line(balancing) == 1


def test_a_lost_guard_is_a_fault_that_the_button_cannot_acknowledge(balancing):
    """Prevents balancing, and arming again, without a guard."""
    balancing.bench.guard.kill()
    assert enable_line(balancing) == 0
    assert balancing.until(lambda: balancing.state is State.FAULT, 0.2) <= 0.07
    assert fault(balancing) == "guard_lost" and duties(balancing) == [0, 0, 0]
    balancing.bench.world.hold()
    balancing.session.supervisor.press()
    balancing.until(lambda: balancing.session.loop.ticks % 100 == 0, 1.0)
    assert balancing.state is State.FAULT and enable_line(balancing) == 0


class Ends:
    """Called between ticks: ends the run in its way while the robot balances."""

    def __init__(self, how, stop):
        self._how, self._stop = how, stop

    def update(self, running):
        if running.supervisor.state is not State.BALANCING or running.supervisor.drive_scale < 1.0:
            return
        if self._how == "stop":
            self._stop.requested = True
        elif self._how == "exception in the tick":
            running.robot.step = lambda index: 1 / 0
        elif self._how == "Ctrl-C":
            raise KeyboardInterrupt
        elif self._how == "exit":
            raise SystemExit(1)
        elif self._how == "motor write refused":
            channel = running.devices.motors._pwm[0]
            readable = os.open(channel.folder / "duty_cycle", os.O_RDONLY)
            os.dup2(readable, channel._fd)  # writing to it now fails with EBADF
            os.close(readable)


@pytest.mark.parametrize("how", ["return", "stop", "exception in the tick", "Ctrl-C", "exit", "motor write refused"])
def test_every_way_out_leaves_duty_0_and_the_line_low(tmp_path, how):
    """Prevents a way out of the run that forgets the motors."""
    with DryRun(tmp_path) as dry:
        stop = session.Stop()
        raised = {"exception in the tick": ZeroDivisionError, "Ctrl-C": KeyboardInterrupt, "exit": SystemExit}.get(how)
        kernel = dry.bench.kernel
        seen = []
        whole = kernel.motor_wiring.read
        kernel.motor_wiring.read = lambda duty: seen.append(whole(duty)) or seen[-1]
        try:
            dry.session.run(4.0, stop, Ends(how, stop), False)
        except BaseException as error:  # noqa: BLE001  (SystemExit and KeyboardInterrupt are among them)
            assert raised is not None and isinstance(error, raised)
        else:
            assert raised is None
        assert any(seen), "the motors never ran, so this proves nothing"
        assert enable_line(dry) == 0
        if how == "motor write refused":
            assert duties(dry)[1:] == [0, 0] and fault(dry) == "motor_write"
        else:
            assert duties(dry) == [0, 0, 0]
