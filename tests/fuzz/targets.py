"""What is fuzzed: one function of bytes for each parser. It returns where the input was taken or refused as documented, and raises otherwise.

Used by `drive.py` (plain, seeded) and by atheris (coverage-guided), and with the kept corpus by the tests.
"""

import ctypes
import functools
import math
import os
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from mip_rt import config as configuration
from mip_rt import frame
from mip_rt.config import scenario as scenarios
from mip_rt.errors import ConfigError, LogError
from mip_rt.fake.sysfs import FakeSysfs
from mip_rt.hardware.battery import Battery
from mip_rt.hardware.boards import board
from mip_rt.hardware.encoders import Encoder
from mip_rt.hardware.imu_status import IMU_OK
from mip_rt.hardware.mpu9250 import Mpu9250
from mip_rt.log import open as open_log
from mip_rt.remote.command import RemoteCommand
from mip_rt.remote.fourjoy import LONGEST, FourJoyDecoder
from mip_rt.remote.fourjoy import frame as fourjoy_frame
from mip_rt.robots import mbbr_setup

IMU_BITS = 0xFF


@functools.cache
def _config():
    return configuration.load(configuration.default_path("mbbr"))


def config(data: bytes) -> None:
    """A configuration file: loads, or ConfigError; what loads is written out and loads to the same."""
    try:
        loaded = configuration.loads(data.decode("utf-8", "replace"))
    except ConfigError:
        return
    assert configuration.loads(loaded.to_yaml()).as_dict() == loaded.as_dict()


def scenario(data: bytes) -> None:
    """A scenario file, likewise."""
    try:
        loaded = scenarios.loads(data.decode("utf-8", "replace"))
    except ConfigError:
        return
    again = scenarios.loads(loaded.to_yaml())
    assert [event.as_dict() for event in again.events] == [event.as_dict() for event in loaded.events]


class _Port:
    """Gives what it was given, once."""

    data = b""

    def read(self):
        """All of it."""
        data, self.data = self.data, b""
        return data


def serial(data: bytes) -> None:
    """Bytes on the remote's port, in pieces: commands stay finite and within the levels, and after whatever came, good frames are found again
    within three (the terms of test_a_slipped_byte_costs_at_most_three_frames), and then nothing but good frames."""
    settings = _config().remote
    port, decoder = _Port(), FourJoyDecoder()
    remote = RemoteCommand(port, decoder, settings)
    fastest = max(level.drive_limit_m_s for level in settings.levels)
    spin = 2.0 * math.pi * max(abs(level.yaw_rate_hz) for level in settings.levels)
    piece = 1 + data[0] % 64 if data else 1
    for now, at in enumerate(range(0, len(data), piece)):
        port.data = data[at : at + piece]
        remote.receive(now * 5_000_000)
        remote.update(now * 5_000_000)
        x, y, yaw_rate = remote.command
        assert math.hypot(x, y) <= fastest + 1e-9 and abs(yaw_rate) <= spin + 1e-9
    assert decoder.frames * 7 <= len(data) and len(decoder._data) <= LONGEST
    good = fourjoy_frame(0.5, 0.75, 1)
    before = decoder.frames
    decoder.feed(good * 5)
    assert decoder.frames >= before + 2 and decoder.locked
    for _ in range(3):
        assert decoder.feed(good) == 1 and abs(decoder.y - 0.75) < 0.01 and abs(decoder.x - 0.5) < 0.01 and decoder.buttons == 1


