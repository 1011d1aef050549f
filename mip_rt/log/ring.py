"""The ring: a memory-mapped, self-describing file whose rows are the working memory of the tick.

Layout: one page-aligned header (magic, format version, sizes, then JSON: field table, configuration, code version, host, clock
offsets), a page with the commit counter, then the rows. The loop fills row tick % rows in place and commits it by storing
tick + 1, first into the row's `sequence`, then into the counter; starting a row stores 0 into its `sequence`. A reader takes a row only
where its sequence says which tick it is, before and after copying: a torn row is recognised, and a process that dies leaves every
committed row readable.
"""

import json
import mmap
import os
import platform
import struct
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import mip_rt
from mip_rt import compiled, frame
from mip_rt.errors import LogError

MAGIC = b"MIPRTLOG"
VERSION = 1
PREFIX = struct.Struct("<8sIIQQQ")  # magic, version, JSON bytes, offset of the counter, offset of the rows, number of rows
PAGE = 4096


def _align(size: int) -> int:
    return -(-size // PAGE) * PAGE


def header(layout: frame.Layout, config_text: str, extra: dict | None = None) -> dict:
    """What a log says of itself."""
    import llvmlite

    return {
        "mip_rt": mip_rt.__version__,
        "source_hash": compiled.source_hash(),
        "fields": [f._asdict() for f in layout.fields],
        "estimate_names": layout.estimate_names,
        "row_bytes": layout.dtype.itemsize,
        "config": config_text,
        "versions": {"numba": compiled.numba.__version__, "numpy": np.__version__, "llvmlite": llvmlite.__version__},
        "host": {"machine": platform.machine(), "system": platform.platform(), "cpu": compiled.cpu_name()},
        "clock": {"monotonic_ns": time.monotonic_ns(), "realtime_ns": time.time_ns()},
        **(extra or {}),
    }


class Ring:
    """The writing side.

    Attributes:
        rows: (n,) records of the layout, mapped.
        buffer: the rows' bytes, for `struct.pack_into`.
        row_bytes: bytes of a row.
    """

    def __init__(self, path: Path, dtype: np.dtype, rows: int, description: dict):
        text = json.dumps(description).encode()
        counter_at = _align(PREFIX.size + len(text))
        rows_at = counter_at + PAGE
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o644)
            os.ftruncate(handle, rows_at + rows * dtype.itemsize)
        except OSError as error:
            raise LogError(
                f"the log {path} cannot be created: {error.strerror}.", "Name another folder with --log.", "log_create"
            ) from error
        self.path = path
        self.capacity = rows
        self.row_bytes = dtype.itemsize
        self._map = mmap.mmap(handle, 0)
        os.close(handle)
        self._map[: PREFIX.size + len(text)] = PREFIX.pack(MAGIC, VERSION, len(text), counter_at, rows_at, rows) + text
        self.buffer = memoryview(self._map)[rows_at:]
        self.rows = np.frombuffer(self._map, dtype, rows, rows_at)
        self._sequence = self.rows["sequence"]
        self._counter = np.frombuffer(self._map, "<i8", 1, counter_at)
        self.rows["sequence"] = 0  # touches every page, so that none is missing in a tick

    def begin(self, index: int) -> None:
        """Marks a row as being written."""
        self._sequence[index] = 0

    def commit(self, index: int, tick: int) -> None:
        """Makes a row visible to readers."""
        self._sequence[index] = tick + 1
        self._counter[0] = tick + 1

    def close(self) -> None:
        """Flushes the file; the mapping lives as long as anyone holds the rows."""
        self._map.flush()


@dataclass
class Log:
    """A log as read: see `open_log`.

    Attributes:
        header: what the log says of itself.
        frames: (n,) records in order of tick, every one complete.
        damage: sentences about what could not be read; empty for a whole log.
    """

    path: Path
    header: dict
    frames: np.ndarray
    damage: list[str] = field(default_factory=list)

    @property
    def config(self) -> str:
        """The full configuration, YAML."""
        return self.header.get("config", "")


def open_log(path) -> Log:
    """Reads a ring file, of a running or a dead process.

    Raises:
        LogError: the file is not a log, or its header is not whole.
    """
    path = Path(path)
    data = path.read_bytes()
    if len(data) < PREFIX.size or data[:8] != MAGIC:
        raise LogError(f"{path} is not a mip-rt log.", "Name the .ring file that the run's summary printed.", "log_magic")
    _, version, text_bytes, _, rows_at, rows = PREFIX.unpack_from(data)
    if version != VERSION:
        raise LogError(f"{path} is of log version {version}, this program reads {VERSION}.", code="log_version")
    try:
        description = json.loads(data[PREFIX.size : PREFIX.size + text_bytes])
        fields = [(f["name"], f["dtype"], tuple(f["shape"])) if f["shape"] else (f["name"], f["dtype"])
                  for f in description["fields"]]
        dtype = np.dtype(fields, align=True)
        if dtype.itemsize != description["row_bytes"]:
            raise ValueError("field table and row size disagree")
    except (ValueError, KeyError, TypeError) as error:
        raise LogError(f"the header of {path} is damaged: {error}.", code="log_header") from error
    whole = max(0, min(rows, (len(data) - rows_at) // dtype.itemsize))
    damage = [] if whole == rows else [f"the file ends after {whole} of {rows} rows"]
    table = np.frombuffer(data, dtype, whole, rows_at) if whole else np.zeros(0, dtype)
    sequence = table["sequence"]
    good = (sequence > 0) & ((sequence - 1) % rows == np.arange(whole)) & (table["tick"] == sequence - 1)
    torn = int(np.count_nonzero(~good & (sequence != 0)))
    if torn:
        damage.append(f"{torn} rows were being written or do not say which tick they are")
    frames = table[good]
    return Log(path, description, frames[np.argsort(frames["sequence"], kind="stable")], damage)
