"""The inputs of a tick: every field is written with what its driver found, and nothing else of the row."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import make_config

from mip_rt import frame, guard_words, inputs
from mip_rt.compiled import JIT_DISABLED
from mip_rt.guard_client import GuardClient
from mip_rt.hardware import compiled_io, line_events
from mip_rt.hardware.imu_status import IMU_BAD_NORM, IMU_OK
from mip_rt.remote.command import RemoteCommand
from mip_rt.remote.fourjoy import FourJoyDecoder
from mip_rt.robots.mbbr_frame import LAYOUT

pytestmark = pytest.mark.armhf
MS = 1_000_000
BEGIN_NS = 7_000_000_000


class Tick:
    """Drivers that have found something, and three rows; `gather(...)` as the loop calls it."""

    def __init__(self):
        line, counters = np.zeros(1, line_events.STATE), compiled_io.records(compiled_io.COUNTERS, 3)
        line["timestamp_ns"], line["count"], counters["count"][0, :3] = BEGIN_NS, 3, (5, -6, 1 << 40)
        self.words = memoryview(bytearray(guard_words.WORDS_BYTES)).cast("I")
        self.guard = GuardClient(self.words, 0.06)
        self.words[guard_words.GUARD_BEAT] = guard_words.stamp(BEGIN_NS)
        self.remote = RemoteCommand(SimpleNamespace(read=bytes), FourJoyDecoder(), make_config().remote)
        self.packet = np.arange(32, dtype=np.uint8)
        devices = SimpleNamespace(
            imu_line=SimpleNamespace(state=line), counters=counters, imu=SimpleNamespace(packet=self.packet), remote=self.remote, guard=self.guard
        )
        self.rows = np.zeros(3, LAYOUT.dtype)
        self.rows["sequence"] = 77
        robot = SimpleNamespace(
            layout=LAYOUT, rows=self.rows.view(np.recarray) if JIT_DISABLED else self.rows, gyro_bias_rad_s=np.array([0.1, -0.2, 0.3])
        )
        self._gather = inputs.gatherer(devices, robot)

    def gather(self, status=IMU_OK, wake_ns=BEGIN_NS + MS, read_ns=BEGIN_NS + 2 * MS):
        return self._gather(1, 1234, wake_ns, read_ns, 4, frame.REQUEST_ENGAGED, 9, status, 2, 7.4, 0.25)


def test_every_input_is_written_and_nothing_else():
    tick = Tick()
    tick.remote.state["heard"], tick.remote.state["frame_ns"], tick.remote.state["wanted"] = 1, BEGIN_NS, (0.1, 0.2, 3.0)
    assert tick.gather() == guard_words.OK
    row = tick.rows[1]
    expected = {
        "tick": 1234, "edge_ns": BEGIN_NS, "wake_ns": BEGIN_NS + MS, "read_ns": BEGIN_NS + 2 * MS, "missed": 2, "state": 4,
        "request": frame.REQUEST_ENGAGED, "refusals": 9, "imu_status": IMU_OK, "imu_backlog": 2, "battery_v": 7.4, "drive_scale": 0.25,
        "remote_velocity_m_s": [0.1, 0.2], "remote_yaw_rate_rad_s": 3.0, "remote_age_s": 1e-3, "gyro_bias_rad_s": [0.1, -0.2, 0.3],
        "encoder_count": [5, -6, 1 << 40], "imu_packet": list(range(32)),
    }  # fmt: skip
    assert set(expected) == set(LAYOUT.step_inputs), "an input is not written"
    for name, value in expected.items():
        assert np.array_equal(row[name], value), name
        row[name] = 0
    assert row["sequence"] == 77 and not any(np.any(row[name]) for name in LAYOUT.dtype.names if name != "sequence")
    assert not any(np.any(tick.rows[name][[0, 2]]) for name in LAYOUT.dtype.names if name != "sequence")


def test_a_packet_that_is_not_good_does_not_reach_the_row():
    tick = Tick()
    tick.gather(IMU_BAD_NORM)
    assert not tick.rows[1]["imu_packet"].any() and tick.rows[1]["imu_status"] == IMU_BAD_NORM


def test_a_silent_remote_is_told_and_its_command_taken_away():
    tick = Tick()
    tick.remote.state["heard"], tick.remote.state["frame_ns"], tick.remote.state["wanted"] = 1, BEGIN_NS, (0.1, 0.2, 3.0)
    assert tick.gather() == guard_words.OK
    silent_ns = BEGIN_NS + round((make_config().remote.timeout_s + make_config().remote.ramp_s) * 1e9) + MS
    tick.words[guard_words.GUARD_BEAT] = guard_words.stamp(silent_ns)
    assert tick.gather(wake_ns=silent_ns, read_ns=silent_ns) == guard_words.OK | inputs.REMOTE_LOST
    assert not tick.rows[1]["remote_velocity_m_s"].any() and tick.rows[1]["remote_yaw_rate_rad_s"] == 0.0 and tick.remote.losses == 1
    never = Tick()
    assert never.gather() == guard_words.OK | inputs.REMOTE_LOST and math.isinf(never.rows[1]["remote_age_s"])


def test_the_heartbeat_and_what_the_guard_answers():
    """The same decision as GuardClient.beat, on the same words."""
    tick = Tick()
    tick.gather()
    assert tick.words[guard_words.BEAT] == guard_words.stamp(BEGIN_NS + 2 * MS)
    tick.guard.set(True)
    tick.words[guard_words.DROPPED] = tick.words[guard_words.REQUEST]
    assert tick.gather() & inputs.GUARD == guard_words.LINE_DROPPED == tick.guard.status
    assert tick.gather(read_ns=BEGIN_NS + 62 * MS) & inputs.GUARD == guard_words.LOST
    tick.words[guard_words.GUARD_BEAT] = guard_words.stamp(BEGIN_NS + 63 * MS)
    assert tick.gather(read_ns=BEGIN_NS + 63 * MS) & inputs.GUARD == guard_words.LOST, "lost is for ever"
