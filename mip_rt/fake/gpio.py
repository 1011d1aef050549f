"""GPIO chips behind ioctl: requested lines are real file descriptors, edges arrive in them as the kernel's event records.

A chip is a file that holds its bank's address. An event line is one end of a socket pair; an output line too, so that closing it
(also by the death of the process that holds it) is seen from the other end, and the line falls to its pull-down.
"""

import errno
import os
import socket
import struct

from mip_rt.hardware.gpio import (
    EDGE_FALLING,
    EDGE_RISING,
    EVENT_V1,
    EVENT_V2,
    GET_LINE_V2,
    GET_LINEEVENT_V1,
    GET_LINEHANDLE_V1,
    OUTPUT,
    SET_VALUES_V1,
    SET_VALUES_V2,
)


class _Request:
    """Lines held by a driver."""

    def __init__(self, address, offsets, values, events):
        mine, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        mine.setblocking(False)
        self.mine, self.fd = mine, theirs.detach()
        self.address, self.offsets, self.values, self.events = address, offsets, values, events
        self.sequence = 0

    @property
    def held(self) -> bool:
        """The driver still has its descriptor open."""
        try:
            return self.mine.recv(1, socket.MSG_PEEK) != b""
        except BlockingIOError:
            return True
        except OSError:
            return False


class FakeGpio:
    """All chips of a board.

    Args:
        abi: 2 for the newer ABI (the older works, too), 1 where the newer is refused as on Linux before 5.10.
    """

    def __init__(self, abi: int = 2):
        self._abi = abi
        self._by_fd = {}
        self._events = {}
        self._outputs = {}

    def ioctl(self, fd: int, request: int, argument, mutate: bool = True) -> int:
        """The requests that drivers make; EINVAL for others, EBUSY for a line that is taken."""
        held = self._by_fd.get(fd)
        if request == SET_VALUES_V2 and held is not None:
            values, mask = struct.unpack_from("<QQ", argument)
            held.values = held.values & ~mask | values & mask
            return 0
        if request == SET_VALUES_V1 and held is not None:
            held.values = sum((argument[i] & 1) << i for i in range(len(held.offsets)))
            return 0
        if request == GET_LINE_V2 and self._abi >= 2:
            return self._get_line_v2(fd, argument)
        if request in (GET_LINEEVENT_V1, GET_LINEHANDLE_V1):
            return self._get_line_v1(fd, request, argument)
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    def _address(self, fd: int) -> str:
        return os.pread(fd, 64, 0).decode()

    def _get_line_v2(self, fd, argument) -> int:
        (count,) = struct.unpack_from("<I", argument, 560)
        flags, attributes = struct.unpack_from("<QI", argument, 288)
        if any(argument[300:320]) or any(argument[568:588]):
            raise OSError(errno.EINVAL, "padding is not zero")
        values = struct.unpack_from("<Q", argument, 328)[0] if attributes else 0
        offsets = struct.unpack_from(f"<{count}I", argument, 0)
        made = self._make(self._address(fd), offsets, values, flags, EVENT_V2)
        struct.pack_into("<i", argument, 588, made)
        return 0

    def _get_line_v1(self, fd, request, argument) -> int:
        if request == GET_LINEEVENT_V1:
            offset, _, edges = struct.unpack_from("<III", argument, 0)
            made = self._make(self._address(fd), (offset,), 0, edges << 4, EVENT_V1)
            struct.pack_into("<i", argument, 44, made)
            return 0
        (count,) = struct.unpack_from("<I", argument, 356)
        offsets = struct.unpack_from(f"<{count}I", argument, 0)
        values = sum((argument[260 + i] & 1) << i for i in range(count))
        struct.pack_into("<i", argument, 360, self._make(self._address(fd), offsets, values, OUTPUT, None))
        return 0

    def _make(self, address, offsets, values, flags, event) -> int:
        table = self._outputs if flags & OUTPUT else self._events
        for offset in offsets:
            for taken in (self._outputs.get((address, offset)), self._events.get((address, offset))):
                if taken is not None and taken.held:
                    raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
        request = _Request(address, offsets, values, event if flags & (EDGE_FALLING | EDGE_RISING) else None)
        self._by_fd[request.fd] = request
        for offset in offsets:
            table[address, offset] = request
        return request.fd

    def push_edge(self, address: str, offset: int, timestamp_ns: int, edge: int) -> bool:
        """An edge (1 rising, 2 falling) at a line; False where nobody listens or the buffer is full (the kernel drops then, too)."""
        request = self._events.get((address, offset))
        if request is None:
            return False
        request.sequence += 1
        try:
            if request.events is EVENT_V1:
                request.mine.send(EVENT_V1.pack(timestamp_ns, edge))
            else:
                request.mine.send(EVENT_V2.pack(timestamp_ns, edge, offset, request.sequence, request.sequence))
        except OSError:
            return False
        return True

    def output(self, address: str, offset: int):
        """(request, bit) of an output line for `level`, or None where nobody has requested it."""
        request = self._outputs.get((address, offset))
        return None if request is None else (request, request.offsets.index(offset))

    def line_value(self, address: str, offset: int) -> int:
        """Level of a line: what is driven, or 0 (pulled down) where nobody holds it."""
        request = self._outputs.get((address, offset))
        if request is None or not request.held:
            return 0
        return (request.values >> request.offsets.index(offset)) & 1
