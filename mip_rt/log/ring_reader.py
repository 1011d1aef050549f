"""Reading a ring file, of a running or a dead process, of this version or an older one."""

import json
import struct
import zlib
from pathlib import Path

import numpy as np

from mip_rt.errors import LogError
from mip_rt.log import ring_format
from mip_rt.log.log_data import Log, record_type, without_header
from mip_rt.log.migrations import migrate
from mip_rt.log.ring_format import HEADER_LIMIT, MAGIC, PAGE, STATE_MARK, START

SEAL = np.dtype([("sequence", "<i8"), ("check", "<u4"), ("inverted", "<u4")])
NO_VERSION = 1000  # a number from here on is a damaged one


def is_ring(data) -> bool:
    """The bytes are a ring file's, possibly a damaged one."""
    return data[: len(MAGIC)] == MAGIC or _header_at_the_end(data) is not None


def read_ring(path: Path, data, check: bool) -> Log:
    """Reads a ring of any version.

    Raises:
        LogError: it is of a later version, or of version 1 with a damaged header.
    """
    version = START.unpack_from(data)[1] if len(data) >= START.size and data[: len(MAGIC)] == MAGIC else 0
    if version == 1:
        return _read_version_1(path, data)
    found, damage = ring_format.unpack_header(data), []
    if found is None:
        found = _header_at_the_end(data)
        damage.append("the header is damaged, its copy at the end was used")
    if found is None and ring_format.VERSION < version < NO_VERSION:
        raise LogError(
            f"{path} is of log version {version}, this program reads up to {ring_format.VERSION}.", "Use a newer mip-rt.", "log_version"
        )
    if found is None:
        return without_header(path, "the header is damaged, and so is its copy at the end: nothing can be read")
    geometry, description = found
    frames = _rows(data, record_type(description), geometry.rows_at, geometry.rows, geometry.size, damage)
    seals = _seals(data, geometry)
    frames = _matching(frames, (frames["sequence"] - 1) % geometry.rows, seals, check, damage)
    return Log(path, migrate(description, path), frames, damage, _states(data, geometry, seals, check, damage))


VERSION_1 = struct.Struct("<8sIIQQQ")  # magic, version, JSON bytes, offset of the counter, offset of the rows, number of rows


def _read_version_1(path: Path, data) -> Log:
    """Version 1 had header, counter and rows, without checksums and kept states."""
    _, _, text_bytes, _, rows_at, rows = VERSION_1.unpack_from(data[: VERSION_1.size].ljust(VERSION_1.size, b"\xff"))
    if len(data) < VERSION_1.size + text_bytes:
        return without_header(path, "the file ends within its header: nothing can be read")
    try:
        description = migrate(json.loads(data[VERSION_1.size : VERSION_1.size + text_bytes]), path)
        dtype = record_type(description)
        frames = _rows(data, dtype, rows_at, rows, rows_at + rows * dtype.itemsize, damage := [])
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, MemoryError) as error:  # nothing protects this header
        raise LogError(f"the header of {path} is damaged: {error}.", code="log_header") from error
    return Log(path, description, frames, damage)


def _header_at_the_end(data):
    """The second copy of the header, or None: it starts on one of the last pages."""
    for at in range((len(data) - 1) // PAGE * PAGE, max(0, len(data) - HEADER_LIMIT), -PAGE):
        found = ring_format.unpack_header(data, at)
        if found:
            return found
    return None


def _rows(data, dtype, at: int, rows: int, size: int, damage: list):
    """Committed frames in order of tick; the writer may be at work."""
    present = max(0, min(rows, (len(data) - at) // dtype.itemsize))
    if len(data) != size:
        damage.append(f"the file has {len(data)} of {size} bytes, room for {present} of {rows} rows")
    table = np.frombuffer(data, dtype, present, at) if present else np.zeros(0, dtype)
    before = table["sequence"].copy()
    written = before != 0
    good = written & ((before - 1) % rows == np.arange(present)) & (table["tick"] == before - 1) if present else written
    if (written & ~good).any():
        damage.append(f"{int((written & ~good).sum())} rows were being written or do not say which tick they are")
    index = np.flatnonzero(good)
    index = index[np.argsort(before[index], kind="stable")]
    frames = table[index]
    still = (table["sequence"][index] == before[index]) & (frames["sequence"] == before[index])
    return frames if still.all() else frames[still]


def _seals(data, geometry):
    count = geometry.rows + geometry.state_rows
    present = max(0, min(count, (len(data) - geometry.seals_at) // SEAL.itemsize))
    seals = np.zeros(count, SEAL)
    if present:
        seals[:present] = np.frombuffer(data, SEAL, present, geometry.seals_at)
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
    damage += [f"the row of tick {frames['tick'][number]} does not match its checksum" for number in differs]
    return np.delete(frames, differs) if differs and check else frames


def _states(data, geometry, seals, check: bool, damage: list) -> dict[int, bytes]:
    states = {}
    for slot in range(geometry.state_rows):
        at = geometry.states_at + slot * geometry.slot_bytes
        copy = data[at : at + geometry.slot_bytes]
        if len(copy) < geometry.slot_bytes:
            damage.append(f"the file ends after {slot} of {geometry.state_rows} kept states")
            break
        sequence, tick = STATE_MARK.unpack_from(copy)
        if not sequence or sequence != tick + 1 or STATE_MARK.unpack_from(data, at)[0] != sequence:
            continue
        seal = seals[geometry.rows + slot]
        if seal["sequence"] == sequence and seal["check"] != zlib.crc32(copy):
            damage.append(f"the kept state of tick {tick} does not match its checksum")
            if check:
                continue
        states[tick] = copy[STATE_MARK.size : STATE_MARK.size + geometry.state_bytes]
    return dict(sorted(states.items()))
