"""GPIO chips behind ioctl: requested lines are real file descriptors, edges arrive in them as the kernel's event records.

A chip is a file that holds its bank's address. An event line is one end of a pipe. Output lines are bytes of a file beside the
chip, one a line, and who holds a line has a lock on its byte that belongs to the open file description: so any process sees the level, and
when the last descriptor closes, also by the death of its holder, the lock is gone and the line falls to its pull-down.
"""

import errno
import fcntl
import mmap
import os
import select
import struct
from pathlib import Path

from mip_rt.fake.sysfs import address_of
from mip_rt.hardware.gpio import (
    EVENT_V1,
    EVENT_V2,
    GET_LINE_V2,
    GET_LINEEVENT_V1,
    GET_LINEHANDLE_V1,
    OUTPUT,
    SET_VALUES_V1,
    SET_VALUES_V2,
)

LINES = 32  # of a bank
# By offset: struct flock with 64-bit offsets: type, whence, start, length, process. The type's low byte comes first, as on all our machines.
_LOCKS = [struct.pack("<hhxxxxqqixxxx", fcntl.F_WRLCK, os.SEEK_SET, offset, 1, 0) for offset in range(LINES)]


class _Events:
    """An input line held by a driver of this process: the reading end of a pipe, which buffers about as many events as the kernel.

    Attributes:
        fd: the driver's end.
        line: the writing end, edges.Line.
    """

    def __init__(self, event_bytes: int, offset: int):
        # Only who listens pays for them: the guard's process, which drives a line, stays small.
        from mip_rt.fake.edges import Line

        self.fd, self._mine = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        fcntl.fcntl(self._mine, fcntl.F_SETPIPE_SZ, 4096)
        self.line = Line(self._mine, event_bytes, offset)
        self._held = select.poll()
        self._held.register(self._mine, 0)

    @property
    def held(self) -> bool:
        """The driver still has its descriptor open."""
        return not self._held.poll(0)

    def close(self) -> None:
        """Nobody will push any more."""
        os.close(self._mine)


class _Bank:
    """The output lines of one bank, as any process sees them."""

    def __init__(self, path: Path):
        self.path = path
        self.fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        os.ftruncate(self.fd, LINES)
        self.levels = mmap.mmap(self.fd, LINES)
        self.address = address_of(self.levels)

    def held(self, offset: int) -> bool:
        """Some process has the line requested."""
        return fcntl.fcntl(self.fd, fcntl.F_OFD_GETLK, _LOCKS[offset])[0] != fcntl.F_UNLCK

    def level(self, offset: int) -> int:
        """1 where a line is driven high, 0 where it is low or nobody holds it (pulled down)."""
        return 1 if self.levels[offset] and self.held(offset) else 0

    def request(self, offsets, values: int) -> int:
        """Descriptor that holds these lines; OSError EBUSY where one is taken."""
        fd = os.open(self.path, os.O_RDWR | os.O_CLOEXEC)
        try:
            for i, offset in enumerate(offsets):
                fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _LOCKS[offset])
                self.levels[offset] = values >> i & 1
        except OSError as error:
            os.close(fd)
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY)) from error
        return fd


class FakeGpio:
    """All chips of a board.

    Args:
        root: folder that stands for "/"; processes with the same root see the same output lines.
        abi: 2 for the newer ABI (the older works, too), 1 where the newer is refused as on Linux before 5.10.
        held: (bank address, offset) of lines that kernel drivers hold.

    Attributes:
        pushed: an edge was pushed since somebody has set this to False.
    """

    def __init__(self, root, abi: int = 2, held=()):
        self._root, self._abi, self._held = Path(root), abi, held
        self._banks = {}
        self.pushed = True
        self._events = {}
        self._outputs = {}  # (bank, offsets) by descriptor

    def bank(self, address: str) -> _Bank:
        """The output lines of a bank."""
        if address not in self._banks:
            self._banks[address] = _Bank(self._root / "dev" / f"lines-{address}")
        return self._banks[address]

    def ioctl(self, fd: int, request: int, argument, mutate: bool = True) -> int:
        """The requests that drivers make; EINVAL for others, EBUSY for a line that is taken."""
        if request in (SET_VALUES_V1, SET_VALUES_V2) and fd in self._outputs:
            bank, offsets = self._outputs[fd]
            if request == SET_VALUES_V2:
                values, mask = struct.unpack_from("<QQ", argument)
            else:
                values, mask = sum((argument[i] & 1) << i for i in range(len(offsets))), -1
            for i, offset in enumerate(offsets):
                if mask >> i & 1:
                    bank.levels[offset] = values >> i & 1
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
        made = self._make(self._address(fd), offsets, values, flags, EVENT_V2.size)
        struct.pack_into("<i", argument, 588, made)
        return 0

    def _get_line_v1(self, fd, request, argument) -> int:
        if request == GET_LINEEVENT_V1:
            offset, _, wanted = struct.unpack_from("<III", argument, 0)
            made = self._make(self._address(fd), (offset,), 0, wanted << 4, EVENT_V1.size)
            struct.pack_into("<i", argument, 44, made)
            return 0
        (count,) = struct.unpack_from("<I", argument, 356)
        offsets = struct.unpack_from(f"<{count}I", argument, 0)
        values = sum((argument[260 + i] & 1) << i for i in range(count))
        struct.pack_into("<i", argument, 360, self._make(self._address(fd), offsets, values, OUTPUT, None))
        return 0

    def _make(self, address, offsets, values, flags, event_bytes) -> int:
        bank = self.bank(address)
        for offset in offsets:
            taken = self._events.get((address, offset))
            if (address, offset) in self._held or bank.held(offset) or (taken is not None and taken.held):
                raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
        if flags & OUTPUT:
            fd = bank.request(offsets, values)
            self._outputs[fd] = (bank, offsets)
            return fd
        if (address, offsets[0]) in self._events:
            self._events[address, offsets[0]].close()
        request = _Events(event_bytes, offsets[0])
        self._events[address, offsets[0]] = request
        return request.fd

    def drives(self, fd: int, address: str, offset: int) -> bool:
        """The descriptor holds this output line."""
        bank, offsets = self._outputs.get(fd, (None, ()))
        return bank is self._banks.get(address) and offset in offsets

    def event_fd(self, address: str, offset: int) -> int:
        """Descriptor that a driver was given for the events of this line; -1 before."""
        request = self._events.get((address, offset))
        return -1 if request is None else request.fd

    def push_edge(self, address: str, offset: int, timestamp_ns: int, edge: int) -> bool:
        """An edge (1 rising, 2 falling) at a line; False where nobody listens or the buffer is full (the kernel drops then, too)."""
        request = self._events.get((address, offset))
        if request is None:
            return False
        self.pushed = True
        return request.line.push(timestamp_ns, edge)

    def events_of(self, address: str, offset: int):
        """The edges.Line of an input line; None where nobody listens."""
        request = self._events.get((address, offset))
        return request and request.line

    def line_value(self, address: str, offset: int) -> int:
        """Level of a line: what is driven, or 0 (pulled down) where nobody holds it."""
        return self.bank(address).level(offset)

    def close(self) -> None:
        """Unmaps the banks, ends the events."""
        for request in self._events.values():
            request.close()
        self._events.clear()
        for bank in self._banks.values():
            bank.levels.close()
            os.close(bank.fd)
        self._banks.clear()
