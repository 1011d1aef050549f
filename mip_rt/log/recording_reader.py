"""Reading recorded files: every block whose checksum is right, in the order in which they were written."""

from pathlib import Path

import numpy as np

from mip_rt.log import block_format
from mip_rt.log.block_format import BLOCK, MAGIC, Kind
from mip_rt.log.log_data import Log, record_type, without_header
from mip_rt.log.migrations import migrate

NAMED_GAPS = 20  # more gaps between ticks are only counted


def is_recording(data) -> bool:
    """The bytes are a recorded file's, possibly a damaged one."""
    return data[: len(MAGIC)] == MAGIC or next(block_format.blocks(data), None) is not None


def read_recording(path: Path, files: list[tuple[str, object]]) -> Log:
    """Reads the files of one run, given in order, as one sequence.

    Args:
        path: what was opened.
        files: (name, mapped bytes) of each.

    Raises:
        LogError: a later version wrote them.
    """
    damage, whole = [], []
    for name, data in files:
        blocks = list(block_format.blocks(data))
        damage += _holes(name, data, blocks)
        whole += blocks
    header = next((block.json() for block in whole if block.kind == Kind.HEADER), None)
    if header is None:
        return without_header(path, f"{path} has no whole header: nothing can be read")
    header = migrate(header, path)
    whole = [block for block in whole if block.kind != Kind.HEADER]
    end = next((block.json() for block in reversed(whole) if block.kind == Kind.END), {})
    if not whole or whole[-1].kind != Kind.END:
        damage.append("the recording was cut off: it is still going on, or its last moment is missing")
        end = {}
    frames = _frames([block for block in whole if block.kind == Kind.ROWS], record_type(header), damage)
    damage += gaps(frames["tick"])
    states = {block.first: block.payload() for block in whole if block.kind == Kind.STATE}
    status = [block.json() for block in whole if block.kind == Kind.STATUS]
    return Log(path, header, frames, damage, states, status, end)


def _holes(name: str, data, blocks) -> list[str]:
    """Sentences about the bytes that are in no whole block."""
    sentences, at = [], 0
    for begin, end in [*((block.begin, block.end) for block in blocks), (len(data), len(data))]:
        if begin > at:
            missing = begin - at
            if data[at:begin].count(0) == missing:
                sentences.append(f"{name}: {missing} bytes from byte {at} on are zero")
            elif begin == len(data) and missing < BLOCK.size + (1 << 24) and data.find(MAGIC, at + 1) < 0:
                sentences.append(f"{name}: the last block, from byte {at} on, is not whole")
            else:
                sentences.append(f"{name}: {missing} bytes from byte {at} on are damaged")
        at = end
    return sentences


def _frames(blocks, dtype, damage: list):
    """The rows of all blocks in one array."""
    fitting = [block for block in blocks if block.raw_bytes == block.rows * dtype.itemsize]
    if len(fitting) < len(blocks):
        damage.append(f"{len(blocks) - len(fitting)} blocks hold rows of another kind than the header says")
    frames = np.empty(sum(block.rows for block in fitting), dtype)
    view, at = frames.view(np.uint8).reshape(len(frames), dtype.itemsize), 0
    for block in fitting:
        raw = np.frombuffer(block.payload(), np.uint8)
        shape = (dtype.itemsize, block.rows)
        view[at : at + block.rows] = raw.reshape(shape).T if block.columns else raw.reshape(shape[::-1])
        at += block.rows
    order = np.argsort(frames["tick"], kind="stable")
    frames = frames if (np.diff(order) == 1).all() else frames[order]
    twice = np.flatnonzero(np.diff(frames["tick"]) == 0) + 1
    if len(twice):
        damage.append(f"{len(twice)} rows are there twice")
        frames = np.delete(frames, twice)
    return frames


def gaps(tick) -> list[str]:
    """Sentences about ticks that are missing between those that are there."""
    before = np.flatnonzero(np.diff(tick) > 1)
    sentences = [f"ticks {tick[i] + 1} to {tick[i + 1] - 1} are missing" for i in before[:NAMED_GAPS].tolist()]
    if len(before) > NAMED_GAPS:
        sentences.append(f"and {len(before) - NAMED_GAPS} more gaps between ticks")
    return sentences
