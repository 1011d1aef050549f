"""Transfers from compiled code: the kernel's refusals, a bus in Python, and what that raises."""

import errno
import os

import pytest

from mip_rt.hardware.transfers import Entry, transfer

pytestmark = pytest.mark.armhf


class KernelBus:
    """A file that is no I2C bus: the kernel itself answers."""

    def __init__(self, fd):
        self.fd = fd


class PythonBus:
    def __init__(self, answer):
        self.answer, self.seen = answer, []

    def transfer(self, prepared):
        self.seen.append(prepared)
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def made(entry, prepared):
    return transfer(entry.function, entry.bus, entry.handle(prepared))


def test_the_kernels_refusal_is_its_errno():
    emulated = os.environ.get("MIP_RT_EMULATED")  # QEMU answers requests that it does not know itself, without a look at the descriptor
    with open(os.devnull, "rb") as file:
        assert made(Entry(KernelBus(file.fileno())), 0) == (errno.ENOSYS if emulated else errno.ENOTTY)
    assert made(Entry(KernelBus(1 << 20)), 0) == (errno.ENOSYS if emulated else errno.EBADF)


@pytest.mark.parametrize("answer", [0, errno.EREMOTEIO, errno.ETIMEDOUT])
def test_a_bus_in_python_is_asked_for_the_right_transfer(answer):
    bus = PythonBus(answer)
    entry = Entry(bus)
    assert [made(entry, name) for name in ("count", "packet", "count")] == [answer] * 3
    assert bus.seen == ["count", "packet", "count"]
    entry.check()


def test_what_a_bus_raises_is_a_refusal_and_raised_afterwards():
    entry = Entry(PythonBus(ValueError("no such register")))
    assert made(entry, "count") == errno.EIO
    with pytest.raises(ValueError, match="no such register"):
        entry.check()
    entry.check()  # once
