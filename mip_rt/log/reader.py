"""Reading a log: everything that is intact, in order, and sentences about what is not."""

import json
import mmap
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mip_rt.errors import LogError
from mip_rt.log import ring_format
from mip_rt.log.ring_format import MAGIC, PAGE, START

SEAL = np.dtype([("sequence", "<i8"), ("check", "<u4"), ("inverted", "<u4")])


@dataclass
class Log:
    """A log as read: see `open_log`.

    Attributes:
        header: what the log says of itself.
        frames: (n,) records in order of tick, every one complete.
        damage: sentences about what could not be read; empty for a whole log.
        states: by tick, the bytes of the controller's and the estimators' state after that tick, one a second.
    """

    path: Path
    header: dict
    frames: np.ndarray
    damage: list[str] = field(default_factory=list)
    states: dict[int, bytes] = field(default_factory=dict)

    @property
    def config(self) -> str:
        """The full configuration, YAML."""
        return self.header.get("config", "")


def record_type(description: dict) -> np.dtype:
    """The type of a row from the field table of a log's header.

    Raises:
        ValueError, KeyError, TypeError: the table is not one, or disagrees with the row size.
    """
    fields = [(f["name"], f["dtype"], tuple(f["shape"])) if f["shape"] else (f["name"], f["dtype"]) for f in description["fields"]]
    dtype = np.dtype(fields, align=True)
    if dtype.itemsize != description["row_bytes"]:
        raise ValueError("field table and row size disagree")
    return dtype


def open_log(path, check: bool = True) -> Log:
    """Reads a ring file, of a running or a dead process.

    Args:
        check: leave out rows that do not match their checksum; without, they are returned and only reported.

    Raises:
        LogError: the file is not a log.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        raise LogError(f"{path} cannot be read: {error}.", "Name the .ring file that the run's summary printed.", "log_read") from error
    if data[:8] != MAGIC and _header_at_the_end(data) is None:
        raise LogError(f"{path} is not a mip-rt log.", "Name the .ring file that the run's summary printed.", "log_magic")
    version = START.unpack_from(data)[1] if len(data) >= START.size else 0
    if version == 1:
        return _read_version_1(path, data)
    if version != ring_format.VERSION and _header_at_the_end(data) is None:
        raise LogError(f"{path} is of log version {version}, this program reads up to {ring_format.VERSION}.", code="log_version")
    return _read_ring(path, data, check)


def _header_at_the_end(data):
    """The second copy of the header, or None: it starts on one of the last pages."""
    for at in range((len(data) - 1) // PAGE * PAGE, max(0, len(data) - 64 * PAGE), -PAGE):
        found = ring_format.unpack_header(data, at)
        if found:
            return found
    return None


def _read_ring(path: Path, data, check: bool) -> Log:
    damage = []
    found = ring_format.unpack_header(data)
    if found is None:
        found = _header_at_the_end(data)
        if found is None:
            raise LogError(f"the header of {path} is damaged.", code="log_header")
        damage.append("the header is damaged, its copy at the end was used")
    geometry, description = found
    dtype = record_type(description)
    rows = geometry.rows
    whole = max(0, min(rows, (len(data) - geometry.rows_at) // dtype.itemsize))
    if len(data) != geometry.size:
        damage.append(f"the file has {len(data)} of {geometry.size} bytes, room for {whole} of {rows} rows")
    table = np.frombuffer(data, dtype, whole, geometry.rows_at) if whole else np.zeros(0, dtype)
    frames, bad = _committed(table, rows)
    if bad:
        damage.append(f"{bad} rows were being written or do not say which tick they are")
    seals = _seals(data, geometry)
    frames = _matching(frames, (frames["sequence"] - 1) % rows, seals, check, damage)
    return Log(path, description, frames, damage, _states(data, geometry, seals, check, damage))


def _committed(table, rows: int):
    """(frames in order of tick, number of rows that are neither empty nor committed); the writer may be at work."""
    before = table["sequence"].copy()
    written = before != 0
    good = written & ((before - 1) % rows == np.arange(len(table))) & (table["tick"] == before - 1)
    index = np.flatnonzero(good)
    index = index[np.argsort(before[index], kind="stable")]
    frames = table[index]
    still = (table["sequence"][index] == before[index]) & (frames["sequence"] == before[index])
    return frames[still] if not still.all() else frames, int(written.sum() - good.sum())


def _seals(data, geometry):
    whole = max(0, min(geometry.rows + geometry.state_rows, (len(data) - geometry.seals_at) // SEAL.itemsize))
    seals = np.zeros(geometry.rows + geometry.state_rows, SEAL)
    if whole:
        seals[:whole] = np.frombuffer(data, SEAL, whole, geometry.seals_at)
    seals["sequence"][seals["check"] ^ seals["inverted"] != 0xFFFFFFFF] = 0  # the seal itself is damaged: it says nothing
    return seals


def _matching(frames, index, seals, check: bool, damage: list):
    """The frames without those that differ from their seal. A row without a seal of its tick was never sealed: it counts."""
    sealed = seals[index]
    view = frames.view(np.uint8).reshape(len(frames), frames.itemsize)
    differs = [
        number for number in np.flatnonzero(sealed["sequence"] == frames["sequence"]).tolist()
        if zlib.crc32(view[number]) != sealed["check"][number]
    ]  # fmt: skip
    for number in differs:
        damage.append(f"the row of tick {frames['tick'][number]} does not match its checksum")
    return np.delete(frames, differs) if differs and check else frames


def _states(data, geometry, seals, check: bool, damage: list) -> dict[int, bytes]:
    states = {}
    for slot in range(geometry.state_rows):
        at = geometry.states_at + slot * geometry.slot_bytes
        copy = data[at : at + geometry.slot_bytes]
        if len(copy) < geometry.slot_bytes:
            damage.append(f"the file ends after {slot} of {geometry.state_rows} kept states")
            break
        sequence, tick = ring_format.STATE_MARK.unpack_from(copy)
        if not sequence or sequence != tick + 1 or ring_format.STATE_MARK.unpack_from(data, at)[0] != sequence:
            continue
        seal = seals[geometry.rows + slot]
        if seal["sequence"] == sequence and seal["check"] != zlib.crc32(copy):
            damage.append(f"the kept state of tick {tick} does not match its checksum")
            if check:
                continue
        states[tick] = copy[ring_format.STATE_MARK.size : ring_format.STATE_MARK.size + geometry.state_bytes]
    return dict(sorted(states.items()))


VERSION_1 = ring_format.struct.Struct("<8sIIQQQ")  # magic, version, JSON bytes, offset of the counter, offset of the rows, number of rows


def _read_version_1(path: Path, data) -> Log:
    """Version 1 had header, counter and rows, without checksums and states."""
    if len(data) < VERSION_1.size:
        raise LogError(f"the header of {path} is damaged.", code="log_header")
    _, _, text_bytes, _, rows_at, rows = VERSION_1.unpack_from(data)
    try:
        description = json.loads(data[VERSION_1.size : VERSION_1.size + text_bytes])
        dtype = record_type(description)
    except (ValueError, KeyError, TypeError) as error:
        raise LogError(f"the header of {path} is damaged: {error}.", code="log_header") from error
    whole = max(0, min(rows, (len(data) - rows_at) // dtype.itemsize))
    damage = [] if whole == rows else [f"the file ends after {whole} of {rows} rows"]
    frames, bad = _committed(np.frombuffer(data, dtype, whole, rows_at) if whole else np.zeros(0, dtype), rows)
    if bad:
        damage.append(f"{bad} rows were being written or do not say which tick they are")
    return Log(path, description, frames, damage)
