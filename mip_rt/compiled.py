"""How mip-rt compiles: one decorator, one set of flags, and numba only where something is to be compiled.

A start of the robot compiles nothing, so it does not import numba, which alone is a second of the robot's processor. `@njit` marks a function;
numba compiles it when compiled code wants it, or when it is called from Python and its machine code is not in numba's disk cache. What the
loop calls is taken by `direct`: that machine code is kept ready to be called (`machine_code`), in a folder that any edit of the sources
leaves behind (`code_cache`). Nothing else in mip-rt imports numba.
"""

import ctypes
import functools
import sys

import numpy

from mip_rt import code_cache, machine_code
from mip_rt.code_cache import JIT_DISABLED, cpu_name, machine_type, source_files, source_hash, versions  # noqa: F401  (others take them from here)

CACHE_FOLDER = code_cache.prepare()
ENTRIES = []  # what @entry has marked in the modules that are imported so far


@functools.cache
def _load_numba():
    """numba, only after the cache folder is set."""
    # numba looks for BLAS in scipy, where that is installed, which takes 0.2 s; nothing compiled here multiplies matrices with it.
    sys.modules.setdefault("scipy.linalg.cython_blas", None)
    import numba
    import numba.np.arraymath

    if sys.modules["scipy.linalg.cython_blas"] is None:
        del sys.modules["scipy.linalg.cython_blas"]
    return numba


def __getattr__(name):
    """`compiled.numba`: numba itself, loaded when it is first asked for."""
    if name == "numba":
        return _load_numba()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


class Later:
    """A name in a module that stands for something of numba's, made when the first function of that module is compiled."""

    def __init__(self, make):
        self._make = make

    @functools.cached_property
    def made(self):
        """What the name stands for."""
        return self._make()


def external(name: str, signature: str) -> Later:
    """A function of the C library, for use in compiled code: external("read", "intp(int32, uintp, uintp)")."""

    def make():
        numba = _load_numba()
        arguments, result = numba.core.sigutils.normalize_signature(signature)
        return numba.types.ExternalFunction(name, numba.core.typing.signature(result, *arguments))

    return Later(make)


class Function:
    """A Python function that numba compiles when it is first wanted.

    Args:
        function: the Python function.
        signatures, options: numba's.
        types: of its arguments, where the loop calls it: see `direct`.
    """

    def __init__(self, function, signatures, options, types=None):
        functools.update_wrapper(self, function)
        self.py_func, self._signatures, self._options, self.types = function, signatures, options, types

    @functools.cached_property
    def dispatcher(self):
        """numba's function."""
        known = self.py_func.__globals__
        for name, value in list(known.items()):
            if isinstance(value, Later):
                known[name] = value.made
        return _load_numba().njit(*self._signatures, **self._options)(self.py_func)

    @property
    def _numba_type_(self):
        """By this numba recognises a function in compiled code."""
        return self.dispatcher._numba_type_

    def __call__(self, *arguments):
        """Calls the compiled function from Python."""
        return self.dispatcher(*arguments)

    def __getattr__(self, name):
        """Everything else that numba's function has."""
        if name.startswith("__") or "py_func" not in self.__dict__:
            raise AttributeError(name)
        return getattr(self.dispatcher, name)


def _options(options: dict) -> dict:
    """With the flags of this project.

    The only relaxation of IEEE arithmetic is contraction of a*b+c into one instruction, as a C compiler does: order,
    NaN and infinity keep their meaning. Division by zero gives infinity or NaN, never an exception: the tick must not raise.
    """
    return {"cache": CACHE_FOLDER is not None, "error_model": "numpy", "fastmath": {"contract"}, **options}


def njit(*signatures, **options):
    """`numba.njit` with the flags of this project, put off until the function is wanted."""
    if len(signatures) == 1 and callable(signatures[0]) and not options and hasattr(signatures[0], "__code__"):
        return njit()(signatures[0])
    if JIT_DISABLED:
        return lambda function: function
    return lambda function: Function(function, signatures, _options(options))


def entry(*types):
    """As `njit`, for a function that the loop calls with arguments of these types: see `direct`."""

    def mark(function):
        marked = function if JIT_DISABLED else Function(function, (), _options({}), types)
        marked.types = types
        ENTRIES.append(marked)
        return marked

    return mark


