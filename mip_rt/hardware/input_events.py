"""Edges of an input line, with the kernel's timestamps: GPIO events of the character device, read by compiled code.

Source: include/uapi/linux/gpio.h (gpio_v2_line_event, gpioevent_data).
"""

import errno
import os
from functools import partial

import numpy as np

from mip_rt.compiled import direct, njit, numba, records_at
from mip_rt.hardware import system_calls
from mip_rt.hardware.gpio import EDGES, EVENT_V1, EVENT_V2, INPUT, request_lines

BUFFERED = 64  # events that the kernel keeps, and that one read takes
_LONGEST, _NOTHING = EVENT_V2.size, -errno.EAGAIN
_WORDS = _LONGEST // 4

STATE = np.dtype(
    [
        ("fd", "i8"),
        ("size", "i8"),  # bytes of an event: which version of the interface
        ("room", "i8"),  # bytes that one read may bring
        ("timestamp_ns", "i8"),  # of the newest event
        ("edge", "i8"),  # its kind
        ("count", "i8"),  # events since the last read that found any, the dropped ones included
        ("sequence", "i8"),  # the kernel's number of the newest event (version 2)
        ("missed", "i8"),  # events that the kernel's buffer dropped
        ("events", "u4", (BUFFERED * _WORDS,)),
    ],
    align=True,
)


@njit([numba.int64(numba.uint64)])
def take(state_at):
    """Reads all that is waiting; returns `count`, 0 where nothing is, or minus the errno.

    Args:
        state_at: address of one STATE.
    """
    s = records_at(state_at, 1, STATE)[0]
    found = system_calls.read(s.fd, s.events.ctypes.data, s.room)
    if found < s.size:
        return np.int64(0 if found >= 0 or found == _NOTHING else found)
    count = found // s.size
    at = (count - 1) * (s.size // 4)
    s.timestamp_ns = np.int64(s.events[at]) | np.int64(s.events[at + 1]) << 32
    s.edge = s.events[at + 2]
    if s.size == _LONGEST:
        sequence = np.int64(s.events[at + 4])
        dropped = (sequence - s.sequence - count) & 0xFFFFFFFF
        s.sequence = sequence
        if dropped < 0x80000000:
            s.missed += dropped
            count += dropped
    s.count = count
    return np.int64(count)


class InputEvents:
    """Edges of one input line.

    Attributes:
        fd: becomes readable with each edge.
        state: (1,) STATE.
    """

    def __init__(self, kernel, address: str, offset: int, edge: str, consumer: str):
        self.fd, version = request_lines(kernel, address, (offset,), INPUT | EDGES[edge], consumer, buffered=BUFFERED)
        os.set_blocking(self.fd, False)
        self.state = np.zeros(1, STATE)
        size = (EVENT_V2 if version == 2 else EVENT_V1).size
        self.state["fd"], self.state["size"], self.state["room"] = self.fd, size, size * BUFFERED
        self._take = partial(direct(take), self.state.ctypes.data)

    @property
    def missed(self) -> int:
        """Edges that the kernel's buffer dropped."""
        return int(self.state["missed"][0])

    def take(self) -> int:
        """Reads all that is waiting into `state`.

        Returns:
            How many events there were, the dropped ones included.

        Raises:
            OSError: the kernel refuses.
        """
        count = self._take()
        if count < 0:
            raise OSError(-count, os.strerror(-count))
        return count

    def read(self):
        """(timestamp_ns, edge id, number of edges) of all that is waiting, the newest's; None where nothing is."""
        count = self.take()
        return (int(self.state["timestamp_ns"][0]), int(self.state["edge"][0]), count) if count else None

    def close(self) -> None:
        """Releases the line."""
        os.close(self.fd)
