"""Edges of an input line, compiled: the kernel's event record, written into the pipe that stands for the line's descriptor.

Source: include/uapi/linux/gpio.h (gpio_v2_line_event, gpioevent_data).
"""

import ctypes
import os
from functools import partial

import numpy as np

from mip_rt.compiled import JIT_DISABLED, direct, entry, external, njit, records_at, span

V2_BYTES = 48

LINE = np.dtype(
    [
        ("fd", "i8"),  # the pipe's writing end
        ("event_bytes", "i8"),
        ("offset", "i8"),
        ("sequence", "i8"),  # of the newest event, whether it found room or not
        ("event", "u4", (V2_BYTES // 4,)),
    ],
    align=True,
)

if JIT_DISABLED:

    def _write(fd, address, length):
        try:
            return os.write(int(fd), ctypes.string_at(int(address), int(length)))
        except OSError:
            return -1

else:
    _C_WRITE = external("write", "intp(int32, uintp, uintp)")

    @njit
    def _write(fd, address, length):
        return _C_WRITE(np.int32(fd), np.uintp(address), np.uintp(length))


@njit
def push_event(line, timestamp_ns, edge):
    """Puts an event into the buffer; 1, or 0 where the driver is gone or the buffer full. line: record of LINE."""
    line.sequence += 1
    line.event[0] = timestamp_ns & 0xFFFFFFFF
    line.event[1] = timestamp_ns >> 32
    line.event[2] = edge
    if line.event_bytes == V2_BYTES:
        line.event[3] = line.offset
        line.event[4] = line.sequence & 0xFFFFFFFF
        line.event[5] = line.sequence & 0xFFFFFFFF
    return np.int64(1 if _write(line.fd, line.event.ctypes.data, line.event_bytes) == line.event_bytes else 0)


@entry("uintp", "int64", "int64")
def push(line_at, timestamp_ns, edge):
    """`push_event`, for callers in Python. line_at: address of one LINE."""
    return push_event(records_at(line_at, 1, LINE)[0], timestamp_ns, edge)


class Line:
    """The writing end of one line's events.

    Args:
        fd: of the pipe.
        event_bytes: of which version of the interface.
        offset: of the line in its bank.

    Attributes:
        address: of the LINE.
    """

    def __init__(self, fd: int, event_bytes: int, offset: int):
        self._line = np.zeros(1, LINE)
        self._line["fd"], self._line["event_bytes"], self._line["offset"] = fd, event_bytes, offset
        self.address = span(self._line)[0]
        self._push = partial(direct(push), self.address)

    @property
    def sequence(self) -> int:
        """Number of the newest event; who raises it has dropped some."""
        return int(self._line["sequence"][0])

    @sequence.setter
    def sequence(self, number: int) -> None:
        """See above."""
        self._line["sequence"] = number

    def push(self, timestamp_ns: int, edge: int) -> bool:
        """Puts an event into the buffer; False where the driver is gone or the buffer full."""
        return self._push(timestamp_ns, edge) == 1
