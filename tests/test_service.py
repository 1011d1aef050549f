"""What systemd hears: readiness after good ticks only, pings from the loop only, and the state in words."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mip_rt import service
from mip_rt.hardware.imu_status import IMU_NO_DATA, IMU_OK

ROOT = Path(__file__).parents[1]


@pytest.fixture
def manager(tmp_path):
    """systemd's end of the notification socket."""
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listening.bind(str(tmp_path / "notify"))
    listening.settimeout(30.0)
    yield listening
    listening.close()


def heard(listening):
    """All that has arrived, line by line."""
    listening.setblocking(False)
    lines = []
    while True:
        try:
            lines += listening.recv(4096).decode().split("\n")
        except BlockingIOError:
            return lines


class Turning:
    """A session that turns, 5 ms a tick."""

    def __init__(self):
        self.now_ns = 0
        self.kernel = SimpleNamespace(monotonic_ns=lambda: self.now_ns)
        self.loop = SimpleNamespace(ticks=0)
        self.ring = SimpleNamespace(capacity=8, rows=np.zeros(8, [("imu_status", "<i8")]))

    def condition(self):
        return "DISARMED  not armed: the robot moves. Hold it still."

    def turn(self, unit, status=IMU_OK, ticked=True):
        self.now_ns += 5_000_000
        if ticked:
            self.ring.rows["imu_status"][self.loop.ticks % 8] = status
            self.loop.ticks += 1
        unit.turn(self, ticked)


def test_ready_only_after_200_good_ticks_in_a_row(manager, tmp_path):
    """Prevents a unit that counts as started while IMU, bus or DMP do not work."""
    unit, session = service.Service(str(tmp_path / "notify"), 1.0), Turning()
    for _ in range(199):
        session.turn(unit)
    session.turn(unit, IMU_NO_DATA)
    for _ in range(100):
        session.turn(unit)
    session.turn(unit, ticked=False)
    for _ in range(199):
        session.turn(unit)
    assert not unit.ready and "READY=1" not in heard(manager)
    session.turn(unit)
    assert unit.ready and heard(manager).count("READY=1") == 1


def test_pings_come_from_turns_at_well_under_half_the_limit(manager, tmp_path):
    """Prevents a kill by a watchdog that was pinged too rarely, and a ping that does not need the loop."""
    unit, session, pings = service.Service(str(tmp_path / "notify"), 1.0), Turning(), 0
    for _ in range(400):
        session.turn(unit)
        lines = heard(manager)
        pings += lines.count("WATCHDOG=1")
        for line in lines:
            assert not line.startswith("STATUS=") or line == "STATUS=DISARMED  not armed: the robot moves. Hold it still."
    assert pings == 5  # every 0.4 s of 2 s
    time.sleep(0.5)
    assert heard(manager) == []


def test_a_manager_that_is_gone_does_not_disturb(tmp_path):
    """Prevents an exception or a wait in the loop when systemd's socket is gone or full."""
    unit, session = service.Service(str(tmp_path / "nowhere"), 1.0), Turning()
    for _ in range(300):
        session.turn(unit)
    assert unit.lost >= 4
    unit.close()


@pytest.mark.parametrize(
    ("environment", "every_s"),
    [
        ({}, None),
        ({"NOTIFY_SOCKET": ""}, None),
        ({"NOTIFY_SOCKET": "relative"}, None),
        ({"NOTIFY_SOCKET": "/run/x"}, 1.0),
        ({"NOTIFY_SOCKET": "@abstract", "WATCHDOG_USEC": "1000000"}, 0.4),
        ({"NOTIFY_SOCKET": "/run/x", "WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}, 1.0),
        ({"NOTIFY_SOCKET": "/run/x", "WATCHDOG_USEC": "never"}, 1.0),
    ],
)
def test_environment(monkeypatch, environment, every_s):
    """Prevents notifications of a run that is no service, and pings meant for another process."""
    for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    unit = service.from_environment()
    assert (unit is None) == (every_s is None)
    if unit:
        assert unit._every_ns == every_s * 1e9
        unit._socket.close()


def test_a_run_under_systemd_reports_and_is_silent_in_the_journal(manager, tmp_path):
    """The whole program as a unit: STATUS while loading, READY, pings, STOPPING; no status lines on standard error."""
    environment = {**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "1000000"}
    process = subprocess.Popen(
        [sys.executable, "-m", "mip_rt", "--dry-run", "--duration", "60", "--log", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment,
    )  # fmt: skip
    lines, last_ping = [], None
    while "READY=1" not in lines or time.monotonic() < enough:
        lines += manager.recv(4096).decode().split("\n")
        if "WATCHDOG=1" in lines[-2:]:
            now = time.monotonic()
            assert last_ping is None or now - last_ping < 1.0
            last_ping = now
        if "READY=1" in lines[-2:]:
            enough = time.monotonic() + 1.5
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=20)
    lines += heard(manager)
    assert process.returncode == 0 and "ticks" in output
    assert lines[0].startswith("STATUS=loading") and lines[-1] == "STOPPING=1"
    assert any(line.startswith(("STATUS=CALIBRATING", "STATUS=DISARMED")) for line in lines)
    assert len(errors.splitlines()) <= 4, errors