class _Bus:
    """An I2C bus whose chip holds these bytes in its FIFO."""

    def __init__(self):
        self.count, self.data = 0, b""
        self.prepare = lambda *messages: messages
        self.transfer = lambda prepared: self.i2c_rdwr(*prepared) or 0

    def i2c_rdwr(self, request, reply):
        """Count, or FIFO; a FIFO that runs out repeats."""
        if reply.len == 2:
            ctypes.memmove(reply.buf, (self.count & 0xFFFF).to_bytes(2, "big"), 2)
            return
        data = self.data or b"\0"
        data = (data * (reply.len // len(data) + 1))[: reply.len]
        ctypes.memmove(reply.buf, data, len(data))


class _Step:
    """Driver and compiled step of one robot, engaged for ever."""

    def __init__(self):
        self.bus = _Bus()
        kernel = SimpleNamespace(open_i2c=lambda bus: self.bus, sleep=lambda seconds: None)
        self.imu = Mpu9250(kernel, _config().imu)
        self.robot = mbbr_setup.build(_config())
        self.layout = self.robot.layout
        self.rows = np.zeros(2, self.layout.dtype)
        self.robot.attach(self.rows)
        self.tick = 0


@functools.cache
def _step():
    return _Step()


def packet(data: bytes) -> None:
    """FIFO contents (and counts, battery, encoders) through the driver and the compiled step: every command is finite and limited.

    byte 0: bit 0 a true count, otherwise bytes 1 and 2 are the count; 3: battery; 4 to 6: encoder counts; the rest is the FIFO.
    """
    s = _step()
    data = data.ljust(8, b"\0")
    s.bus.data = data[7:]
    s.bus.count = len(data) - 7 if data[0] & 1 else data[1] << 8 | data[2]
    index = s.tick % 2
    status = s.imu.read()
    assert 0 < status <= IMU_BITS
    battery_v = math.nan if data[3] < 16 else data[3] / 16.0
    values = {
        "tick": s.tick, "request": frame.REQUEST_ENGAGED, "imu_status": status, "battery_v": battery_v, "remote_age_s": 0.0, "drive_scale": 1.0,
        "encoder_count": [(value - 128) << (8 * (data[0] >> 6)) for value in data[4:7]], "remote_yaw_rate_rad_s": 3.0,
    }  # fmt: skip
    if status & IMU_OK:
        values["imu_packet"] = s.imu.packet
    row = s.rows[index]
    for name, value in values.items():
        row[name] = value
    s.robot.step(index)
    duty = row["duty"]
    assert (abs(duty) <= _config().limits.duty + 1e-9).all(), (duty, row["limits"])
    assert np.abs(row["duty_ns"]).max() <= 1e9 / _config().motor.pwm_frequency_hz + 1
    s.tick += 1


@functools.cache
def _log_path():
    folder = Path("/dev/shm") if Path("/dev/shm").is_dir() else Path(tempfile.gettempdir())
    return folder / f"mip-rt-fuzz-{os.getpid()}.ring"


def log(data: bytes) -> None:
    """A log file: opens, with only whole rows, or LogError."""
    path = _log_path()
    path.write_bytes(data)
    try:
        opened = open_log(path)
    except LogError:
        return
    finally:
        path.unlink()
    ticks = opened.frames["tick"] if "tick" in (opened.frames.dtype.names or ()) else np.zeros(0)
    assert isinstance(opened.damage, list) and (np.diff(ticks) > 0).all()


@functools.cache
def _sysfs():
    root = Path(tempfile.mkdtemp())
    pins = board("beaglebone-black-cape", None)
    sysfs = FakeSysfs(root, pins)
    kernel = SimpleNamespace(path=root.joinpath, sleep=lambda seconds: None)
    encoder = Encoder(kernel, pins.encoders[0])
    encoder.start()
    return sysfs, encoder, Battery(kernel, _config().battery)


def sysfs_text(data: bytes) -> None:
    """The text of a count's and of the battery's file: a count that moves by less than 2^31, a plausible voltage or none."""
    sysfs, encoder, battery = _sysfs()
    sysfs.counts[0].put(data[:4096])
    before = encoder.read()
    after = encoder.read()
    assert isinstance(after, int) and after == before
    sysfs.adc[_config().battery.adc_channel].put(data[:4096])
    low_v, high_v = _config().battery.plausible_v
    volts = battery.read()
    assert math.isnan(volts) or low_v <= volts <= high_v


TARGETS = {target.__name__: target for target in (config, scenario, serial, packet, log, sysfs_text)}
