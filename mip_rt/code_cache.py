"""Where compiled code is kept: a folder for exactly these sources, this compiler, this processor.

numba's disk cache looks at one source file at a time: a function that calls another file's function keeps the old machine code
when only that other file changes. So the folder's name is a hash of every source file that can end up in compiled code, of numba's
version and of the CPU; any edit leads to a new, empty folder. Nothing here imports numba.
"""

import atexit
import contextlib
import functools
import hashlib
import importlib.util
import os
import platform
import sys
import tempfile
import warnings
from pathlib import Path

PACKAGE = Path(__file__).parent
JIT_DISABLED = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")  # numba's own switch: everything runs as plain Python
CORTEX_A8 = "cortex-a8"  # the BeagleBone's processor
SERVICE_CACHE = Path("/var/cache/mip-rt")  # CacheDirectory= of systemd/mip-rt.service
# Every file in these may be compiled, or holds constants and record types that compiled code freezes.
SOURCES = (
    "compiled.py", "code_cache.py", "machine_code.py", "frame.py", "guard_words.py", "inputs.py", "log/commit.py", "remote/dead_man.py", "models",
    "estimators", "controllers", "robots", "fake",
    *(f"hardware/{name}.py" for name in ("system_calls", "compiled_io", "packet_check", "line_events", "imu_status", "imu_read", "transfers", "mpu9250_registers")),
)  # fmt: skip


def source_files() -> list[Path]:
    """The files whose content decides whether compiled code is still valid, in a fixed order."""
    files = []
    for name in SOURCES:
        path = PACKAGE / name
        files += sorted(path.rglob("*.py")) if path.is_dir() else [path]
    return [f for f in files if f.exists()]


def source_hash() -> str:
    """Hash (16 hex digits) of all sources that can reach compiled code."""
    digest = hashlib.sha256()
    for file in source_files():
        digest.update(str(file.relative_to(PACKAGE)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def cpu_name() -> str:
    """The CPU that code is compiled for.

    On 32-bit ARM LLVM aborts the process where it takes the CPU for a generic one (it then wants library calls for atomic
    operations, numba issue 7452), so the BeagleBone's Cortex-A8 is named explicitly there.
    """
    named = os.environ.get("NUMBA_CPU_NAME")
    if named:
        return named
    if platform.machine().startswith("armv7"):
        return CORTEX_A8
    import llvmlite.binding

    return llvmlite.binding.get_host_cpu_name()


def cpu_features() -> str:
    """The extensions of the instruction set that code is compiled for, as LLVM lists them."""
    features = os.environ.get("NUMBA_CPU_FEATURES")
    if features is not None:
        return features
    import llvmlite.binding

    try:
        return llvmlite.binding.get_host_cpu_features().flatten()
    except RuntimeError:  # LLVM cannot tell on some kernels; numba then uses the CPU's name alone
        return ""


@functools.cache
def numba_version() -> str:
    """numba's version, from the file in which it keeps it: importing numba takes a second of the robot's processor, importlib.metadata a tenth."""
    found = importlib.util.find_spec("numba")
    if found is None:
        raise ModuleNotFoundError("No module named 'numba'", name="numba")
    file = Path(found.origin).with_name("_version.py")
    try:
        content = {}
        exec(compile(file.read_text(), str(file), "exec"), content)
        return content["get_versions"]()["version"]
    except (OSError, KeyError):  # a numba that keeps it elsewhere
        from importlib import metadata

        return metadata.version("numba")


def versions() -> dict:
    """{package: version} of what decides about compiled code."""
    import llvmlite
    import numpy

    return {"numba": numba_version(), "llvmlite": llvmlite.__version__, "numpy": numpy.__version__}


def machine_type() -> dict:
    """What must be the same for the same inputs to give the same bits: processor, compiler, libraries.

    The processor's features decide which multiplications and additions become one instruction, the C library computes sines.
    """
    return {
        "machine": platform.machine(),
        "cpu": cpu_name(),
        "cpu_features": hashlib.sha256(cpu_features().encode()).hexdigest()[:8],
        "libc": " ".join(platform.libc_ver()),
        **versions(),
        "compiled": not JIT_DISABLED,
    }


def cache_root() -> Path:
    """Where compiled code is kept: $MIP_RT_CACHE, the service's cache folder, which root shares with it, or the user's."""
    for variable in ("MIP_RT_CACHE", "CACHE_DIRECTORY"):
        if os.environ.get(variable):
            return Path(os.environ[variable])
    if os.geteuid() == 0 and SERVICE_CACHE.is_dir():
        return SERVICE_CACHE
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mip-rt"


def hand_over(folder: Path, owner: os.stat_result) -> None:
    """Gives what root has compiled to the owner of the cache, who could not keep anything beside it otherwise."""
    for path in (folder, *folder.rglob("*")):
        with contextlib.suppress(OSError):
            if path.stat().st_uid == 0:
                os.chown(path, owner.st_uid, owner.st_gid)


def prepare() -> Path | None:
    """Makes the cache folder of exactly these sources, and points numba at it; must run before numba is imported.

    Returns the folder, or None where no folder can be written; compilation then takes place at every start.
    """
    if "numba" in sys.modules:
        raise RuntimeError("numba was imported before mip_rt.compiled: its cache could hold code of older sources")
    cpu = cpu_name()
    os.environ.setdefault("NUMBA_CPU_NAME", cpu)
    if cpu == CORTEX_A8:
        # What this processor has follows from its name. The kernel's list would add what a newer one has, and code kept for one
        # would not be found on the other.
        os.environ.setdefault("NUMBA_CPU_FEATURES", "")
    key = hashlib.sha256(
        f"{source_hash()} {numba_version()} {cpu} {cpu_features()} {sys.version}".encode()
    ).hexdigest()[:16]
    folder = cache_root() / f"numba-{key}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        warnings.warn(
            f"compiled code cannot be kept in {folder} ({error.strerror}): every start will compile anew; "
            "set MIP_RT_CACHE to a folder that can be written",
            stacklevel=2,
        )
        return None
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    owner = folder.parent.stat()
    if os.geteuid() == 0 and owner.st_uid != 0:
        atexit.register(hand_over, folder, owner)
    return folder
