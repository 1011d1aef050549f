"""What the kernel grants for real time: scheduling, memory, idle latency; interrupt threads' priorities, governor, throttling."""

import re

from mip_rt import realtime
from mip_rt.doctor.report import ok, warn

THREADS = {"i2c": r"irq/\d+-.*(4819c000|i2c)", "gpio": r"irq/\d+-.*(481ae000|gpio)"}  # of the IMU's bus and interrupt
RT_PRIORITY = 39  # field 40 of /proc/PID/stat, counted from the process id


def examine(patient):
    """Yields the layer's Checks."""
    settings = patient.config.realtime
    obtained = realtime.enter(settings.policy, settings.priority, settings.lock_memory)
    realtime.leave()
    yield from granted(obtained)
    yield _kernel(patient)
    yield from _threads(patient, settings.priority)
    yield _governor(patient)


def granted(obtained):
    """Checks for a realtime.Scheduling."""
    if not obtained.warnings:
        locked = "memory locked" if obtained.memory_locked else "memory not locked, as configured"
        yield ok("privileges", f"{obtained.policy} {obtained.priority}, {locked}, deep idle forbidden.")
    for number, warning in enumerate(obtained.warnings, 1):
        sentence, _, cure = warning.partition(": ")
        yield warn(f"privilege{number}", f"{sentence}.", f"{cure[:1].upper()}{cure[1:]}.")


def _kernel(patient):
    if patient.text("sys/kernel/realtime") == "1":
        return ok("kernel", "PREEMPT_RT kernel.")
    return ok("kernel", "no PREEMPT_RT kernel: expect wake-ups of up to a few milliseconds under load; 200 Hz bears it, the log shows it.")


def _threads(patient, priority: int):
    folder = patient.kernel.path("proc")
    found = {}
    for comm in folder.glob("[0-9]*/comm"):
        try:
            name = comm.read_text().strip()
            for kind, pattern in THREADS.items():
                if re.match(pattern, name):
                    fields = (comm.parent / "stat").read_text().rpartition(")")[2].split()
                    found[kind] = (name, int(fields[RT_PRIORITY - 1]), comm.parent.name)
        except (OSError, ValueError, IndexError):
            continue  # it has ended
    for kind, (name, its, process) in found.items():
        if its <= priority:
            yield warn(f"irq-{kind}", f"{name} runs at priority {its}, the loop at {priority}: the loop keeps its own interrupt waiting.",
                       f"sudo chrt -f -p {min(priority + 10, 99)} {process}, or lower realtime.priority.")  # fmt: skip
        else:
            yield ok(f"irq-{kind}", f"{name} runs at priority {its}, above the loop's {priority}.")
    if not found:
        yield ok("irq", "the interrupts of I2C and GPIO have no threads of their own (usual without PREEMPT_RT).")


def _governor(patient):
    governor = patient.text("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    if governor in ("performance", ""):
        return ok("governor", f"CPU frequency governor: {governor or 'none, the frequency is fixed'}.")
    return warn("governor", f"the CPU frequency governor is {governor}: changing the frequency costs time at the wrong moment.",
                "echo performance | sudo tee /sys/devices/system/cpu/cpu0/cpufreq/scaling_governor (cpufrequtils makes it last).")  # fmt: skip
