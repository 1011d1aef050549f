"""Faults of the processor, the clock, files and processes; and hands that push the robot. See `faults` for the table."""

import os
import resource
import signal as signals
import threading
import time
from pathlib import Path

from mip_rt.errors import ConfigError


def cpu_stall(injector, fault):
    """At the next wake-up the loop does not go on for a while."""

    def wait(call, fd, timeout_s):
        woken = call(fd, timeout_s)
        remove()
        fault.hits += 1
        injector.stall(fault.p.stall_s)
        return woken

    remove = injector.taps.add(injector.bench.kernel, "wait_readable", wait)


cpu_hung = cpu_stall


def clock_step(injector, fault):
    """time.time and time.time_ns are offset for the loop's thread; CLOCK_MONOTONIC, by which everything must go, is not."""
    fault.hits += 1
    step_s, step_ns, thread = fault.p.step_s, round(fault.p.step_s * 1e9), threading.get_ident()

    def offset(call, by):
        return call() + (by if threading.get_ident() == thread else 0)

    removes = (
        injector.taps.add(time, "time", lambda call: offset(call, step_s)),
        injector.taps.add(time, "time_ns", lambda call: offset(call, step_ns)),
    )

    def undo():
        for remove in removes:
            remove()

    return undo


def children(part: str) -> list[int]:
    """Process ids of this process's children whose command line contains the text."""
    found = []
    for task in Path("/proc/self/task").iterdir():
        for pid in (task / "children").read_text().split():
            try:
                if part in Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace"):
                    found.append(int(pid))
            except OSError:
                continue  # it has just ended
    return found


def disk_full(injector, fault):
    """The recorder may not make any file longer; what it may rewrite in place it may still rewrite."""
    limits = []
    for pid in children("recorder"):
        limits.append((pid, resource.prlimit(pid, resource.RLIMIT_FSIZE)))
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, limits[-1][1][1]))
        fault.hits += 1

    def undo():
        for pid, limit in limits:
            try:
                resource.prlimit(pid, resource.RLIMIT_FSIZE, limit)
            except OSError:
                pass  # it has ended

    return undo


def config_changed(injector, fault):
    """Overwrites the file that the run was configured from, and puts it back afterwards.

    Raises:
        ConfigError: the run was configured from a file of ours.
    """
    path = injector.bench.config_path
    if path is None:
        raise ConfigError("the fault config_changed overwrites the configuration file.", "Name a copy with --config.", "scenario_fault")
    if injector.config_text is None:
        injector.config_text = Path(path).read_bytes()
    Path(path).write_bytes(b"limits: {duty: 17, tip_rad: .nan}\n\xff\x00")
    fault.hits += 1
    return lambda: Path(path).write_bytes(injector.config_text)


def signal(injector, fault):
    """To this process.

    Raises:
        ConfigError: no such signal.
    """
    number = getattr(signals, fault.p.name, None)
    if not isinstance(number, signals.Signals):
        raise ConfigError(f"there is no signal {fault.p.name}.", "Use a name from `kill -l` with SIG before it.", "scenario_fault")
    fault.hits += 1
    os.kill(os.getpid(), number)


def child_killed(injector, fault):
    """SIGKILL to every child whose command line contains the name; on virtual time the guard is no process, and dies in its way."""
    guard = injector.bench.kernel.guard
    if guard is not None and fault.p.name == "guard":
        guard.kill()
        fault.hits += 1
    for pid in children(fault.p.name):
        os.kill(pid, signals.SIGKILL)
        fault.hits += 1


def tipped_over(injector, fault):
    """The body is at another roll at once; a robot in the operator's hands stays there."""
    state = injector.bench.world.state[0]
    if state.held == 0:
        fault.hits += 1
        state.x[0] = fault.p.lean_rad


def pushed(injector, fault):
    """The roll rate changes at once."""
    world = injector.bench.world
    if world.state[0].held == 0:
        fault.hits += 1
        world.state[0].x[world.plant.LEAN_RATE] += fault.p.rate_rad_s
