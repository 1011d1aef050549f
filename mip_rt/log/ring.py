"""The ring: a memory-mapped, self-describing file whose rows are the working memory of the tick.

The loop fills row tick % rows in place and commits it by storing tick + 1, first into the row's `sequence`, then into the counter;
starting a row stores 0 into its `sequence`. A reader takes a row only where its sequence says which tick it is, before and
after copying: a torn row is recognised, and a process that dies leaves every committed row readable. Once a second the loop
also keeps the bytes of the controller's and the estimators' state, from which a replay can start in the middle. `ring_format` has the layout.
"""

import mmap
import os
import struct
import zlib
from functools import partial
from pathlib import Path

import numpy as np

from mip_rt.compiled import direct
from mip_rt.errors import LogError
from mip_rt.log import commit, ring_format
from mip_rt.log.description import header  # noqa: F401  (whoever makes a ring needs it)
from mip_rt.log.ring_format import SEAL, STATE_MARK, Counter, Status

STATE_EVERY = 200  # rows from one kept state to the next


class Ring:
    """The writing side.

    Args:
        path: the file; its folder is made where it is missing.
        dtype: of a row, with fields `sequence` and `tick`.
        rows: how many it holds.
        description: see `description.header`; `log_version` and `state_bytes` are added.
        state_bytes: bytes of one kept state; 0 for none.
        state_rows: how many of those it holds; enough for all rows by default.

    Attributes:
        begin: begin(index) marks a row as being written.
        commit: commit(index, tick) makes it visible to readers.
        finish: finish(index, tick, fault, step_ns, write_ns) writes these fields of a frame, and commits it.
        rows: (n,) records of the layout, mapped.
        buffer: the rows' bytes, for `struct.pack_into`.
        row_bytes: bytes of a row.
        geometry: where everything lies.

    Raises:
        LogError: the file cannot be created.
    """

    def __init__(self, path: Path, dtype: np.dtype, rows: int, description: dict, state_bytes: int = 0, state_rows: int | None = None):
        if state_rows is None:
            state_rows = rows // STATE_EVERY + 2
        description = {**description, "log_version": ring_format.VERSION, "state_bytes": state_bytes}
        text, geometry = ring_format.pack_header(description, rows, dtype.itemsize, state_rows if state_bytes else 0, state_bytes)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)  # whoever has an older file of this name mapped keeps it whole
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
            try:
                os.posix_fallocate(handle, 0, geometry.size)  # a file with holes kills who writes to its mapping once the file system is full
            except OSError:
                os.close(handle)
                path.unlink()
                raise
        except OSError as error:
            raise LogError(
                f"the log {path} cannot be created: {error.strerror}.", "Name another folder with --log.", "log_create"
            ) from error
        self.path, self.geometry = path, geometry
        self.capacity = rows
        self.row_bytes = dtype.itemsize
        self._map = mmap.mmap(handle, 0)
        os.close(handle)
        self._map[: len(text)] = text
        self._map[geometry.copy_at : geometry.copy_at + len(text)] = text
        rows_end = geometry.rows_at + rows * dtype.itemsize
        self.buffer = memoryview(self._map)[geometry.rows_at : rows_end]
        self.rows = np.frombuffer(self._map, dtype, rows, geometry.rows_at)
        self._counter = np.frombuffer(self._map, "<i8", len(Counter), geometry.counters_at)
        self._status = np.frombuffer(self._map, "<i8", len(Status), geometry.status_at)
        self._counter[Counter.WRITER] = os.getpid()
        self.rows["sequence"] = 0  # touches every page, so that none is missing in a tick
        self._map[geometry.states_at : geometry.rows_at] = bytes(geometry.rows_at - geometry.states_at)
        self._states = 0
        rows_at = self.rows.ctypes.data
        self.begin = partial(direct(commit.begin), rows_at, dtype.itemsize)
        self.commit = partial(direct(commit.commit), rows_at, dtype.itemsize, self._counter.ctypes.data)
        self.finish = None
        if "fault" in dtype.names:
            self.finish = partial(direct(commit.finish), rows_at, dtype.itemsize, dtype.fields["fault"][1], self._counter.ctypes.data)

    def keep_state(self, tick: int, parts) -> None:
        """Keeps the state as it is after tick `tick` was stepped, over the oldest one. Copies, and allocates nothing that stays.

        Args:
            parts: contiguous byte views (`array.view(np.uint8)`, made once), `state_bytes` long together.

        Raises:
            ValueError: the parts are of another length; no state is kept then.
        """
        geometry = self.geometry
        at = geometry.states_at + self._states % geometry.state_rows * geometry.slot_bytes
        STATE_MARK.pack_into(self._map, at, 0, tick)
        at_part = at + STATE_MARK.size
        left = geometry.state_bytes
        for part in parts:
            size = part.nbytes
            left -= size
            if left < 0:
                break
            self._map[at_part : at_part + size] = part
            at_part += size
        if left:
            raise ValueError(f"the ring keeps states of {geometry.state_bytes} bytes, these have another length")
        STATE_MARK.pack_into(self._map, at, tick + 1, tick)
        self._states += 1
        self._counter[1] = self._states

    def report_fault(self, number: int, tick: int) -> None:
        """Tells the recorder that the supervisor entered FAULT with this code."""
        self._counter[Counter.FAULT], self._counter[Counter.FAULT_TICK] = number, tick
        self._counter[Counter.FAULTS] += 1

    def recorder_status(self) -> dict[str, int]:
        """What the recorder says of itself: see `ring_format.Status`."""
        return dict(zip((name.lower() for name in Status.__members__), self._status.tolist()))

    def committed(self) -> int:
        """The newest committed tick + 1."""
        return int(self._counter[Counter.COMMITTED])

    def needed(self) -> int:
        """The oldest tick that the recorder still has to read."""
        return int(self._status[Status.NEEDED])

    def close(self) -> None:
        """Ends the writing and seals what was written. The mapping lives as long as anyone holds the rows.

        Every process sees the file whole from now on; what has to survive a power cut is the recorder's to keep, and a ring on a disk is
        written there when the system finds time: waiting for that took as long as simulating the run.
        """
        self._seal()
        self._counter[Counter.FINISHED] = 1

    def _seal(self) -> None:
        """Stores a checksum of every row and kept state, so that a reader of the finished file notices a flipped bit."""
        geometry, buffer, size = self.geometry, self.buffer, self.row_bytes
        crc32, seals_at = zlib.crc32, geometry.seals_at
        sequences = self.rows["sequence"]
        written = np.flatnonzero(sequences)
        for index, sequence in zip(written.tolist(), sequences[written].tolist()):
            check = crc32(buffer[index * size : (index + 1) * size])
            SEAL.pack_into(self._map, seals_at + index * SEAL.size, sequence, check, check ^ 0xFFFFFFFF)
        view = memoryview(self._map)
        for slot in range(geometry.state_rows):
            at = geometry.states_at + slot * geometry.slot_bytes
            sequence = STATE_MARK.unpack_from(self._map, at)[0]
            if sequence:
                check = crc32(view[at : at + geometry.slot_bytes])
                SEAL.pack_into(self._map, seals_at + (geometry.rows + slot) * SEAL.size, sequence, check, check ^ 0xFFFFFFFF)


def remove_old_rings(folder: Path, pattern: str, keep: int = 1) -> None:
    """Removes the rings of processes that are gone, but for the newest `keep`: on the robot they take up memory."""
    dead = []
    for path in Path(folder).glob(pattern):
        try:
            with path.open("rb") as file:
                found = ring_format.unpack_header(file.read(ring_format.HEADER_LIMIT))
                file.seek(found[0].counters_at if found else 0)
                counters = struct.unpack(f"<{len(Counter)}q", file.read(8 * len(Counter)))
            if not found or not os.path.exists(f"/proc/{counters[Counter.WRITER]}"):
                dead.append((path.stat().st_mtime_ns, path))
        except (OSError, struct.error):
            continue  # somebody else's file, or another process removed it at this moment
    for _, path in sorted(dead)[: len(dead) - keep]:
        path.unlink(missing_ok=True)
