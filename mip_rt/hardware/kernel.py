"""The calls through which drivers reach the Linux kernel; a dry run replaces this object and nothing above it.

Plain files (sysfs, serial ports) are opened below `root` with os.open, os.pread and os.pwrite; time, waiting, ioctl and the I2C bus go through
the methods here.
"""

import fcntl
import select
import subprocess
import time
from pathlib import Path


class Kernel:
    """The real kernel.

    Attributes:
        root: where /sys and /dev hang.
    """

    root = Path("/")

    def __init__(self):
        self._poll = select.poll()
        self._polled = -1

    def path(self, *parts: str) -> Path:
        """A path below the root; parts are relative."""
        return self.root.joinpath(*parts)

    def monotonic_ns(self) -> int:
        """CLOCK_MONOTONIC, the clock of GPIO event timestamps."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """Waits; for set-up code only."""
        time.sleep(seconds)

    def wait_readable(self, fd: int, timeout_s: float) -> bool:
        """True as soon as fd can be read, False after the timeout."""
        if fd != self._polled:
            if self._polled >= 0:
                self._poll.unregister(self._polled)
            self._poll.register(fd, select.POLLIN)
            self._polled = fd
        return bool(self._poll.poll(timeout_s * 1000.0))

    def ioctl(self, fd: int, request: int, argument, mutate: bool = True):
        """fcntl.ioctl."""
        return fcntl.ioctl(fd, request, argument, mutate)

    def command(self, *words: str, timeout_s: float = 10.0) -> tuple[int, str]:
        """(exit code, output and error) of another program; 127 where it is missing, 124 where it took too long. For mip-rt doctor only."""
        try:
            done = subprocess.run(words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=timeout_s)
        except FileNotFoundError:
            return 127, f"{words[0]}: not found"
        except subprocess.TimeoutExpired:
            return 124, f"{words[0]} did not end within {timeout_s:g} s"
        except OSError as error:
            return 126, str(error)
        return done.returncode, done.stdout.decode(errors="replace")

    def open_i2c(self, bus: int):
        """A hardware.i2c.I2cBus; drivers use `i2c_rdwr`, `prepare`, `transfer` and `close` only."""
        from mip_rt.hardware.i2c import I2cBus

        return I2cBus(bus)
