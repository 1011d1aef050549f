"""The guard: its decision by property, its process by killing, stopping and hanging what it guards, and itself."""

import os
import shutil
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from helpers import make_config
from hypothesis import given
from hypothesis import strategies as st

from mip_rt import guard, guard_client, guard_words, realtime
from mip_rt.errors import GpioError
from mip_rt.fake.gpio import FakeGpio
from mip_rt.fake.machine import Machine
from mip_rt.hardware.boards import GPIO

TIMEOUT_S = 0.06
BOUND_S = 0.1  # the promise
MS = 1_000_000
LINE = (GPIO[0], 20)


def words():
    return memoryview(bytearray(guard_words.WORDS_BYTES)).cast("I")


class Pair:
    """Guard and client on the same words, and a clock."""

    def __init__(self, now_ns=0):
        shared = words()
        self.guard, self.client = guard.Guard(shared, TIMEOUT_S), guard_client.GuardClient(shared, TIMEOUT_S)
        self.now_ns = now_ns
        self.guard.step(now_ns)

    def step(self, milliseconds):
        self.now_ns += round(milliseconds * MS)
        return self.guard.step(self.now_ns)


# -- the decision ----------------------------------------------------------------------------------------------------
@given(
    st.integers(0, 2**33),
    st.lists(st.tuples(st.sampled_from(["beat", "ask", "release", "nothing"]), st.floats(0.0, 80.0)), max_size=60),
)
def test_line_is_high_only_while_asked_and_beating(start_us, actions):
    """Prevents a high line without a request, beyond the heartbeat's limit, or again after a drop without being asked anew."""
    pair = Pair(start_us * 1000)
    asked, dropped, beat_ns = False, False, None
    for action, wait_ms in actions:
        if action == "beat":
            pair.client.beat(pair.now_ns)
            beat_ns = pair.now_ns
        elif action in ("ask", "release"):
            if asked != (action == "ask"):
                asked, dropped = action == "ask", False
            pair.client.memory[guard_words.STATUS] = guard_words.OK  # it lives
            pair.client.set(asked)
        level = pair.step(wait_ms)
        fresh = beat_ns is not None and pair.now_ns - beat_ns < TIMEOUT_S * 1e9
        stale = beat_ns is not None and pair.now_ns - beat_ns > TIMEOUT_S * 1e9 + 2048
        if level:
            assert asked and not dropped and not stale
        elif asked and fresh and not dropped:
            pytest.fail("low, though asked for and beating")
        dropped = dropped or (asked and not level)


@given(st.integers(0, 2**40), st.integers(-(2**30), 2**30))
def test_age_survives_the_wrap_of_its_clock(then, difference):
    """Prevents a drop (or none) each 73 minutes, when the 32-bit stamp starts again."""
    words = [then & guard_words.MASK, 1, 0, 0]  # a beat then, the line wanted
    left = guard_words.time_left(words, 1000, then + difference << 10)
    assert left == (1000 - difference if difference <= 1000 else -1) and words[guard_words.DROPPED] == (difference > 1000)


def test_guard_wakes_when_the_heartbeat_would_be_too_old():
    """Prevents a drop that waits for the guard's next look: it sleeps no longer than until the limit."""
    pair = Pair()
    pair.client.set(True)
    pair.client.beat(pair.now_ns)
    assert pair.step(55) == 1 and 4.9 < pair.guard.wait_ms < 5.1
    assert pair.step(pair.guard.wait_ms + 0.002) == 0
    assert pair.guard.wait_ms == pytest.approx(guard.LOOK_S * 1e3, rel=0.01)


def test_a_heartbeat_that_returns_does_not_raise_the_line():
    """Prevents motors that come on by themselves after a hang."""
    pair = Pair()
    pair.client.set(True)
    pair.client.beat(pair.now_ns)
    assert pair.step(1) == 1 and pair.step(70) == 0
    assert pair.client.beat(pair.now_ns) == guard_words.LINE_DROPPED
    assert pair.step(1) == 0
    pair.client.set(True)  # not anew
    assert pair.step(1) == 0
    pair.client.set(False)
    pair.client.set(True)
    assert pair.client.beat(pair.now_ns) == guard_words.OK and pair.step(1) == 1


