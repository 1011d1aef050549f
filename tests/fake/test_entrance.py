"""A dry run's second way in: what comes through it reaches the robot by pty and button only, and gives way again."""

import os
import socket

import pytest
from helpers import DryRun

from mip_rt import log
from mip_rt.config.scenario import Event, Scenario
from mip_rt.fake.entrance import MOST, QUIET_S, Entrance
from mip_rt.remote.fourjoy import CIRCLE, frame
from mip_rt.supervisor import State


class Person:
    """Stands at the entrance of a dry run on virtual time."""

    def __init__(self, dry, folder):
        bench = dry.bench
        self.entrance = bench.kernel.entrance = Entrance(folder / "entrance", bench.kernel.operator, bench.remote.send_bytes)
        self._out = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)

    def do(self, message):
        self._out.sendto(message, os.fspath(self.entrance.path))


@pytest.fixture
def alone(tmp_path):
    """A dry run whose script does nothing; (dry, person)."""
    with DryRun(tmp_path, scenario=Scenario("test", "", 60.0, [])) as dry:
        yield dry, Person(dry, tmp_path)


def test_arms_drives_and_disarms(alone):
    dry, person = alone
    dry.until(lambda: dry.state is State.DISARMED and not dry.session.supervisor.refusals)
    person.do(b"arm")
    dry.until(lambda: dry.state is State.BALANCING, 2.0)

    def drive():
        person.do(b"remote " + frame(0.0, 0.8, CIRCLE))
        return dry.row["estimates"][0, 5] > 4.0

    dry.until(drive, 5.0)
    assert dry.row["remote_velocity_m_s"][0] == pytest.approx(0.8 * 0.25, rel=0.01)
    person.do(b"arm")
    dry.until(lambda: dry.state is State.DISARMED, 0.1)


def test_the_script_is_silent_while_a_phone_sends_and_speaks_again(tmp_path):
    """Two senders in turn would make the robot shake between two commands."""
    script = Scenario("test", "", 60.0, [Event(at_s=0.5, speed_m_s=[0.2, 0.0], yaw_rate_hz=0.0)])
    with DryRun(tmp_path, scenario=script) as dry:
        person = Person(dry, tmp_path)
        dry.until(lambda: dry.row["remote_velocity_m_s"][0] > 0.19, 2.0)
        seen = set()

        def send():
            person.do(b"remote " + frame(0.0, -0.5))
            seen.add(round(float(dry.row["remote_velocity_m_s"][0]), 3))
            return dry.bench.kernel.world.samples > 1000

        dry.until(send, 6.0)
        stick = round(-64 / 127 * 0.25, 3)
        assert seen <= {0.2, 0.201, stick} and stick in seen
        passed = dry.until(lambda: dry.row["remote_velocity_m_s"][0] > 0.19, 1.0)
        assert passed == pytest.approx(QUIET_S, abs=0.1)


def test_hold_keeps_even_a_balancing_robot_and_release_lets_it_fall(alone):
    dry, person = alone
    dry.until(lambda: dry.state is State.DISARMED and not dry.session.supervisor.refusals)
    person.do(b"arm")
    dry.until(lambda: dry.state is State.BALANCING and dry.motors_on(), 2.0)
    world = dry.bench.world
    person.do(b"hold")
    dry.until(lambda: world.held, 0.1)
    for _ in range(100):
        dry.session.loop.tick()
    assert world.held
    person.do(b"arm")
    dry.until(lambda: dry.state is not State.BALANCING, 0.2)
    person.do(b"release")
    dry.until(lambda: abs(dry.row["attitude_rad"][0]) > 1.0 or abs(dry.row["attitude_rad"][1]) > 1.0, 5.0)


def test_nonsense_and_floods_are_refused_without_holding_up_the_world(alone):
    dry, person = alone
    dry.until(lambda: dry.state is State.DISARMED)
    for message in (b"", b"remote", b"remote ", b"arm now", b"\x00" * 200, b"x" * 300):
        person.do(message)
        dry.until(lambda: True)
        dry.session.loop.tick()
    assert person.entrance.refused >= 4
    person._out.setblocking(False)
    sent = 0
    try:
        while sent < 10000:
            person.do(b"nonsense")
            sent += 1
    except BlockingIOError:
        pass
    before = person.entrance.refused
    dry.session.loop.tick()
    assert person.entrance.refused - before <= MOST
    assert dry.state is State.DISARMED


def test_no_entrance_on_virtual_time(tmp_path):
    """A run as fast as possible must depend on its seed alone."""
    with DryRun(tmp_path) as dry:
        assert dry.bench.kernel.entrance is None and "remote_entrance" not in log.open(dry.session.ring.path).header
