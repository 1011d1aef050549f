"""Scheduling, memory locking and the garbage collector: nothing else in mip-rt touches them.

A Python loop keeps 200 Hz when three things are settled before it starts: it runs under SCHED_FIFO, its pages are locked, and the
garbage collector (17 ms a collection with numba loaded) is frozen and off. What was asked for and what was obtained are
both reported; a refusal is a warning with its cure, not a stop; with realtime.strict it keeps the robot disarmed (prearm).
"""

import ctypes
import gc
import os
from dataclasses import asdict, dataclass, field

MCL_CURRENT, MCL_FUTURE = 1, 2
IDLE_LATENCY = "/dev/cpu_dma_latency"
POLICIES = {os.SCHED_OTHER: "other", os.SCHED_FIFO: "fifo", os.SCHED_RR: "rr"}


@dataclass
class Scheduling:
    """What the kernel granted.

    Attributes:
        policy: "fifo", "rr" or "other".
        priority: real-time priority, 0 under "other".
        memory_locked: all present and future pages are locked.
        gc_frozen: the collector is frozen and disabled.
        warnings: one sentence with its cure for everything that was asked for and not obtained.
    """

    policy: str = "other"
    priority: int = 0
    memory_locked: bool = False
    gc_frozen: bool = False
    warnings: list[str] = field(default_factory=list)

    def summary(self) -> dict:
        """The contract's keys of the JSON summary."""
        whole = asdict(self)
        whole.pop("warnings")
        return whole


def quick_start() -> None:
    """Before the big imports: no collections while they build what stays anyway, and no threads for matrices of 10 rows."""
    gc.disable()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def freeze_garbage_collector() -> None:
    """One full collection now, none afterwards; everything alive is moved out of the collector's sight."""
    gc.collect()
    gc.freeze()
    gc.disable()


def lock_memory() -> bool:
    """mlockall for present and future pages; False where the limit forbids it."""
    return ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE) == 0


_idle_latency_fd = -1


def forbid_deep_idle() -> bool:
    """Asks the kernel not to enter idle states that take long to leave; holds until `leave`. False where that is not allowed."""
    global _idle_latency_fd
    try:
        _idle_latency_fd = os.open(IDLE_LATENCY, os.O_WRONLY | os.O_CLOEXEC)
        os.write(_idle_latency_fd, bytes(4))
        return True
    except OSError:
        return False


def enter(policy: str, priority: int, lock: bool) -> Scheduling:
    """Makes this process as real-time as it is allowed to be. Call last before the loop.

    Args:
        policy: "fifo" or "other".
        priority: SCHED_FIFO priority, below the interrupt threads of I2C and GPIO.
        lock: lock all memory.
    """
    obtained = Scheduling()
    if lock:
        obtained.memory_locked = lock_memory()
        if not obtained.memory_locked:
            obtained.warnings.append(
                "memory is not locked, a page fault can delay a tick: allow it with LimitMEMLOCK=infinity or "
                "'memlock unlimited' in /etc/security/limits.d"
            )
    if policy == "fifo":
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except (PermissionError, OSError):
            obtained.warnings.append(
                f"asked for SCHED_FIFO {priority}, got ordinary scheduling: allow it with LimitRTPRIO={priority} or "
                f"'rtprio {priority}' in /etc/security/limits.d, or run as root"
            )
        if not forbid_deep_idle():
            obtained.warnings.append(
                f"{IDLE_LATENCY} cannot be written, leaving idle may take long: let the udev rules give it to the service's group"
            )
    obtained.policy = POLICIES.get(os.sched_getscheduler(0), "other")
    obtained.priority = os.sched_getparam(0).sched_priority
    freeze_garbage_collector()
    obtained.gc_frozen = not gc.isenabled()
    return obtained


def leave() -> None:
    """Back to an ordinary process, for the work after the loop and for tests that run several loops."""
    global _idle_latency_fd
    if _idle_latency_fd >= 0:
        os.close(_idle_latency_fd)
        _idle_latency_fd = -1
    try:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except OSError:
        pass
    ctypes.CDLL(None).munlockall()
    gc.unfreeze()
    gc.enable()