def test_a_silent_guard_is_lost_for_good():
    """Prevents arming without a guard; and a guard that hangs with the line high must be ended."""
    pair, ended = Pair(), []
    pair.client._kill = lambda: ended.append(True)
    assert pair.client.beat(pair.now_ns + 59 * MS) == guard_words.OK
    assert pair.client.beat(pair.now_ns + 61 * MS) == guard_words.LOST and ended == [True]
    pair.step(61)
    assert pair.client.beat(pair.now_ns) == guard_words.LOST and ended == [True]
    with pytest.raises(OSError, match="gone"):
        pair.client.set(True)
    pair.client.set(False)


# -- the process -----------------------------------------------------------------------------------------------------
LOOP = """
import os, sys, time
from mip_rt import config, guard_client, realtime
from mip_rt.fake.machine import Machine
settings = config.load(config.default_path("mbbr"))
machine = Machine(settings)
guard = guard_client.start(settings, machine)
guard.wait_ready()
realtime.enter("fifo", 40, False)
guard.beat(time.monotonic_ns())
guard.set(True)
if "fork" in sys.argv and os.fork() == 0:
    time.sleep(3)  # a child that inherited the pipe's end
    os._exit(0)
print(machine.folder, guard.pid, flush=True)
while True:
    status = guard.beat(time.monotonic_ns())
    if status:
        print("status", status, time.monotonic_ns(), flush=True)
        time.sleep(0.2)
        guard.set(False)
        if status == 1:
            guard.beat(time.monotonic_ns())
            guard.set(True)
            print("again", flush=True)
    time.sleep(0.005)
    if "hang" in sys.argv and os.path.exists(machine.folder / "hang"):
        while True:
            pass
"""


