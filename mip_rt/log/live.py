"""Live reader of a ring: rows of a running, or dead, loop from another process, without disturbing it.

The file is read with `pread`, which sees what the loop's mapping holds but, unlike a mapping of our own, gives a short answer instead
of a bus error where a new run truncates the file under us. Nothing is written and nothing is locked; nothing happens between calls.
"""

import os
import time
from pathlib import Path

import numpy as np

from mip_rt.errors import LogError
from mip_rt.log import ring_format
from mip_rt.log.log_data import record_type
from mip_rt.log.ring_format import MAGIC, PREFIX, START, VERSION, Counter

PATTERN = "*.ring"
LOOK_AROUND_S = 0.5  # between looks into the folder for a newer ring
SILENT_S = 1.0  # without a row for so long, the loop has stopped


def newest_ring(folders) -> Path | None:
    """The ring that was written to last in these folders (a path or several), None where there is none."""
    found = []
    for folder in [folders] if isinstance(folders, str | os.PathLike) else folders:
        for path in Path(folder).glob(PATTERN):
            try:
                found.append((path.stat().st_mtime_ns, path))
            except OSError:
                continue  # removed in the meantime
    return max(found)[1] if found else None


class LiveRing:
    """Attaches to a ring and follows the loop that writes it, over its restarts.

    Args:
        path: a ring file; or a folder (or several), of which the newest ring is taken, and a newer one as soon as it appears.

    Attributes:
        path: the ring file being read.
        header: what it says of itself (`log.description.header`).
        dtype: record type of its rows.
        capacity: rows that the ring holds.
        counter: ticks committed when last looked.
        runs: how many rings were opened: grows when the loop was restarted. `tick` then begins anew.

    Raises:
        LogError: there is no ring at the path, or none that can be read.
    """

    def __init__(self, path):
        self._where = path
        self._handle = None
        self.path = self.header = self.dtype = None
        self.runs = self.counter = self.capacity = 0
        self._looked_s = self._moved_s = 0.0
        self._taken = self._taken_run = 0
        self._open(self._find())

    def close(self) -> None:
        """Lets go of the file."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    @property
    def quiet_s(self) -> float:
        """Seconds since a row was last seen to arrive; infinity where the newest row is of before the machine's last start."""
        return time.monotonic() - self._moved_s

    @property
    def finished(self) -> bool:
        """The loop ended in an orderly way: no further row will come into this ring."""
        return self._number(Counter.FINISHED) == 1

    @property
    def silent(self) -> bool:
        """No row comes any more: the loop ended, hangs or was killed."""
        return self.finished or self.quiet_s > SILENT_S

    def refresh(self) -> bool:
        """Looks whether rows arrived or the loop was restarted; True for a restart. The other methods call this."""
        restarted = self._reopen_if_new()
        counter = self._read_counter()
        if counter != self.counter:
            self._moved_s = time.monotonic()
        self.counter = counter
        return restarted

    def since(self, tick: int) -> np.ndarray:
        """Complete rows of ticks >= `tick` that the ring still holds, in order, copies: (n,) records.

        A row that the loop overwrites while it is being copied is left out. After a restart (`runs` has grown) ticks begin at 0 again.
        """
        self.refresh()
        return self._copy(tick)

    def arrived(self) -> np.ndarray:
        """Rows that came since the last call, over restarts; at the first call the newest one only: (n,) records."""
        self.refresh()
        if self._taken_run != self.runs:
            self._taken = self.counter - 1 if self._taken_run == 0 else 0
            self._taken_run = self.runs
        rows = self._copy(self._taken)
        if len(rows):
            self._taken = int(rows["tick"][-1]) + 1
        return rows

    def _copy(self, tick: int) -> np.ndarray:
        counter = self.counter
        first = max(0, tick, counter - self.capacity)
        count = counter - first
        if count <= 0:
            return np.zeros(0, self.dtype)
        begin = first % self.capacity
        straight = min(count, self.capacity - begin)
        data = self._read_rows(begin, straight) + (self._read_rows(0, count - straight) if count > straight else b"")
        rows = np.frombuffer(bytearray(data), self.dtype, len(data) // self.dtype.itemsize)
        ticks = first + np.arange(len(rows), dtype=np.int64)
        # The loop begins a row over tick t when the counter stands at t + capacity: what it had not reached after the copy is whole.
        after = self._read_counter()
        whole = (rows["sequence"] == ticks + 1) & (ticks > after - self.capacity) & (after >= counter)
        return rows[whole]

    # -- the file ------------------------------------------------------------------------------------------------------
    def _find(self) -> Path:
        where = self._where
        if isinstance(where, str | os.PathLike) and not Path(where).is_dir():
            return Path(where)
        path = newest_ring(where)
        if path is None:
            places = where if isinstance(where, str | os.PathLike) else " or ".join(map(str, where))
            raise LogError(f"there is no ring in {places}.", "Start mip-rt, or name the .ring file that it prints.", "log_absent")
        return path

    def _open(self, path: Path) -> None:
        try:
            handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError as error:
            raise LogError(f"{path} cannot be opened: {error.strerror}.", "Name the .ring file that mip-rt prints.", "log_absent") from error
        try:
            status = os.fstat(handle)
            text = os.pread(handle, PREFIX.size, 0)
            if len(text) < PREFIX.size or text[:8] != MAGIC:
                raise LogError(f"{path} is not a ring.", "Name the .ring file that mip-rt prints.", "log_magic")
            _, version, text_bytes = START.unpack_from(text)
            if version != VERSION:
                raise LogError(f"{path} is a ring of version {version}, this program follows {VERSION}.", code="log_version")
            text += os.pread(handle, text_bytes, PREFIX.size)
            found = ring_format.unpack_header(text)
            if found is None:
                raise LogError(f"the header of {path} is damaged.", "Read it with mip-rt log info: it has a copy.", "log_header")
            geometry, header = found
            dtype = record_type(header)
        except LogError:
            os.close(handle)
            raise
        self.close()
        self._handle, self._identity, self._text = handle, (status.st_dev, status.st_ino), text
        self._geometry = geometry
        self.path, self.header, self.dtype, self.capacity = path, header, dtype, geometry.rows
        self.runs += 1
        self.counter = self._read_counter()
        self._moved_s = self._last_sign_s()

    def _reopen_if_new(self) -> bool:
        path = self.path
        now = time.monotonic()
        # While our loop runs, another's ring is not looked for: of two loops at a time both would seem the newest in turn.
        if now - self._looked_s > LOOK_AROUND_S and (self.finished or self.quiet_s > LOOK_AROUND_S):
            self._looked_s = now
            try:
                path = self._find()
            except LogError:
                return False  # the ring was removed: what is open remains readable
        try:
            status = os.stat(path)
            same = (status.st_dev, status.st_ino) == self._identity
        except OSError:
            return False
        if same and os.pread(self._handle, len(self._text), 0) == self._text:
            return False
        try:
            self._open(path)
        except LogError:
            return False  # a new run is just writing its header
        return True

    def _last_sign_s(self) -> float:
        """When the newest row came, on this machine's monotonic clock: at the time of attaching nothing was seen to move yet."""
        now = time.monotonic()
        clock = self.header.get("clock", {}).get("monotonic_ns", 0)
        if self.counter:
            data = self._read_rows((self.counter - 1) % self.capacity, 1)
            if len(data) == self.dtype.itemsize and "edge_ns" in self.dtype.names:
                clock = max(clock, int(np.frombuffer(data, self.dtype)["edge_ns"][0]))
        return clock * 1e-9 if clock * 1e-9 <= now else -np.inf

    def _read_counter(self) -> int:
        return self._number(Counter.COMMITTED)

    def _number(self, which: Counter) -> int:
        return int.from_bytes(os.pread(self._handle, 8, self._geometry.counters_at + 8 * which), "little")

    def _read_rows(self, index: int, count: int) -> bytes:
        size = self.dtype.itemsize
        return os.pread(self._handle, count * size, self._geometry.rows_at + index * size)
