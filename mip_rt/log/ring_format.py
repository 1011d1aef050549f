"""The layout of a ring file, version 2, as plain structs: writer, recorder and reader take it from here, and it needs neither numpy nor numba.

    header     PREFIX and the description as JSON
    counters   one page, written by the loop: see Counter
    status     one page, written by the recorder: see Status
    states     slots of STATE_MARK and the bytes of the controller's and the estimators' state
    seals      one SEAL a row and a state slot, written when the ring is closed
    rows       the frames
    header     once more, so that one damaged byte does not make the file unreadable

Every part begins on a page. Numbers are little-endian.
"""

import json
import struct
import zlib
from enum import IntEnum
from typing import NamedTuple

MAGIC = b"MIPRTLOG"
VERSION = 2
PAGE = 4096
HEADER_LIMIT = 64 * PAGE  # a header is not longer
START = struct.Struct("<8sII")  # magic, version, bytes of the JSON text: the same in every version
PREFIX = struct.Struct("<8sII10QI4x")  # START, then Geometry, then the CRC-32 of all before it and the JSON
STATE_MARK = struct.Struct("<qq")  # sequence: 0 while being written, then tick + 1; tick
SEAL = struct.Struct("<qII")  # sequence of the row that was sealed, CRC-32 of its bytes, the same inverted


class Counter(IntEnum):
    """The 64-bit numbers of the counters page."""

    COMMITTED = 0  # newest tick + 1
    STATES = 1  # states kept since the start
    FINISHED = 2  # 1 once the loop has ended in an orderly way
    WRITER = 3  # process of the loop
    FAULTS = 4  # times that the supervisor entered FAULT
    FAULT = 5  # number of the last of those faults
    FAULT_TICK = 6  # tick before which it was entered


class Status(IntEnum):
    """The 64-bit numbers of the status page: what the recorder says of itself."""

    PROCESS = 0
    HEARTBEAT_NS = 1  # CLOCK_MONOTONIC of the last look at the ring
    NEEDED = 2  # oldest tick that it still has to read: the loop may wait here where time is virtual
    RECORDED = 3  # rows written to disk
    DROPPED = 4  # rows that were overwritten in the ring before they were read, or left over when the recorder gave up
    TORN = 5  # committed rows that were not whole, or were overwritten while they were read
    BACKLOG = 6  # rows that were waiting at the last look
    BACKLOG_MAX = 7
    STATES = 8
    BLOCKS = 9
    BYTES = 10
    ERRORS = 11  # refused writes; each is tried again
    ERRNO = 12  # of the last refused write
    SYNC_MAX_NS = 13  # longest time that the disk took to confirm
    FILES_REMOVED = 14  # oldest files of the ring of files that made room
    FAULTS_KEPT = 15
    FAULTS_REFUSED = 16  # fault files that were not written because there were already as many as allowed
    FAULTS_LOST = 17  # fault files that the disk refused
    DONE = 18  # 1 once everything is on disk and the recorder has ended


class Geometry(NamedTuple):
    """Where the parts of a ring file lie; bytes."""

    counters_at: int
    status_at: int
    states_at: int
    state_rows: int
    state_bytes: int
    seals_at: int
    rows_at: int
    rows: int
    row_bytes: int
    size: int

    @property
    def slot_bytes(self) -> int:
        """Bytes from one state slot to the next."""
        return STATE_MARK.size + -(-self.state_bytes // 8) * 8

    @property
    def copy_at(self) -> int:
        """Where the header stands a second time."""
        return align(self.rows_at + self.rows * self.row_bytes)


def align(size: int) -> int:
    """The next multiple of a page."""
    return -(-size // PAGE) * PAGE


def lay_out(text_bytes: int, rows: int, row_bytes: int, state_rows: int, state_bytes: int) -> Geometry:
    """The geometry of a ring with these sizes."""
    header = align(PREFIX.size + text_bytes)
    counters_at, status_at, states_at = header, header + PAGE, header + 2 * PAGE
    slot_bytes = Geometry(0, 0, 0, 0, state_bytes, 0, 0, 0, 0, 0).slot_bytes
    seals_at = align(states_at + state_rows * slot_bytes)
    rows_at = align(seals_at + (rows + state_rows) * SEAL.size)
    size = align(rows_at + rows * row_bytes) + header
    return Geometry(counters_at, status_at, states_at, state_rows, state_bytes, seals_at, rows_at, rows, row_bytes, size)


def pack_header(description: dict, rows: int, row_bytes: int, state_rows: int, state_bytes: int) -> tuple[bytes, Geometry]:
    """The header's bytes and the geometry that they announce."""
    text = json.dumps(description).encode()
    geometry = lay_out(len(text), rows, row_bytes, state_rows, state_bytes)
    start = PREFIX.pack(MAGIC, VERSION, len(text), *geometry, 0)
    return PREFIX.pack(MAGIC, VERSION, len(text), *geometry, zlib.crc32(text, zlib.crc32(start))) + text, geometry


def unpack_header(data, at: int = 0) -> tuple[Geometry, dict] | None:
    """Geometry and description of the header that starts at `at`; None where there is no whole version 2 header."""
    if len(data) - at < PREFIX.size:
        return None
    magic, version, text_bytes, *numbers, check = PREFIX.unpack_from(data, at)
    text = bytes(data[at + PREFIX.size : at + PREFIX.size + text_bytes])
    start = PREFIX.pack(magic, version, text_bytes, *numbers, 0)
    if magic != MAGIC or version != VERSION or zlib.crc32(text, zlib.crc32(start)) != check:
        return None
    return Geometry(*numbers), json.loads(text)
