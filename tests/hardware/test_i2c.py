"""Prepared transfers hand the kernel what smbus2 would hand it, and the same structure every time."""

import ctypes
import errno

import pytest
from smbus2 import i2c_msg
from smbus2.smbus2 import i2c_rdwr_ioctl_data

from mip_rt.hardware import i2c


@pytest.fixture
def bus(monkeypatch, tmp_path):
    """A bus whose device is a plain file, which answers no ioctl; `bus.seen` lists what `answering` was given: (addr, flags, len) by message."""
    device = tmp_path / "i2c-2"
    device.touch()
    monkeypatch.setattr("smbus2.smbus2.ioctl", lambda fd, request, data: 0)  # a plain file has no functions to tell
    made = i2c.I2cBus(str(device))
    made.seen = []
    yield made
    made.close()


def answering(bus, answer):
    """Stands for the kernel: reads the structure at the address that the bus hands over, and fills the last message."""

    def transfer(address):
        messages = i2c_rdwr_ioctl_data.from_address(address)
        given = [messages.msgs[i] for i in range(messages.nmsgs)]
        bus.seen.append([(m.addr, m.flags, m.len) for m in given])
        assert ctypes.string_at(given[0].buf, 1) == b"\x72"
        ctypes.memmove(given[-1].buf, answer, len(answer))
        return 0

    return transfer


def test_a_prepared_transfer_is_repeated_with_the_same_buffers(bus):
    reply = i2c_msg.read(0x68, 2)
    prepared = bus.prepare(i2c_msg.write(0x68, [0x72]), reply)
    for answer in (b"\x00\x20", b"\x01\x40"):
        assert answering(bus, answer)(prepared) == 0
        assert bytes(reply) == answer
    assert bus.seen == [[(0x68, 0, 1), (0x68, 1, 2)]] * 2


def test_a_refusal_is_its_errno(bus):
    """The kernel's own: a plain file knows no I2C."""
    assert bus.transfer(bus.prepare(i2c_msg.write(0x68, [0x72]), i2c_msg.read(0x68, 2))) == errno.ENOTTY
