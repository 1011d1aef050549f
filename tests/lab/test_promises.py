"""The judges themselves: each promise, broken on purpose, is seen; a whole run is not accused."""

import copy

import numpy as np
import pytest
from helpers import make_config

from mip_rt.config.scenario import Event, Scenario
from mip_rt.lab import soak_run
from mip_rt.lab.observation import nearly, norm_is_one
from mip_rt.lab.promises import broken
from mip_rt.supervisor import State

CONFIG = soak_run.configured({})
EVENTS = [Event(2.0, press="arm"), Event(4.0, 0.5, [0.1, 0.0]), Event(6.0, fault="imu_silent", parameters={"for_s": 0.3}),
          Event(7.0, 0.0, [0.0, 0.0]), Event(7.3, press="recover")]  # fmt: skip
SCRIPT = Scenario("judged", "", 12.0, EVENTS)


@pytest.fixture(scope="module")
def run():
    seen, unclean = soak_run.observe(CONFIG, SCRIPT, 1, 12.0)
    assert unclean == []
    return seen


def named(seen):
    return {entry.promise for entry in broken(seen, CONFIG)}


def test_a_good_run_is_not_accused(run):
    assert named(run) == set() and soak_run.false_alarms(run) == [] and soak_run.ends_balancing(run, CONFIG) == []
    (reaction,) = soak_run.reactions(run)
    assert reaction.codes[0] == "imu_silent" and 0.02 < reaction.off_s <= 0.05


def at(seconds):
    return round(seconds / 0.005)


def _enabled_without_imu(seen):
    seen.enabled[at(6.0) : at(6.2)] = True


def _enabled_when_tipped(seen):
    half = np.array([0.86, 0.5, 0.0, 0.0]) / np.hypot(0.86, 0.5)
    seen.packet[at(9.5), :16] = np.frombuffer((half * (1 << 30)).astype(">i4").tobytes(), np.uint8)


def _enabled_when_lying(seen):
    seen.lean_rad[at(9.5) : at(10.0)] = 1.3


def _remote_goes_on(seen):
    seen.bytes_sent = seen.bytes_sent[seen.bytes_sent < at(4.5)]


def _remote_too_fast(seen):
    seen.rows["remote_velocity_m_s"][500] = (0.3, 0.0)


def _remote_not_a_number(seen):
    seen.rows["remote_yaw_rate_rad_s"][500] = np.nan


def _arms_by_itself(seen):
    seen.presses = seen.presses[1:]


def _arms_after_one_press(seen):
    seen.presses = np.delete(seen.presses, 1)


def _not_finite(seen):
    seen.rows["duty"][700, 1] = np.nan


def _too_much(seen):
    seen.rows["applied_ns"][700, 1] = 60_000


def _too_much_at_the_driver(seen):
    seen.duty[at(9.0)] = 1.2


def _enabled_in_fault(seen):
    row = int(np.flatnonzero(seen.rows["state"] == State.FAULT)[5])
    seen.enabled[seen.rows["sample"][row]] = True


def _hangs_enabled(seen):
    seen.stalled = [(at(4.5), at(5.0))]


@pytest.mark.parametrize("damage, promise", [
    (_hangs_enabled, "hung"),
    (_enabled_without_imu, "imu lost"), (_enabled_when_tipped, "tipped"), (_enabled_when_lying, "tipped"), (_remote_goes_on, "remote silent"),
    (_remote_too_fast, "remote silent"), (_remote_not_a_number, "remote silent"), (_arms_by_itself, "gesture"), (_arms_after_one_press, "gesture"),
    (_not_finite, "duty"), (_too_much, "duty"), (_too_much_at_the_driver, "duty"), (_enabled_in_fault, "off"),
])  # fmt: skip
def test_each_broken_promise_is_seen(run, damage, promise):
    seen = copy.copy(run)
    for name in ("enabled", "packet", "lean_rad", "duty"):
        setattr(seen, name, getattr(run, name).copy())
    seen.rows = {name: values.copy() for name, values in run.rows.items()}
    damage(seen)
    assert promise in named(seen)


@pytest.mark.parametrize("slower, fault, promise", [
    ({"limits.imu_silence_s": 0.09, "limits.guard_timeout_s": 0.1}, "imu_silent", "imu lost"),
    ({"limits.tip_rad": 1.3}, "tipped_over", "tipped"),
    ({"remote.timeout_s": 0.8}, "serial_silent", "remote silent"),
    ({"limits.guard_timeout_s": 0.2}, "cpu_hung", "hung"),
])  # fmt: skip
def test_a_controller_that_reacts_late_is_caught(slower, fault, promise):
    """The whole way: a robot that is set to react later than promised (no configuration file may say so) is judged by the promise."""
    config = make_config(estimator__shadows="[]")
    for key, value in slower.items():
        section, name = key.split(".")
        vars(getattr(config, section))[name] = value
    events = [Event(2.0, press="arm"), Event(3.3, 0.5, [0.1, 0.0]), Event(5.0, fault=fault, parameters={})]
    seen, _ = soak_run.observe(config, Scenario("late", "", 6.5, events), 1, 6.5)
    assert promise in named(seen)


