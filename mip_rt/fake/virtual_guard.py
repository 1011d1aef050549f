"""The guard of a dry run on virtual time.

A process that lives in real time cannot watch a loop on a virtual clock. There, and only there, the guard's decision runs within the
simulated world, once a sample, and drives the same line through the same driver; so a run stays deterministic.
"""

from mip_rt.guard import Guard
from mip_rt.guard_client import GuardClient
from mip_rt.guard_words import WORDS_BYTES
from mip_rt.hardware.gpio import OutputLines


class VirtualGuard(GuardClient):
    """Both sides of the guard in one process.

    Args:
        kernel: fake.kernel.FakeKernel, which calls `step` at every sample.
        line: (bank address, offset) of the enable line.
        timeout_s: limits.guard_timeout_s.

    Attributes:
        alive: False after the guard was killed.
        timeout: largest age of the loop's heartbeat, in the units of guard_words.
    """

    def __init__(self, kernel, line, timeout_s: float):
        words = memoryview(bytearray(WORDS_BYTES)).cast("I")
        super().__init__(words, timeout_s)
        self._kernel, self._guard = kernel, Guard(words, timeout_s)
        self._line = OutputLines(kernel, line[0], (line[1],), 0, "mip-rt enable")
        self.alive, self.timeout = True, self._guard.timeout

    def step(self, now_ns: int) -> None:
        """The guard looks at its words."""
        if self.alive:
            level = self._guard.step(now_ns)
            if level != self._line.values:
                self._line.set(level, 1)

    def kill(self) -> None:
        """The guard dies: the kernel releases its line."""
        if self.alive:
            self.alive = False
            self._line.close()

    def _wake(self) -> None:
        if not self.alive:
            raise BrokenPipeError("the guard is gone")
        self.step(self._kernel.monotonic_ns())

    _kill = kill

    def close(self) -> None:
        """Line low and released."""
        self.set(False)
        self.kill()
