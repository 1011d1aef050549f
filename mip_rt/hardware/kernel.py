"""The calls through which drivers reach the Linux kernel; a dry run replaces this object and nothing above it.

Plain files (sysfs, serial ports) are opened below `root` with os.open, os.pread and os.pwrite; time, waiting, ioctl and the I2C bus go through
the methods here.
"""

import fcntl
import select
import subprocess
import time
from functools import partial
from pathlib import Path


class Kernel:
    """The real kernel.

    Attributes:
        root: where /sys and /dev hang.
    """

    root = Path("/")
    monotonic_ns = staticmethod(time.monotonic_ns)  # CLOCK_MONOTONIC, the clock of GPIO event timestamps

    def path(self, *parts: str) -> Path:
        """A path below the root; parts are relative."""
        return self.root.joinpath(*parts)

    def sleep(self, seconds: float) -> None:
        """Waits; for set-up code only."""
        time.sleep(seconds)

    def wait_readable(self, fd: int, timeout_s: float) -> bool:
        """True as soon as fd can be read, False after the timeout. The loop waits with `waiter`."""
        poll = select.poll()
        poll.register(fd, select.POLLIN)
        return bool(poll.poll(timeout_s * 1e3))

    def waiter(self, line, timeout_s: float):
        """wait() -> events of this hardware.input_events.InputEvents, as its `take`; 0 after the timeout, and minus the errno where the kernel refuses."""
        import numpy as np

        from mip_rt.compiled import direct  # not at the beginning: the guard has a kernel, and no numba
        from mip_rt.hardware import line_events, system_calls

        polled = np.zeros(1, system_calls.POLLED)
        bound = partial(direct(line_events.wait), line.state.ctypes.data, polled.ctypes.data, timeout_s)
        bound.owners = line, polled  # whose memory must live as long as this
        return bound

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