def test_a_controller_that_raises_is_caught(monkeypatch):
    from mip_rt.remote.command import RemoteCommand

    monkeypatch.setattr(RemoteCommand, "heading_reset", lambda self: 1 / 0)
    result = soak_run.run(CONFIG, SCRIPT, 1, 12.0, True)
    assert result["broken"][0].promise == "clean exit" and "ZeroDivisionError" in result["broken"][0].sentence


@pytest.mark.parametrize("begin_s", [5.0, 5.005, 5.01, 5.015])
def test_what_waited_in_the_port_while_the_loop_hung_counts_when_it_is_read(begin_s):
    events = [
        Event(2.0, press="arm"), Event(3.3, 0.0, [0.0, -0.1]), Event(begin_s, fault="cpu_hung", parameters={"stall_s": 0.494}),
        Event(begin_s + 0.023, fault="serial_silent", parameters={"for_s": 1.3}),
    ]  # fmt: skip
    seen, _ = soak_run.observe(CONFIG, Scenario("waited", "", 7.0, events), 1, 7.0)
    assert named(seen) == set()


@pytest.mark.parametrize("begin_s", [5.0, 5.005, 5.01])
@pytest.mark.parametrize("later_s", [0.02, 0.027, 0.05])
def test_a_press_made_while_the_loop_hung_is_a_press(begin_s, later_s):
    events = [
        Event(2.0, press="arm"), Event(3.3, 0.0, [0.0, -0.1]), Event(begin_s, fault="cpu_hung", parameters={"stall_s": 0.3585}),
        Event(begin_s + later_s, press="disarm"), Event(7.0, 0.0, [0.0, 0.0]), Event(7.3, press="recover"),
    ]  # fmt: skip
    seen, _ = soak_run.observe(CONFIG, Scenario("pressed", "", 10.0, events), 1, 10.0)
    assert named(seen) == set() and seen.enabled[at(9.5)]


@pytest.mark.parametrize("begin_s", [5.0, 5.005, 5.01, 5.015])
def test_the_remote_is_heard_while_the_imu_is_silent(begin_s):
    """Otherwise its last bytes would be read, and look new, when the IMU is there again."""
    events = [
        Event(2.0, press="arm"), Event(3.3, 0.0, [0.0, -0.1]), Event(begin_s, fault="imu_silent", parameters={"for_s": 0.7146}),
        Event(begin_s + 0.54, fault="serial_silent", parameters={"for_s": 1.3}),
    ]  # fmt: skip
    seen, _ = soak_run.observe(CONFIG, Scenario("both silent", "", 7.5, events), 1, 7.5)
    assert named(seen) == set()


def test_a_fault_that_nothing_explains_is_a_false_alarm(monkeypatch):
    from mip_rt.hardware.imu_status import IMU_FROZEN
    from mip_rt.loop import Loop

    init = Loop.__init__

    def lying(self, *arguments):
        init(self, *arguments)
        sense = self._sense
        self._sense = lambda index: IMU_FROZEN if self.ticks == 900 and sense(index) else sense(index)

    monkeypatch.setattr(Loop, "__init__", lying)
    events = [Event(2.0, press="arm"), Event(4.0, fault="serial_split", parameters={})]
    result = soak_run.run(CONFIG, Scenario("quiet", "", 6.0, events), 1, 6.0, False)
    assert [code for _, code in result["false_alarms"]] == ["imu_frozen", "fell"]


def test_a_packet_with_a_few_wrong_bits_was_delivered():
    """No checksum tells the driver of them, so the promise of the lost IMU cannot; seed 2062 was accused for it."""
    packet = bytes.fromhex("40000000 00000000 00000000 00000000") + bytes(range(16))
    assert nearly(packet, packet) and norm_is_one(packet)
    flipped = bytearray(packet)
    for place in (5, 17, 18, 20, 25, 30):
        flipped[place] ^= 0x04
    assert nearly(packet, flipped) and norm_is_one(flipped)
    assert not nearly(packet, bytes(32)[:16] + bytes(range(1, 17)))
    flipped[0] ^= 0x40  # the largest bit of the quaternion: that the driver can tell
    assert nearly(packet, flipped) and not norm_is_one(flipped)


def test_flipping_bits_accuse_nobody_while_packets_come():
    events = [Event(2.0, press="arm"), Event(4.0, fault="i2c_bit_flips", parameters={"for_s": 1.5, "probability": 0.3, "burst": 2, "bits": 1})]
    seen, unclean = soak_run.observe(CONFIG, Scenario("flips", "", 6.5, events), 3, 6.5)
    assert unclean == [] and broken(seen, CONFIG) == [] and (~seen.delivered[at(4.2) : at(5.2)]).any()
