"""Small tools for sysfs: finding devices by address, writing attributes, waiting for udev's permissions."""

import os
from pathlib import Path

PERMISSION_WAIT_S = 2.0


def find_by_address(folder: Path, pattern: str, address: str) -> Path | None:
    """The entry of `folder` that matches the glob pattern and whose resolved path holds the device address; None if none."""
    if not folder.is_dir():
        return None
    for entry in sorted(folder.glob(pattern)):
        if address in os.path.realpath(entry):
            return entry
    return None


def write(path: Path, text: str) -> None:
    """Writes an attribute in one system call, as sysfs wants it."""
    fd = os.open(path, os.O_WRONLY)
    try:
        os.write(fd, text.encode())
    finally:
        os.close(fd)


def read(path: Path) -> str:
    """An attribute without its newline."""
    return path.read_text().strip()


def wait_writable(kernel, path: Path, timeout_s: float = PERMISSION_WAIT_S) -> bool:
    """Waits for a file to appear and for udev, which works asynchronously, to make it writable."""
    for _ in range(int(timeout_s / 0.02)):
        if os.access(path, os.W_OK):
            return True
        kernel.sleep(0.02)
    return os.access(path, os.W_OK)
