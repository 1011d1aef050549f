"""The ring of files on disk: a bounded number of bytes, of which the oldest make room. Needs no numpy.

    FOLDER/RUN/00000017.miplog                     files of one run; numbers go on from run to run
    FOLDER/fault-20260131-120000-tipped-….miplog   kept until the user removes them
"""

import os
from pathlib import Path

from mip_rt.log.block_format import SUFFIX

SMALLEST = 1 << 16  # a file counts as at least so many bytes, which bounds the number of small ones


class AppendFile:
    """A file that grows by whole blocks: what a refused write left behind is cut off again.

    Raises:
        OSError: from every method, whatever the disk says.
    """

    def __init__(self, path: Path):
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.size = path, 0
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        sync_folder(path.parent)
        sync_folder(path.parent.parent)

    def append(self, data: bytes) -> None:
        """Writes all of it or nothing."""
        view, at = memoryview(data), self.size
        try:
            while view:
                written = os.pwrite(self._fd, view, at)
                view, at = view[written:], at + written
        except OSError:
            os.ftruncate(self._fd, self.size)
            raise
        self.size = at

    def sync(self) -> None:
        """Returns when the disk has it."""
        os.fdatasync(self._fd)

    def close(self) -> None:
        """Closes without waiting."""
        os.close(self._fd)


def sync_folder(folder: Path) -> None:
    """Makes a new name in the folder survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    except OSError:
        pass  # some file systems cannot; the file itself is synced all the same
    finally:
        os.close(handle)


def number_of(path: Path) -> int | None:
    """The number in a recorded file's name, None for other files."""
    return int(path.stem) if path.suffix == SUFFIX and path.stem.isdigit() else None


def recorded_files(folder: Path) -> list[Path]:
    """All files of all runs below `folder`, oldest first."""
    return sorted((path for path in Path(folder).glob(f"*/*{SUFFIX}") if number_of(path) is not None), key=number_of)


def fault_files(folder: Path) -> list[Path]:
    """The fault files that are kept in `folder`."""
    return sorted(Path(folder).glob(f"fault-*{SUFFIX}"))


def make_room(folder: Path, limit_bytes: int, wanted_bytes: int) -> int:
    """Removes the oldest recorded files until `wanted_bytes` more fit into the limit; how many it removed."""
    files = recorded_files(folder)
    sizes = [max(path.stat().st_size, SMALLEST) for path in files]
    total, removed = sum(sizes) + wanted_bytes, 0
    for path, size in zip(files, sizes):
        if total <= limit_bytes:
            break
        path.unlink()
        try:
            path.parent.rmdir()
        except OSError:
            pass  # the run has more files
        total -= size
        removed += 1
    return removed
