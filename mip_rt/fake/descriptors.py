"""Makes reads or writes of a driver's open file fail: another file is put under its descriptor, as a kernel's error would look.

The driver is not touched: its descriptor is found by the path that it was opened with.
"""

import fcntl
import os

# Files whose writes (or reads) end with the errno: /proc/self/mem has nothing at address 0, clear_refs takes 1 to 5 only.
WRITES_FAIL = {"EIO": "/proc/self/mem", "EINVAL": "/proc/self/clear_refs", "ENOSPC": "/dev/full"}
READS_FAIL = "/proc/self/mem"


class _Broken:
    """A descriptor of a driver's that has another file under it.

    Args:
        fd: the descriptor.

    Attributes:
        whole: descriptor of what the driver has opened.
        path, mode: what that is.
        files: (path, flags) of the files put under it that were not taken away yet, the newest last.
        shown: what the system says is there now.
    """

    def __init__(self, fd: int):
        self.path, self.mode, self.whole = _path_of(fd), fcntl.fcntl(fd, fcntl.F_GETFL) & os.O_ACCMODE, os.dup(fd)
        self.files, self.shown = [], self.path

    def show(self, fd: int) -> None:
        """Puts the newest file, or the driver's own, under the descriptor, unless the driver has closed it."""
        if _path_of(fd) != self.shown:
            return
        there = os.open(self.files[-1][0], self.files[-1][1] | os.O_CLOEXEC) if self.files else os.dup(self.whole)
        os.dup2(there, fd, inheritable=False)
        os.close(there)
        self.shown = _path_of(fd)


_broken = {}  # _Broken by descriptor


def _path_of(fd: int) -> str:
    """What is under a descriptor; empty where it is closed."""
    try:
        return os.readlink(f"/proc/self/fd/{fd}")
    except OSError:
        return ""


def opened(path, modes: tuple) -> list[int]:
    """Descriptors that drivers of this process have opened on this path in one of these access modes (os.O_RDONLY, ...), broken ones included."""
    wanted, own = os.path.realpath(path), {broken.whole for broken in _broken.values()}
    found = [fd for fd, broken in _broken.items() if broken.path == wanted and broken.mode in modes and _path_of(fd) == broken.shown]
    for fd in map(int, os.listdir("/proc/self/fd")):
        try:
            if fd not in own and _path_of(fd) == wanted and fcntl.fcntl(fd, fcntl.F_GETFL) & os.O_ACCMODE in modes:
                found.append(fd)
        except OSError:
            continue  # closed meanwhile
    return found


def replace(fds: list[int], path: str, flags: int):
    """Puts the file `path` under the descriptors; returns a function that takes it away again. Several may lie under one at a time."""
    put = (path, flags)
    for fd in fds:
        if fd not in _broken:
            _broken[fd] = _Broken(fd)
        broken = _broken[fd]
        broken.files.append(put)
        broken.show(fd)

    def restore():
        for fd in fds:
            broken = _broken[fd]
            broken.files.remove(put)
            broken.show(fd)
            if not broken.files:
                os.close(broken.whole)
                del _broken[fd]

    return restore
