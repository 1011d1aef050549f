"""The blocks of a recorded file: self-delimiting, numbered, each with its CRC, so that whatever is whole can be found again. Needs no numpy.

A file is a sequence of blocks and starts with a HEADER block (repeated now and then, in case the first is damaged), so every
file can be read alone. Rows are stored byte column by byte column, which makes them smaller and cheaper to compress than row by row.
"""

import json
import struct
import zlib
from enum import IntEnum
from typing import NamedTuple

MAGIC = b"MIPBLOCK"
BLOCK = struct.Struct("<8sHHIqIIQI4x")  # magic, kind, encoding, stored bytes, first tick, rows, raw bytes, sequence, CRC-32
SUFFIX = ".miplog"


class Kind(IntEnum):
    """What a block holds."""

    HEADER = 1  # the log's description, JSON
    ROWS = 2  # frames
    STATE = 3  # the controller's and the estimators' state after tick `first`
    STATUS = 4  # clocks and the recorder's counters, JSON
    END = 5  # why the file ends here, JSON


class Encoding(IntEnum):
    """How the payload is stored."""

    RAW = 0
    ZLIB = 1
    COLUMNS = 2  # bytes transposed from (rows, bytes of a row), then zlib


class Block(NamedTuple):
    """A block that is whole."""

    kind: int
    encoding: int
    stored: bytes
    first: int
    rows: int
    raw_bytes: int
    sequence: int
    begin: int
    end: int

    def payload(self) -> bytes:
        """The payload; rows stay in columns (`columns` tells).

        Raises:
            zlib.error: a bug of the writer; the CRC was right.
        """
        return bytes(self.stored) if self.encoding == Encoding.RAW else zlib.decompress(self.stored)

    @property
    def columns(self) -> bool:
        """The payload is transposed."""
        return self.encoding == Encoding.COLUMNS

    def json(self) -> dict:
        """The payload of a HEADER, STATUS or END block."""
        return json.loads(self.payload())


def pack(kind: Kind, payload: bytes, sequence: int, level: int, first: int = 0, rows: int = 0) -> bytes:
    """A block as it stands in the file.

    Args:
        level: of zlib; 0 stores as it is.
        first: the first tick of the payload.
        rows: how many frames it holds.
    """
    encoding, stored = Encoding.RAW, payload
    if level and rows:
        row_bytes = len(payload) // rows
        encoding, stored = Encoding.COLUMNS, zlib.compress(b"".join([payload[k::row_bytes] for k in range(row_bytes)]), level)
    elif level:
        encoding, stored = Encoding.ZLIB, zlib.compress(payload, level)
    fields = (MAGIC, kind, encoding, len(stored), first, rows, len(payload), sequence)
    return BLOCK.pack(*fields, zlib.crc32(stored, zlib.crc32(BLOCK.pack(*fields, 0)))) + stored


def pack_json(kind: Kind, content: dict, sequence: int, level: int = 1) -> bytes:
    """A block of JSON."""
    return pack(kind, json.dumps(content).encode(), sequence, level)


def block_at(data, at: int) -> Block | None:
    """The block that starts at `at`, None where there is no whole one."""
    if len(data) - at < BLOCK.size:
        return None
    magic, kind, encoding, size, first, rows, raw_bytes, sequence, check = BLOCK.unpack_from(data, at)
    end = at + BLOCK.size + size
    if magic != MAGIC or end > len(data):
        return None
    stored = data[at + BLOCK.size : end]
    start = BLOCK.pack(magic, kind, encoding, size, first, rows, raw_bytes, sequence, 0)
    if zlib.crc32(stored, zlib.crc32(start)) != check:
        return None
    return Block(kind, encoding, stored, first, rows, raw_bytes, sequence, at, end)


def blocks(data):
    """Yields every whole Block of a file (mapped or bytes), in order; what lies between them is damaged."""
    at = 0
    while at < len(data):
        block = block_at(data, at)
        if block is not None:
            yield block
            at = block.end
            continue
        at = data.find(MAGIC, at + 1)
        if at < 0:
            return
