"""Makes reads or writes of a driver's open file fail: another file is put under its descriptor, as a kernel's error would look.

The driver is not touched: its descriptor is found by the path that it was opened with.
"""

import fcntl
import os

# Files whose writes (or reads) end with the errno: /proc/self/mem has nothing at address 0, clear_refs takes 1 to 5 only.
WRITES_FAIL = {"EIO": "/proc/self/mem", "EINVAL": "/proc/self/clear_refs", "ENOSPC": "/dev/full"}
READS_FAIL = "/proc/self/mem"


def opened(path, modes: tuple) -> list[int]:
    """Descriptors of this process that were opened on this path in one of these access modes (os.O_RDONLY, ...)."""
    wanted = os.path.realpath(path)
    found = []
    for name in os.listdir("/proc/self/fd"):
        try:
            if os.readlink(f"/proc/self/fd/{name}") == wanted and fcntl.fcntl(int(name), fcntl.F_GETFL) & os.O_ACCMODE in modes:
                found.append(int(name))
        except OSError:
            continue  # closed meanwhile
    return found


def replace(fds: list[int], path: str, flags: int):
    """Puts the file `path` under the descriptors; returns a function that restores those that are still open."""
    saved = [(fd, os.dup(fd)) for fd in fds]
    bad = os.open(path, flags | os.O_CLOEXEC)
    for fd in fds:
        os.dup2(bad, fd, inheritable=False)
    shown = os.readlink(f"/proc/self/fd/{bad}")
    os.close(bad)

    def restore():
        for fd, copy in saved:
            try:
                if os.readlink(f"/proc/self/fd/{fd}") == shown:
                    os.dup2(copy, fd, inheritable=False)
            except OSError:
                pass  # the driver has closed it
            os.close(copy)

    return restore
