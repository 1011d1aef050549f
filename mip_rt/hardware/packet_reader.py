"""Reading the newest packet of the IMU's FIFO in each tick: the usual case compiled (`imu_read`), here what is not usual.

Two combined transfers with messages that were built once, no lists, no exceptions out of it. What went wrong comes back as bits (imu_status) and in
`counters`.
"""

import ctypes
import errno
from functools import partial
from types import SimpleNamespace

import numpy as np

from mip_rt.compiled import direct
from mip_rt.hardware import imu_read, packet_check
from mip_rt.hardware import mpu9250_registers as r
from mip_rt.hardware.imu_status import (
    IMU_BACKLOG,
    IMU_BAD_NORM,
    IMU_BUS_ERROR,
    IMU_BUS_TIMEOUT,
    IMU_FROZEN,
    IMU_MISALIGNED,
    IMU_NO_DATA,
    IMU_OK,
    IMU_OVERFLOW,
)
from mip_rt.hardware.transfers import Entry

HALF_WRITTEN_WAIT_S = 200e-6

_JUDGED = {packet_check.GOOD: IMU_OK, packet_check.BAD_NORM: IMU_BAD_NORM, packet_check.FROZEN: IMU_FROZEN}
_COUNTED = {IMU_BAD_NORM: "bad_norm", IMU_FROZEN: "frozen"}


class PacketReader:
    """The reading side of one IMU.

    Args:
        kernel: hardware.kernel.Kernel.
        settings: the configuration's imu section.

    Attributes:
        packet: (32,) bytes, the newest packet where the last read returned IMU_OK.
        backlog: packets that waited beside the newest, at the last read.
        counters: how often each kind of trouble occurred.
        usual: (1,) imu_read.READ, what the compiled read needs.
    """

    def __init__(self, kernel, settings):
        from smbus2 import i2c_msg

        self._kernel, self._settings, self._message = kernel, settings, i2c_msg
        self._bus = kernel.open_i2c(settings.bus)
        self._entry, self.usual = Entry(self._bus), np.zeros(1, imu_read.READ)
        self._read_usual = partial(direct(imu_read.read_usual), self.usual.ctypes.data)
        self._prepare()
        self.backlog = 0
        self.counters = dict.fromkeys(("bus_errors", "misaligned", "overflows", "bad_norm", "frozen", "backlog", "resets"), 0)

    def _prepare(self) -> None:
        """Puts the transfers of `read` together, once."""
        i2c_msg, address = self._message, self._settings.address
        count_reply = i2c_msg.read(address, 2)
        self._read_count = self._bus.prepare(i2c_msg.write(address, [r.FIFO_COUNT_H]), count_reply)
        self._count_bytes, self._count_address = bytes_of(count_reply, 0, 2), address_of(count_reply, 0)
        # One transfer for each number of waiting packets; only the last packet of it is used.
        request = i2c_msg.write(address, [r.FIFO_R_W])
        replies = [i2c_msg.read(address, r.PACKET_BYTES * n) for n in range(1, r.FIFO_BYTES // r.PACKET_BYTES + 1)]
        self._read_fifo = [self._bus.prepare(request, reply) for reply in replies]
        self._packets = [bytes_of(m, r.PACKET_BYTES * n, r.PACKET_BYTES) for n, m in enumerate(replies)]
        self._kept = request, count_reply, replies  # the prepared transfers point into their buffers
        self.packet = np.frombuffer(self._packets[0], np.uint8)
        self._state = np.zeros(1, packet_check.STATE)
        check, state_at = direct(packet_check.check), self._state.ctypes.data
        self._checks = [partial(check, state_at, address_of(m, r.PACKET_BYTES * n)) for n, m in enumerate(replies)]
        self._use(self._entry)

    def _use(self, entry: Entry) -> None:
        handles = entry.handle(self._read_count), entry.handle(self._read_fifo[0])
        addresses = self._count_address, self.packet.ctypes.data, self._state.ctypes.data
        self.usual[0] = entry.function, entry.bus, *handles, *addresses

    def read(self) -> int:
        """Brings the newest packet into `packet`; returns the IMU_* bits. Never raises for the bus."""
        self.backlog = 0
        found = self._read_usual()
        return found if found == IMU_OK else self.unusual(found)

    def unusual(self, found: int) -> int:
        """What to make of an answer of `imu_read.usual` other than IMU_OK: the IMU_* bits, with the newest packet in `packet` where they say so."""
        self.backlog = 0
        if found < 0:
            self._entry.check()
            return self._read_again(-found)
        if found == imu_read.OTHER_COUNT:
            return self._read_newest()
        self.counters[_COUNTED[found]] += 1
        return found

    def _read_again(self, refused: int) -> int:
        """One immediate retry, none after a time-out: the kernel has already waited a second."""
        if refused == errno.ETIMEDOUT:
            return self._refused(refused)
        refused = self._bus.transfer(self._read_count)
        return self._refused(refused) if refused else self._read_newest()

    def _transfer(self, prepared) -> int:
        """0, or the bits of what went wrong, with the retry."""
        refused = self._bus.transfer(prepared)
        if not refused or refused != errno.ETIMEDOUT and not (refused := self._bus.transfer(prepared)):
            return 0
        return self._refused(refused)

    def _refused(self, number: int) -> int:
        self.counters["bus_errors"] += 1
        return IMU_BUS_ERROR | IMU_BUS_TIMEOUT if number == errno.ETIMEDOUT else IMU_BUS_ERROR

    def _read_newest(self) -> int:
        """The newest packet of those that the count just read has told."""
        status, newest = self._waiting()
        if newest < 0:
            return status
        refused = self._transfer(self._read_fifo[newest])
        if refused:
            return status | refused
        found = _JUDGED[self._checks[newest]()]
        if found != IMU_OK:
            self.counters[_COUNTED[found]] += 1
        elif newest:
            self._packets[0][:] = self._packets[newest]
        return status | found

    def _count(self) -> int:
        return (self._count_bytes[0] & 0x1F) << 8 | self._count_bytes[1]

    def _waiting(self) -> tuple[int, int]:
        """(IMU_* bits, number of the newest packet that waits); the number is -1 where none can be read."""
        if self._count() == 0:
            return IMU_NO_DATA, -1
        if self._count() % r.PACKET_BYTES:
            self._kernel.sleep(HALF_WRITTEN_WAIT_S)
            refused = self._transfer(self._read_count)
            if refused:
                return refused, -1
            if self._count() % r.PACKET_BYTES:
                self.counters["misaligned"] += 1
                return IMU_MISALIGNED, -1
        status, waiting = 0, self._count() // r.PACKET_BYTES
        if waiting >= len(self._packets):
            waiting = len(self._packets)
            self.counters["overflows"] += 1
            status = IMU_OVERFLOW
        if waiting > 1:
            self.backlog = waiting - 1
            self.counters["backlog"] += waiting - 1
            status |= IMU_BACKLOG
        return status, waiting - 1

    def watch(self, transfer) -> None:
        """From now on every transfer of a read goes through this callable, as the bus's `transfer`, instead of straight to the kernel."""
        self._bus.transfer = transfer
        if self.usual["function"][0]:
            self._entry = Entry(SimpleNamespace(transfer=transfer))
            self._use(self._entry)


def address_of(message, offset: int) -> int:
    """Address of a byte of a message's buffer."""
    return ctypes.addressof(message.buf.contents) + offset


def bytes_of(message, offset: int, length: int):
    """A view of a message's buffer that follows each transfer."""
    return memoryview((ctypes.c_ubyte * length).from_address(address_of(message, offset))).cast("B")
