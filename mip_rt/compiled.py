"""How mip-rt compiles: one decorator, one cache folder, one set of flags.

numba's disk cache looks at one source file at a time: a function that calls another file's function keeps the old machine code
when only that other file changes. So the cache folder's name is a hash of every source file that can end up in
compiled code, of numba's version and of the CPU; any edit leads to a new, empty folder. `prepare` must run before numba is imported,
which importing this module ensures: nothing else in mip-rt imports numba.
"""

import atexit
import contextlib
import ctypes
import hashlib
import importlib.metadata
import os
import platform
import sys
import tempfile
import warnings
from pathlib import Path

PACKAGE = Path(__file__).parent
CORTEX_A8 = "cortex-a8"  # the BeagleBone's processor
SERVICE_CACHE = Path("/var/cache/mip-rt")  # CacheDirectory= of systemd/mip-rt.service
# Every file in these may be compiled, or holds constants and record types that compiled code freezes.
SOURCES = (
    "compiled.py", "frame.py", "guard_words.py", "inputs.py", "log/commit.py", "remote/dead_man.py", "models", "estimators", "controllers", "robots",
    "fake", *(f"hardware/{name}.py" for name in ("system_calls", "compiled_io", "packet_check", "line_events", "imu_status", "imu_read", "transfers", "mpu9250_registers")),
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


def machine_type() -> dict:
    """What must be the same for the same inputs to give the same bits: processor, compiler, libraries.

    The processor's features decide which multiplications and additions become one instruction, the C library computes sines.
    """
    import llvmlite.binding

    features = os.environ.get("NUMBA_CPU_FEATURES")
    if features is None:
        try:
            features = llvmlite.binding.get_host_cpu_features().flatten()
        except RuntimeError:  # LLVM cannot tell on some kernels; numba then uses the CPU's name alone
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
    """Points numba at the cache folder of exactly these sources.

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
    owner = folder.parent.stat()
    if os.geteuid() == 0 and owner.st_uid != 0:
        atexit.register(hand_over, folder, owner)
    return folder


CACHE_FOLDER = prepare()

import numba  # noqa: E402, F401  (only after the cache folder is set; others take it from here)
from llvmlite import ir  # noqa: E402
from numba.extending import intrinsic, register_jitable  # noqa: E402, F401

# numba looks for BLAS in scipy, where that is installed, which takes 0.2 s; nothing compiled here multiplies matrices with it.
sys.modules.setdefault("scipy.linalg.cython_blas", None)
import numba.np.arraymath  # noqa: E402, F401
import numpy  # noqa: E402

if sys.modules["scipy.linalg.cython_blas"] is None:
    del sys.modules["scipy.linalg.cython_blas"]

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


def plain(records, dtype):
    """The memory of a record array as an array of exactly `dtype`, whose type numba recognises at once; plain Python needs the records."""
    return records if JIT_DISABLED else numpy.ndarray(records.shape, dtype, records)


if JIT_DISABLED:

    def records_at(address, count, dtype):
        """See below."""
        return numpy.frombuffer((ctypes.c_char * (int(count) * numpy.dtype(dtype).itemsize)).from_address(int(address)), dtype).view(numpy.recarray)

    def barrier():
        """See below."""

    def call(address, first, second, third):
        """See below."""
        return ctypes.CFUNCTYPE(ctypes.c_int, *(ctypes.c_size_t,) * 3)(int(address))(int(first), int(second), int(third))

else:

    @intrinsic
    def _barrier(typing_context):
        def generate(context, builder, signature, arguments):
            builder.fence("seq_cst")
            return context.get_dummy_value()

        return numba.types.void(), generate

    @njit()
    def barrier():
        """What was stored before is visible to other processes before what is stored afterwards."""
        _barrier()

    @intrinsic
    def _pointer(typing_context, address):
        def generate(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(numba.types.voidptr))

        return numba.types.voidptr(numba.types.uintp), generate

    @njit()
    def records_at(address, count, dtype):
        """The `count` records of `dtype` at this address, whose owner must outlive their use.

        An address is an integer, which costs less to hand over than an array.
        """
        return numba.carray(_pointer(address), count, dtype)

    @intrinsic
    def _call(typing_context, address, first, second, third):
        def generate(context, builder, signature, arguments):
            word = context.get_value_type(numba.types.uintp)
            function = builder.inttoptr(arguments[0], ir.FunctionType(ir.IntType(32), [word] * 3).as_pointer())
            return context.call_function_pointer(builder, function, arguments[1:])

        return numba.types.int32(*(numba.types.uintp,) * 4), generate

    @njit()
    def call(address, first, second, third):
        """What the function at this address returns: of C's kind, from three machine words to an int."""
        return _call(address, first, second, third)


def direct(function, *types):
    """The machine code of a compiled function for these argument types, as a Python callable; without types, of its only signature.

    A call of the function itself first looks at every argument to choose among signatures: 0.1 us an argument, more than some of the
    functions take. Arguments of other types than the code was compiled for are not recognised here: for fixed arrays only.
    """
    if JIT_DISABLED:
        return function
    if types and types not in function.overloads:
        function.compile(types)
    return (function.overloads[types] if types else next(iter(function.overloads.values()))).entry_point
