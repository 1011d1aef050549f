"""Python, packages, the compiler (in a child process, because LLVM may abort the process), compiled code on disk, disk, clock, configuration."""

import os
import signal
import sys
import time
from importlib import metadata
from pathlib import Path

from mip_rt.doctor.report import fail, ok, skip, warn

PACKAGES = ("numpy", "numba", "smbus2", "PyYAML", "pyserial")
PROBE_S = 180.0
LOG_SPACE_BYTES, CACHE_SPACE_BYTES = 500e6, 50e6
EARLIEST_UNIX_S = 1_700_000_000  # November 2023: a clock before is a board that has no clock yet
# Compiles three lines and says where compiled code is kept, and how much of it there is.
PROBE = """
from mip_rt import compiled
import pathlib
@compiled.numba.njit
def f(x):
    return 2.0 * x + 1.0
assert f(20.5) == 42.0
folder = compiled.CACHE_FOLDER
print("cache", folder or "", sum(1 for _ in pathlib.Path(folder).glob("*.code")) if folder else 0, sep="\\t")
"""


def examine(patient):
    """Yields the layer's Checks."""
    yield _packages()
    yield from _compiler(patient)
    yield from _disk(patient)
    yield _clock()


def _packages():
    found, missing = [], []
    for name in PACKAGES:
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            missing.append(name)
    if missing:
        return fail("packages", f"missing: {', '.join(missing)}.",
                    "sudo apt install python3-numpy python3-numba python3-smbus2 python3-yaml python3-serial (Debian 13 has no numba for 32-bit ARM: "
                    "sudo tools/install builds it).")  # fmt: skip
    return ok("packages", f"Python {sys.version.split()[0]}, {', '.join(found)}.")


def _compiler(patient):
    program = [sys.executable, "-c", PROBE]
    code, text = patient.kernel.command(*program, timeout_s=PROBE_S)
    yield compiler_check(code, text)
    if code:
        yield skip("cache", "the compiler does not work")
        return
    _, folder, entries = next(line for line in reversed(text.splitlines()) if line.startswith("cache\t")).split("\t")
    if not folder:
        yield warn("cache", "compiled code cannot be kept: every start compiles for minutes on a BeagleBone.",
                   "Make ~/.cache/mip-rt writable, or name a folder in MIP_RT_CACHE (the service has /var/cache/mip-rt).")  # fmt: skip
    elif int(entries) < 10:
        yield warn("cache", f"{folder} holds no compiled code of this version for this user.", "Run mip-rt warm-up as the user who runs the robot.")
    else:
        yield ok("cache", f"{entries} compiled functions of this version in {folder}.")


def compiler_check(code: int, text: str):
    """The line for the compiler's child process: its exit code (negative: the signal that ended it) and output."""
    if code == 0:
        return ok("compiler", "numba compiles and computes rightly (child process).")
    last = text.strip().splitlines()[-1] if text.strip() else "no output"
    if code == 124:
        return fail("compiler", f"compiling three lines took more than {PROBE_S:g} s.", "Something else uses the CPU or the memory; look with top.")
    if code < 0 or "LLVM ERROR" in text:
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return fail("compiler", f"the compiler (LLVM) ended the process with {name}: {last.rstrip('.')}.",
                    "On 32-bit ARM LLVM aborts where it takes the CPU for a generic one: set NUMBA_CPU_NAME=cortex-a8.")  # fmt: skip
    if "No module named" in last:
        return fail("compiler", f"a package is missing: {last.rstrip('.')}.",
                    "sudo apt install python3-numba; Debian 13 has none for 32-bit ARM: sudo tools/install builds it.")  # fmt: skip
    return fail("compiler", f"numba does not work: {last.rstrip('.')}.", "Reinstall: sudo apt install --reinstall python3-numba python3-llvmlite.")


def _existing(path) -> Path:
    path = Path(path)
    while not path.exists():
        path = path.parent
    return path


def _disk(patient):
    log = patient.config.log
    for name, folder, wanted in (("disk", log.record_folder, LOG_SPACE_BYTES), ("memory-disk", log.folder, CACHE_SPACE_BYTES)):
        place = _existing(patient.kernel.path(str(folder).lstrip("/")))
        found = os.statvfs(place)
        free = found.f_bavail * found.f_frsize
        if free < wanted:
            yield warn(name, f"{folder} has {free / 1e6:.0f} MB left.", f"Free space until there are {wanted / 1e6:.0f} MB; lower log.files or log.ring_s.")
        elif found.f_files and found.f_favail < 100:
            yield warn(name, f"{folder} has {found.f_favail} inodes left.", "Remove files there.")
        else:
            yield ok(name, f"{folder}: {free / 1e6:.0f} MB free.")


def _clock():
    if time.time() < EARLIEST_UNIX_S:
        return warn("clock", f"the clock says {time.strftime('%Y-%m-%d')}: names and dates of logs will be wrong.",
                    "Connect the network once (systemd-timesyncd), or sudo date -s ...; the control does not need it.")  # fmt: skip
    return ok("clock", time.strftime("the clock says %Y-%m-%d %H:%M."))
