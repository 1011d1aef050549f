"""Opening a log: a ring, a recorded file, or a folder of them; everything that is intact, in order, and sentences about what is not."""

import mmap
from pathlib import Path

import numpy as np

from mip_rt.errors import LogError
from mip_rt.log import recording_reader, ring_reader
from mip_rt.log.block_format import SUFFIX
from mip_rt.log.log_data import Log, without_header
from mip_rt.log.recording_files import number_of, recorded_files
from mip_rt.log.ring_format import PAGE

CURE = "Name a .ring or .miplog file, or the folder that the run's summary printed."


def open_log(path, check: bool = True) -> Log:
    """Reads a log, of a run that has ended or goes on.

    Args:
        path: a ring file, a recorded file, a run's folder, or a folder of runs (its newest run is read).
        check: leave out rows of a ring that do not match their checksum; without, they are returned and only reported.

    Raises:
        LogError: there is nothing of a log, or it is of a later version.
    """
    path = Path(path)
    if path.is_dir():
        return _open_folder(path, check)
    data = _map(path)
    if ring_reader.is_ring(data):
        return ring_reader.read_ring(path, data, check)
    if recording_reader.is_recording(data):
        return recording_reader.read_recording(path, [(path.name, data)])
    if path.suffix in (SUFFIX, ".ring") and data[:PAGE].count(0) == len(data[:PAGE]):
        return without_header(path, f"{path.name} is empty or filled with zeros: its start never reached the disk")
    raise LogError(f"{path} is not a mip-rt log.", CURE, "log_magic")


def _map(path: Path):
    """The file's bytes, mapped."""
    try:
        with path.open("rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except ValueError:  # an empty file cannot be mapped
        return b""
    except OSError as error:
        raise LogError(f"{path} cannot be read: {error.strerror}.", CURE, "log_read") from error


def _open_folder(folder: Path, check: bool) -> Log:
    """The newest run in the folder, from its recorded files and, where it is there, from its ring."""
    files = sorted((f for f in folder.glob(f"*{SUFFIX}") if number_of(f) is not None), key=number_of)
    if not files:
        everywhere = recorded_files(folder)
        files = [f for f in everywhere if f.parent == everywhere[-1].parent]
    rings = sorted(folder.glob("*.ring"), key=lambda f: f.stat().st_mtime_ns)
    recorded = None
    if files:
        recorded = recording_reader.read_recording(folder, [(f.name, _map(f)) for f in files])
        recorded.damage += _missing_files(files)
    for path in reversed(rings):
        ring = open_log(path, check)
        if recorded is None or not recorded.header:
            return ring
        if ring.header.get("run") == recorded.header.get("run"):
            return _joined(recorded, ring)
    if recorded is None:
        raise LogError(f"there is no log in {folder}.", CURE, "log_magic")
    return recorded


def _missing_files(files) -> list[str]:
    """Sentences about gaps in the numbers; the oldest may be gone, they made room."""
    numbers = [number_of(file) for file in files]
    return [
        f"{before:08d}{SUFFIX} is followed by {after:08d}{SUFFIX}: {after - before - 1} files are missing"
        for before, after in zip(numbers, numbers[1:]) if after != before + 1
    ]  # fmt: skip


def _joined(recorded: Log, ring: Log) -> Log:
    """The recorded log with what only the ring of the same run has."""
    more = ring.frames[~np.isin(ring.frames["tick"], recorded.frames["tick"])]
    if not len(more):
        return recorded
    frames = np.concatenate([recorded.frames, more])
    frames = frames[np.argsort(frames["tick"], kind="stable")]
    damage = [sentence for sentence in recorded.damage if not sentence.startswith("ticks ")] + ring.damage + recording_reader.gaps(frames["tick"])
    states = dict(sorted({**ring.states, **recorded.states}.items()))
    return Log(recorded.path, recorded.header, frames, damage, states, recorded.recorder, recorded.end)
