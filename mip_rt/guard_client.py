"""The loop's side of the guard: asks for the enable line, beats once a tick, and notices when the guard is gone.

`GuardClient` is the enable line as the motors know it; `GuardProcess` starts the guard beside it.
"""

import ctypes
import mmap
import os
import select
import subprocess
import sys
from array import array
from pathlib import Path

import mip_rt
from mip_rt.errors import GpioError, MipRtError
from mip_rt.guard_words import HALF, LOST, NEWEST, OK, REQUEST, STATUS, TIMEOUT, WORDS_BYTES, beat

PRIORITY_ABOVE_LOOP = 5  # 45 with the shipped 40: above the loop, still below the interrupt threads at 50
START_LIMIT_S = 15.0


class GuardClient:
    """The enable line through a guard.

    Args:
        words: four unsigned 32-bit words, shared with a `guard.Guard`.
        timeout_s: a guard whose own beat is older is lost.

    Attributes:
        memory: see guard_words.WORDS_AT.
        warnings: what the guard's process asked for and did not get, with cures.
    """

    def __init__(self, words, timeout_s: float):
        self._words = words
        self.memory = array("q", (ctypes.addressof(ctypes.c_char.from_buffer(words)), 0, 2, OK))  # request 0 stands for "nothing dropped yet"
        self.patience_s(timeout_s)
        self._given_up = False
        self.warnings = []

    def patience_s(self, seconds: float) -> None:
        """How old the guard's own beat may be; any age from 37 minutes on."""
        self.memory[TIMEOUT] = min(round(seconds * 1e9) >> 10, HALF)

    @property
    def status(self) -> int:
        """guard_words.OK, LINE_DROPPED or LOST, as of the last beat; LOST is for ever."""
        return self.memory[STATUS]

    def set(self, on: bool) -> None:
        """Asks for the line to be high or low. Never waits.

        Raises:
            OSError: it is wanted and the guard is gone.
        """
        if on != bool(self.memory[NEWEST] & 1):
            self.memory[NEWEST] += 1  # odd: wanted; a new number takes back what the guard has dropped
            self._words[REQUEST] = self.memory[NEWEST]
        if self.status == LOST and on:
            raise BrokenPipeError("the guard is gone")
        try:
            self._wake()
        except OSError:
            if on:
                raise

    def beat(self, now_ns: int) -> int:
        """The loop has come so far at this time; returns `status`."""
        status = beat(self._words, self.memory, now_ns)
        if status == LOST:
            self.give_up()
        return status

    def give_up(self) -> None:
        """The guard is lost: ends what may be left of it, once, so that the kernel takes the line from it."""
        if not self._given_up:
            self._given_up = True
            self._kill()

    def _wake(self) -> None:
        """Lets the guard look at once."""

    def _kill(self) -> None:
        """Ends the guard, where it still lives."""

    def wait_ready(self) -> None:
        """Returns when the guard holds the line, low."""

    def close(self) -> None:
        """Line low and released, guard ended."""


class GuardProcess(GuardClient):
    """A guard in its own process; starts it, and `wait_ready` hears whether it got the line.

    Args:
        line: (bank address, offset) of the enable line.
        timeout_s: limits.guard_timeout_s.
        realtime: the configuration's realtime section.
        module: which program: the guard on the real kernel, or the dry run's.
        arguments: what the module wants before the guard's own arguments.

    Attributes:
        pid: of the guard.
    """

    def __init__(self, line, timeout_s: float, realtime, module: str = "mip_rt.guard", arguments=()):
        self._ready = False
        memory = os.memfd_create("mip-rt-guard")
        os.ftruncate(memory, WORDS_BYTES)
        control, self._control = os.pipe()
        super().__init__(memoryview(mmap.mmap(memory, WORDS_BYTES)).cast("I"), timeout_s)
        os.set_blocking(self._control, False)
        command = (
            sys.executable, "-S", "-s", "-P", "-m", module, *arguments, memory, control, os.getpid(), *line, timeout_s,
            realtime.policy, min(realtime.priority + PRIORITY_ABOVE_LOOP, 99), int(realtime.lock_memory),
        )  # fmt: skip
        # Its own session: what is typed at the loop's terminal is not for the guard.
        self._process = subprocess.Popen(
            [str(word) for word in command], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, pass_fds=(memory, control),
            start_new_session=True, env={**os.environ, "PYTHONPATH": str(Path(mip_rt.__file__).parents[1])},
        )  # fmt: skip
        os.close(memory)
        os.close(control)
        self.pid = self._process.pid

    def wait_ready(self) -> None:
        """Returns when the guard holds the line, low; at once where that is known already.

        Raises:
            GpioError: it does not get the line, or does not start.
        """
        if self._ready:
            return
        output, poll = self._process.stdout, select.poll()
        poll.register(output, select.POLLIN)
        report = output.readline().decode() if poll.poll(START_LIMIT_S * 1e3) else ""
        state, *rest = report.rstrip("\n").split("\t")
        if state == "ready":
            self._ready = True
            self.warnings = [f"guard: {warning}" for warning in rest[2:]]
            return
        self.close()
        if state == "refused":
            code, sentence, cure = rest
            raise GpioError(sentence, cure, code)
        raise GpioError("the guard process did not start.", "Run python3 -m mip_rt.guard and read its error.", "guard_start")

    def _wake(self) -> None:
        try:
            os.write(self._control, b".")
        except BlockingIOError:
            pass  # it has not read the last ones: it is told already, or hangs and will be lost

    def _kill(self) -> None:
        self._process.kill()

    def close(self) -> None:
        """Line low and released, guard ended. A second call does nothing."""
        if self._control < 0:
            return
        self.set(False)
        os.close(self._control)
        self._control = -1
        try:
            self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


def start(config, machine=None) -> GuardProcess:
    """The guard of a robot, or of a dry run's machine (fake.machine.Machine).

    Raises:
        HardwareError: the board is unknown.
    """
    from mip_rt.hardware.boards import GPIO, board
    from mip_rt.hardware.kernel import Kernel

    bank, offset = (machine.pins if machine else board(config.board, Kernel())).enable
    where = ("mip_rt.fake.guard", (machine.folder,)) if machine else ("mip_rt.guard", ())
    try:
        return GuardProcess((GPIO[bank], offset), config.limits.guard_timeout_s, config.realtime, *where)
    except OSError as error:
        raise MipRtError(f"the guard process cannot be started: {error.strerror}.", "Free memory or raise the process limit.", "guard_start") from error
