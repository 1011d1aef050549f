"""How mip-rt compiles: one decorator, one cache folder, one set of flags.

numba's disk cache looks at one source file at a time: a function that calls another file's function keeps the old machine code
when only that other file changes. So the cache folder's name is a hash of every source file that can end up in
compiled code, of numba's version and of the CPU; any edit leads to a new, empty folder. `prepare` must run before numba is imported,
which importing this module ensures: nothing else in mip-rt imports numba.
"""

import hashlib
import importlib.metadata
import os
import platform
import sys
import tempfile
import warnings
from pathlib import Path

PACKAGE = Path(__file__).parent
# Every file in these may be compiled, or holds constants and record types that compiled code freezes.
SOURCES = ("compiled.py", "frame.py", "hardware/compiled_io.py", "models", "estimators", "controllers", "robots", "fake")


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
        return "cortex-a8"
    import llvmlite.binding

    return llvmlite.binding.get_host_cpu_name()


def machine_type() -> dict:
    """What must be the same for the same inputs to give the same bits: processor, compiler, libraries.

    The processor's features decide which multiplications and additions become one instruction, the C library computes sines.
    """
    import llvmlite.binding

    try:
        features = llvmlite.binding.get_host_cpu_features().flatten()
    except RuntimeError:  # LLVM cannot tell on some ARM kernels; numba then uses the CPU's name alone
        features = ""
    return {
        "machine": platform.machine(),
        "cpu": cpu_name(),
        "cpu_features": hashlib.sha256(features.encode()).hexdigest()[:8],
        "libc": " ".join(platform.libc_ver()),
        **{name: importlib.metadata.version(name) for name in ("numba", "llvmlite", "numpy")},
        "compiled": not JIT_DISABLED,
    }


def cache_root() -> Path:
    """Where compiled code is kept: $MIP_RT_CACHE, the service's cache folder, or the user's."""
    for variable in ("MIP_RT_CACHE", "CACHE_DIRECTORY"):
        if os.environ.get(variable):
            return Path(os.environ[variable])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mip-rt"


def prepare() -> Path | None:
    """Points numba at the cache folder of exactly these sources.

    Returns the folder, or None where no folder can be written; compilation then takes place at every start.
    """
    if "numba" in sys.modules:
        raise RuntimeError("numba was imported before mip_rt.compiled: its cache could hold code of older sources")
    cpu = cpu_name()
    os.environ.setdefault("NUMBA_CPU_NAME", cpu)
    key = hashlib.sha256(
        f"{source_hash()} {importlib.metadata.version('numba')} {cpu} {sys.version}".encode()
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
    return folder


CACHE_FOLDER = prepare()

import numba  # noqa: E402, F401  (only after the cache folder is set; others take it from here)
from numba.extending import register_jitable  # noqa: E402, F401

JIT_DISABLED = bool(numba.config.DISABLE_JIT)


def njit(*signatures, **options):
    """`numba.njit` with the flags of this project.

    The only relaxation of IEEE arithmetic is contraction of a*b+c into one instruction, as a C compiler does: order,
    NaN and infinity keep their meaning. Division by zero gives infinity or NaN, never an exception: the tick must not raise.
    """
    settings = {"cache": CACHE_FOLDER is not None, "error_model": "numpy", "fastmath": {"contract"}, **options}
    return numba.njit(*signatures, **settings)


def record_array(dtype):
    """numba's type of a contiguous one-dimensional array of `dtype` records, for explicit signatures."""
    return numba.types.Array(numba.from_dtype(dtype), 1, "C", aligned=True)


def direct(function, *types):
    """The machine code of `function` for arguments of these types, called without a look at what is given: a third of a call's cost.

    Nothing notices wrong arguments, so this is for calls whose arguments are made once, beside the call.
    """
    if JIT_DISABLED:
        return function
    if types not in function.overloads:
        function.compile(types)
    return function.overloads[types].entry_point
