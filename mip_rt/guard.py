"""The guard: a small process that holds the motor-enable line and lets go of it when the control loop no longer proves that it runs.

The line is high only while the loop asks for it and the loop's heartbeat is younger than `limits.guard_timeout_s`. It falls when the
heartbeat stops (a hung, stopped or blocked loop), when the loop's process is gone (its end of the pipe closes), when the loop says so,
and, by the kernel, when the guard itself is gone. After a heartbeat that stopped the line stays low until the loop asks anew, which
the supervisor does only after the whole gesture of arming.

Loop and guard share four 32-bit words, each written by one side with one aligned store: there is no lock that a hung loop could hold, and
nothing that a 32-bit processor could tear. Times are CLOCK_MONOTONIC in units of 1.024 us, modulo 2^32. The pipe only wakes the
guard, so that a request is answered at once instead of at the next look.

The guard imports nothing of the controller, so it starts before numba is loaded and stays small. It runs at a higher SCHED_FIFO
priority than the loop, which therefore cannot starve it, and does nothing else.
"""

import os
import select
import signal
import sys
import time

from mip_rt import realtime
from mip_rt.errors import MipRtError
from mip_rt.guard_words import WORDS_BYTES, stamp, time_left
from mip_rt.hardware.gpio import OutputLines

LOOK_S = 0.020  # the guard looks, and beats itself, at least so often


class Guard:
    """The decision, without clock, line or process: the same code in the guard's process and on virtual time.

    Args:
        words: four unsigned 32-bit words, shared with a `guard_client.GuardClient`.
        timeout_s: largest age of the loop's heartbeat.

    Attributes:
        timeout: the same in the words' units.
    """

    def __init__(self, words, timeout_s: float):
        self._words = words
        self.timeout = stamp(round(timeout_s * 1e9))
        self._look = stamp(round(LOOK_S * 1e9))
        self._wait = self._look

    def step(self, now_ns: int) -> int:
        """Level of the line at this time, 0 or 1."""
        left = time_left(self._words, self.timeout, now_ns)
        self._wait = self._look if left < 0 else min(left + 1, self._look)
        return int(left >= 0)

    @property
    def wait_ms(self) -> float:
        """How long the guard may sleep after a step: until the heartbeat would be too old, or until its next look."""
        return self._wait * 1.024e-3


def watch(guard: Guard, line: OutputLines, control_fd: int, parent: int) -> None:
    """Drives the line until the loop's process is gone, and then low. OSError where the kernel refuses: who calls must then let it go."""
    poll = select.poll()
    poll.register(control_fd, select.POLLIN)
    level = 0
    # A process that the loop has forked may keep the pipe open: then the changed parent tells.
    while os.getppid() == parent:
        wanted = guard.step(time.monotonic_ns())
        if wanted != level:
            line.set(wanted, 1)
            level = wanted
        if poll.poll(guard.wait_ms) and not os.read(control_fd, 64):
            break
    line.set(0, 1)


def main(kernel, arguments) -> int:
    """The process. `arguments`: words' descriptor, pipe's descriptor, parent's process id, bank address, line offset, time limit in s,
    policy, priority, 1 to lock memory. Reports one line on standard output: "ready", policy, priority and warnings, or "refused", code,
    sentence and cure, separated by tabs.
    """
    import mmap

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # meant for the loop, which stops in good order and then closes the pipe
        signal.signal(number, signal.SIG_IGN)
    words_fd, control_fd, parent, address, offset, timeout_s, policy, priority, lock = arguments
    words = memoryview(mmap.mmap(int(words_fd), WORDS_BYTES)).cast("I")
    try:
        line = OutputLines(kernel, address, (int(offset),), 0, "mip-rt enable")
    except MipRtError as error:
        _report("refused", error.code, error.sentence, error.cure)
        return 3
    obtained = realtime.enter(policy, int(priority), lock == "1")
    _report("ready", obtained.policy, str(obtained.priority), *obtained.warnings)
    try:
        watch(Guard(words, float(timeout_s)), line, int(control_fd), int(parent))
    except OSError as error:
        print(f"mip-rt guard: the enable line cannot be driven: {error}; it is released", file=sys.stderr)
        return 3
    finally:
        line.close()
    return 0


def _report(*words: str) -> None:
    os.write(1, "\t".join(words).encode() + b"\n")


if __name__ == "__main__":
    from mip_rt.hardware.kernel import Kernel

    sys.exit(main(Kernel(), sys.argv[1:]))
