"""An I2C bus object with smbus2's interface, and the fake chip on it."""

import ctypes
import errno
import time

import numpy as np

from mip_rt.compiled import JIT_DISABLED, address_of, span
from mip_rt.fake import usual_chip
from mip_rt.hardware import mpu9250_registers as r

I2C_READ = 1


class FakeI2cBus:
    """`i2c_rdwr` and `close` of an smbus2.SMBus, and the prepared transfers of hardware.i2c, with one chip on it.

    Args:
        chip: FakeMpu9250.
        address: its address.
        charge: callable(ns) that books the time spent here, or None.
        compiled: while nothing is unusual, transfers need not come here (`usual_chip`).

    Attributes:
        before: callable(messages) called before each transfer, for injected faults; it may raise OSError.
    """

    def __init__(self, chip, address: int = 0x68, charge=None, compiled: bool = False):
        self.__dict__["chip"], self.__dict__["_compiled"] = chip, compiled and not JIT_DISABLED
        self._shared = np.zeros(1, usual_chip.BUS)
        self.address, self.before, self._charge, self.closed = address, None, charge, False

    def __setattr__(self, name, value) -> None:
        """Whoever watches or changes transfers sees all of them from now on."""
        super().__setattr__(name, value)
        self._look_around()

    def __delattr__(self, name) -> None:
        """As above: until he goes."""
        super().__delattr__(name)
        self._look_around()

    def _look_around(self) -> None:
        self.chip.settle()
        own = self.__dict__
        self.chip.may_be_usual = self._compiled and own.get("before") is None and "i2c_rdwr" not in own and "transfer" not in own

    def i2c_rdwr(self, *messages) -> None:
        """One combined transfer."""
        begin = time.perf_counter_ns() if self._charge else 0
        if self.before is not None:
            self.before(messages)
        chip = self.chip
        chip.count_transfer()
        for message in messages:
            if message.addr != self.address or not chip.answers():
                raise OSError(errno.EREMOTEIO, "Remote I/O error")
            if message.flags & I2C_READ:
                data = chip.read(message.len)
                ctypes.memmove(message.buf, data, len(data))
            else:
                chip.write(ctypes.string_at(message.buf, message.len))
        if self._charge:
            self._charge(time.perf_counter_ns() - begin)

    def prepare(self, request, reply):
        """A transfer that writes a register's address and reads from there, for `transfer`."""
        return Prepared(request, reply)

    def shortcut(self, callback: int) -> tuple[int, int]:
        """See hardware.transfers.Entry."""
        if not self._compiled:
            return callback, 0
        self._shared["chip_at"], self._shared["callback"] = span(self.chip.shared)[0], callback
        return address_of(usual_chip.transfer), span(self._shared)[0]

    def transfer(self, prepared) -> int:
        """Carries out a prepared transfer; returns 0 or the errno."""
        address, data = prepared.address, prepared.data
        chip = self.chip
        if "i2c_rdwr" in self.__dict__ or self.before or self._charge or not chip.answers():
            try:
                self.i2c_rdwr(prepared.request, prepared.reply)  # somebody wants to see every transfer, or change it
            except OSError as error:
                return error.errno
            return 0
        chip.count_transfer()
        chip.settle()
        chip.pointer = address[0] & 0x7F
        data[:] = chip.read(len(data))
        return 0

    def close(self) -> None:
        """Nothing is held."""
        self.closed = True


class Prepared:
    """A transfer from one register, ready to be made as often as wanted.

    Attributes:
        handle: address of its usual_chip.PREPARED.
    """

    def __init__(self, request, reply):
        self.request, self.reply, self.address, self.data = request, reply, _buffer_of(request), _buffer_of(reply)
        self._shared = np.zeros(1, usual_chip.PREPARED)
        kinds = {(r.FIFO_COUNT_H, 2): usual_chip.COUNT, (r.FIFO_R_W, r.PACKET_BYTES): usual_chip.PACKET}
        reads = kinds.get((self.address[0] & 0x7F, len(self.data)), usual_chip.OTHER)
        self._shared[0] = reads, ctypes.addressof(reply.buf.contents)
        self.handle = span(self._shared)[0]


def _buffer_of(message) -> memoryview:
    """The bytes of a message, as they are at any time."""
    return memoryview((ctypes.c_ubyte * message.len).from_address(ctypes.addressof(message.buf.contents))).cast("B")
