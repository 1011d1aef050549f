"""Prepared transfers hand the kernel what smbus2 would hand it, and the same structure every time."""

import ctypes
import errno

import pytest
from smbus2 import i2c_msg

from mip_rt.hardware import i2c


@pytest.fixture
def bus(monkeypatch):
    """A bus whose ioctl is looked at; `bus.seen` lists (nmsgs, [(addr, flags, len, first byte)])."""
    made = i2c.I2cBus.__new__(i2c.I2cBus)
    made.fd, made.seen, made.answer = 77, [], b""

    def ioctl(fd, request, data):
        assert (fd, request) == (77, 0x0707)
        messages = [data.msgs[i] for i in range(data.nmsgs)]
        made.seen.append([(m.addr, m.flags, m.len) for m in messages])
        if isinstance(made.answer, OSError):
            raise made.answer
        ctypes.memmove(messages[-1].buf, made.answer, len(made.answer))

    monkeypatch.setattr(i2c.fcntl, "ioctl", ioctl)
    yield made
    made.fd = None  # nothing to close


def test_a_prepared_transfer_is_repeated_with_the_same_buffers(bus):
    request, reply = i2c_msg.write(0x68, [0x72]), i2c_msg.read(0x68, 2)
    prepared = bus.prepare(request, reply)
    for answer in (b"\x00\x20", b"\x01\x40"):
        bus.answer = answer
        bus.transfer(prepared)
        assert bytes(reply) == answer
    assert bus.seen == [[(0x68, 0, 1), (0x68, 1, 2)]] * 2
    assert ctypes.string_at(prepared.msgs[0].buf, 1) == b"\x72"


def test_a_refusal_is_an_oserror(bus):
    bus.answer = OSError(errno.EREMOTEIO, "Remote I/O error")
    with pytest.raises(OSError, match="Remote"):
        bus.transfer(bus.prepare(i2c_msg.write(0x68, [0x72]), i2c_msg.read(0x68, 2)))