class Running:
    """A process that beats 200 times a second and has asked for the line."""

    def __init__(self, *arguments):
        self.process = subprocess.Popen([sys.executable, "-c", LOOP, *arguments], stdout=subprocess.PIPE, text=True)
        self.folder, guard_pid = self.process.stdout.readline().split()
        self.guard = int(guard_pid)
        self.gpio = FakeGpio(self.folder)
        self.until(1)

    def until(self, level, limit_s=1.0):
        """Seconds until the line has this level."""
        begin = time.monotonic()
        while self.gpio.line_value(*LINE) != level:
            time.sleep(0.0002)
            assert time.monotonic() - begin < limit_s, f"the line is not {level} after {limit_s} s"
        return time.monotonic() - begin

    def close(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        shutil.rmtree(self.folder, ignore_errors=True)


@pytest.fixture
def running(request):
    realtime.enter("fifo", 60, False)  # the observer's own delays are not the guard's
    loop = Running(*getattr(request, "param", ()))
    yield loop
    loop.close()
    realtime.leave()


def gone(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.parametrize("running", [(), ("fork",)], indirect=True, ids=["alone", "pipe inherited by a fork"])
def test_killed_loop_drops_the_line_and_ends_the_guard(running):
    """Prevents motors that run on after SIGKILL, and a guard that then keeps the line from the next start."""
    running.process.kill()
    assert running.until(0) <= BOUND_S
    begin = time.monotonic()
    while not gone(running.guard):
        time.sleep(0.001)
        assert time.monotonic() - begin < 0.2


def test_stopped_loop_drops_the_line_until_it_asks_anew(running):
    """Prevents motors that run on through SIGSTOP, a debugger or a blocked bus, and motors that come back with the loop."""
    for _ in range(3):
        running.process.send_signal(signal.SIGSTOP)
        assert TIMEOUT_S - 0.02 <= running.until(0) <= BOUND_S
        running.process.send_signal(signal.SIGCONT)
        assert running.process.stdout.readline().split()[:2] == ["status", str(guard_words.LINE_DROPPED)]
        time.sleep(0.05)
        assert running.gpio.line_value(*LINE) == 0
        assert running.process.stdout.readline() == "again\n"
        running.until(1)


@pytest.mark.parametrize("running", [("hang",)], indirect=True)
def test_spinning_loop_drops_the_line(running):
    """Prevents a loop that spins under SCHED_FIFO from starving its guard."""
    open(f"{running.folder}/hang", "w").close()
    assert running.until(0) <= BOUND_S


def test_killed_guard_drops_the_line_and_the_loop_notices(running):
    """Prevents balancing on without a guard."""
    begin = time.monotonic_ns()
    os.kill(running.guard, signal.SIGKILL)
    assert running.until(0) <= BOUND_S
    word, status, when = running.process.stdout.readline().split()
    assert (word, status) == ("status", str(guard_words.LOST)) and (int(when) - begin) * 1e-9 <= BOUND_S


def test_stopped_guard_is_ended_and_the_line_falls(running):
    """Prevents a hung guard from holding the line high: then a hung loop would have nobody to stop it."""
    os.kill(running.guard, signal.SIGSTOP)
    assert running.until(0) <= BOUND_S
    assert gone(running.guard)


def test_guard_and_loop_killed_together(running):
    """Prevents a line that outlives both."""
    os.kill(running.guard, signal.SIGKILL)
    running.process.kill()
    assert running.until(0) <= BOUND_S


def test_guard_outlives_signals_meant_for_the_loop(running):
    """Prevents Ctrl-C and `systemctl stop` from ending the guard before the loop has stopped in good order."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(running.guard, number)
    time.sleep(0.15)
    assert not gone(running.guard) and running.gpio.line_value(*LINE) == 1


def test_guard_is_small_and_runs_above_the_loop(running):
    """Prevents a guard that the loop can starve, that can be paged out, or that loads what it does not need."""
    with open(f"/proc/{running.guard}/status") as file:
        status = dict(line.split(":", 1) for line in file.read().splitlines())
    with open(f"/proc/{running.guard}/maps") as file:
        loaded = file.read()
    assert "numpy" not in loaded and "llvmlite" not in loaded
    assert int(status["VmRSS"].split()[0]) < 32 * 1024
    if realtime.enter("fifo", 60, False).policy == "fifo":
        assert os.sched_getscheduler(running.guard) == os.SCHED_FIFO
        assert os.sched_getparam(running.guard).sched_priority > os.sched_getparam(running.process.pid).sched_priority
        assert int(status["VmLck"].split()[0]) > 0


@pytest.fixture
def machine():
    board = Machine(make_config())
    yield board
    board.close()


def test_orderly_use(machine):
    """Prevents a line that is not low before the first request, or that is still held after the end."""
    client = guard_client.start(make_config(), machine)
    client.wait_ready()
    assert machine.gpio.bank(LINE[0]).held(LINE[1]) and machine.gpio.line_value(*LINE) == 0
    client.beat(time.monotonic_ns())
    client.set(True)
    begin = time.monotonic()
    while not machine.gpio.line_value(*LINE):
        client.beat(time.monotonic_ns())
        assert time.monotonic() - begin < 1.0
    client.set(False)
    while machine.gpio.line_value(*LINE):
        client.beat(time.monotonic_ns())
        assert time.monotonic() - begin < 1.0
    client.close()
    client.close()
    assert not machine.gpio.bank(LINE[0]).held(LINE[1]) and gone(client.pid)


def test_a_taken_line_is_refused_with_a_cure(machine):
    """Prevents a second instance, or a run beside another program that holds the line."""
    first, second = guard_client.start(make_config(), machine), guard_client.start(make_config(), machine)
    first.wait_ready()
    with pytest.raises(GpioError, match="cannot be requested") as caught:
        second.wait_ready()
    assert "Another program" in caught.value.cure
    first.close()


def test_a_guard_that_does_not_start_is_refused(machine):
    """Prevents a run without a guard when its program cannot be run."""
    settings = SimpleNamespace(policy="other", priority=1, lock_memory=False)
    client = guard_client.GuardProcess(LINE, TIMEOUT_S, settings, "mip_rt.no_such_module")
    with pytest.raises(GpioError, match="did not start"):
        client.wait_ready()