def direct(function, *types):
    """A compiled function for arguments of these types as a Python callable: ready machine code, kept on disk.

    Args:
        function: marked by `njit`, or by `entry`, which names the types.
        types: a scalar's name ("int64", "float64", ...), or for an array the dtype of its elements: instead of the array the callable takes two
            integers, address and length, which cost less than the array: see `span`.

    A call of the function itself first looks at every argument to choose among signatures: 0.1 us an argument, more than some of the
    functions take. Here nothing is looked at, so the arrays must be contiguous, of that dtype, and outlive the callable's use.
    """
    types = types or function.types
    adapted = _with_addresses(function, types)
    if JIT_DISABLED:
        return adapted
    name = f"{function.__module__}.{function.__qualname__}"
    scalars = [word for kind in types for word in ((kind,) if isinstance(kind, str) else ("uintp", "intp"))]
    return machine_code.function(name, types, CACHE_FOLDER, lambda: (Function(adapted, (), _options({"cache": False})).dispatcher, scalars))


def address_of(function) -> int:
    """The address of an @entry function of machine words, of C's kind: for compiled code that calls by address (see `call`). Not in plain Python."""
    name = f"{function.__module__}.{function.__qualname__}"
    return machine_code.c_function(name, CACHE_FOLDER, lambda: (Function(function.py_func, (), _options({"cache": False})).dispatcher, list(function.types)))


def _with_addresses(function, types):
    """A Python function that takes address and length of each array, and calls `function` with the arrays."""
    if all(isinstance(kind, str) for kind in types):
        return function.py_func if isinstance(function, Function) else function
    names, arguments, known = [], [], {"function": function, "records_at": records_at}
    for i, kind in enumerate(types):
        if isinstance(kind, str):
            names.append(f"a{i}")
            arguments.append(f"a{i}")
        else:
            known[f"dtype{i}"] = numpy.dtype(kind)
            names += [f"address{i}", f"length{i}"]
            arguments.append(f"records_at(address{i}, length{i}, dtype{i})")
    exec(f"def adapted({', '.join(names)}):\n    return function({', '.join(arguments)})", known)
    return known["adapted"]


def span(array) -> tuple[int, int]:
    """(address, length) of an array, as a `direct` callable takes it; the array must outlive its use."""
    array = numpy.asarray(array)
    return array.__array_interface__["data"][0], len(array)


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

    @Later
    def _barrier():
        @_load_numba().extending.intrinsic
        def barrier(typing_context):
            def generate(context, builder, signature, arguments):
                builder.fence("seq_cst")
                return context.get_dummy_value()

            return _load_numba().types.void(), generate

        return barrier

    @Later
    def _pointer():
        types = _load_numba().types

        @_load_numba().extending.intrinsic
        def pointer(typing_context, address):
            def generate(context, builder, signature, arguments):
                return builder.inttoptr(arguments[0], context.get_value_type(types.voidptr))

            return types.voidptr(types.uintp), generate

        return pointer

    @Later
    def _carray():
        return _load_numba().carray

    @njit()
    def barrier():
        """What was stored before is visible to other processes before what is stored afterwards."""
        _barrier()

    @njit()
    def records_at(address, count, dtype):
        """The `count` records of `dtype` at this address, whose owner must outlive their use.

        An address is an integer, which costs less to hand over than an array.
        """
        return _carray(_pointer(address), count, dtype)

    @Later
    def _call():
        from llvmlite import ir

        types = _load_numba().types

        @_load_numba().extending.intrinsic
        def call(typing_context, address, first, second, third):
            def generate(context, builder, signature, arguments):
                word = context.get_value_type(types.uintp)
                function = builder.inttoptr(arguments[0], ir.FunctionType(ir.IntType(32), [word] * 3).as_pointer())
                return context.call_function_pointer(builder, function, arguments[1:])

            return types.int32(*(types.uintp,) * 4), generate

        return call

    @njit()
    def call(address, first, second, third):
        """What the function at this address returns: of C's kind, from three machine words to an int."""
        return _call(address, first, second, third)
