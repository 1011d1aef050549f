"""Functions of the loop as ready machine code: one file each, linked and called without numba.

numba's own disk cache needs numba to read it, and importing numba is nearly half of what a start with it costs. So a function that the loop calls
is kept a second time: its object code, as numba made it, together with a small wrapper that CPython calls with numbers (METH_FASTCALL). LLVM's linker,
which llvmlite has, turns that into a function: nothing beside what importing numba takes. The files lie in the cache folder, whose name is a hash of all
sources, numba's version and the processor: stale code cannot be found.
"""

import contextlib
import ctypes
import functools
import hashlib
import os
import sys
import zlib

SUFFIX = ".code"
METH_FASTCALL = 0x80
WRAPPER = "mip_rt_wrapper"
# Helpers of numba's that compiled code names, and what stands in for them. The first releases an array that compiled code has allocated: nothing here
# can allocate, so it is never called. The others divide 64-bit integers on 32-bit processors, as the C compiler's library does.
HELPERS = {"NRT_MemInfo_call_dtor": (None, "abort")}
if sys.maxsize < 2**32:
    HELPERS |= {f"numba_{name}": ("libgcc_s.so.1", f"__{way}i3") for name, way in (("sdiv", "divd"), ("srem", "modd"), ("udiv", "udivd"), ("urem", "umodd"))}
_kept = []  # what must live as long as the process: engines and descriptions of functions


class MethodDef(ctypes.Structure):
    """CPython's PyMethodDef."""

    _fields_ = [("name", ctypes.c_char_p), ("function", ctypes.c_void_p), ("flags", ctypes.c_int), ("doc", ctypes.c_char_p)]


def function(name: str, types, folder, compiled):
    """A Python callable, from the folder's file or, where there is none yet, compiled and kept there.

    Args:
        name: module and name of the function.
        types: what else tells it from others of that name; dtypes and names of scalars.
        folder: of the files; None to keep nothing.
        compiled: called where there is no file: (numba's function, names of its arguments' types).
    """
    # All types are written in hashed sources: what must be told apart are the uses of one function within them.
    layout = " ".join(kind if isinstance(kind, str) else f"{kind.itemsize} {kind.descr}" for kind in types)
    address = _linked(f"{name}-{hashlib.sha256(layout.encode()).hexdigest()[:16]}", folder, compiled, _wrap_for_python)
    description = MethodDef(name.encode(), address, METH_FASTCALL, None)
    _kept.append(description)
    make = ctypes.pythonapi.PyCFunction_NewEx
    make.restype, make.argtypes = ctypes.py_object, (ctypes.POINTER(MethodDef), ctypes.c_void_p, ctypes.c_void_p)
    return make(ctypes.byref(description), None, None)


def c_function(name: str, folder, compiled) -> int:
    """The address of a function of C's kind, int f(size_t, ...): what compiled code calls by address. Arguments as for `function`."""
    return _linked(f"{name}-c", folder, compiled, _wrap_for_c)


def _linked(name, folder, compiled, wrap) -> int:
    """Address of the wrapper that `wrap` builds, from the folder's file or compiled and kept there."""
    path = folder and folder / f"{name}{SUFFIX}"
    code = _read(path)
    if code is not None:
        return _link(code)
    code = _object_code(*compiled(), wrap)
    address = _link(code)
    if path:
        _write(path, code)
    return address


def _read(path):
    """The object code in a file; None where there is no file, or not a whole one."""
    try:
        content = path.read_bytes() if path else b""
    except OSError:
        return None
    code, check = content[:-4], content[-4:]
    return code if code and zlib.crc32(code).to_bytes(4, "little") == check else None


def _write(path, code) -> None:
    """A start that is cut short, or another one at the same time, leaves a whole file or none; a disk that is full none."""
    new = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        new.write_bytes(code + zlib.crc32(code).to_bytes(4, "little"))
        os.replace(new, path)
    except OSError:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)


@functools.cache
def _llvm():
    """(llvmlite's linker, a machine for it)."""
    import llvmlite.binding as llvm

    with contextlib.suppress(AttributeError, RuntimeError):  # a newer one does that by itself
        llvm.initialize()
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    for name, (library, helper) in HELPERS.items():
        if llvm.address_of_symbol(name) is None:
            llvm.add_symbol(name, ctypes.cast(getattr(ctypes.CDLL(library), helper), ctypes.c_void_p).value)
    return llvm, llvm.Target.from_triple(llvm.get_process_triple())


def _link(code) -> int:
    llvm, target = _llvm()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), target.create_target_machine(codemodel="jitdefault", jit=True))
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _kept.append(engine)
    return engine.get_function_address(WRAPPER)


def _object_code(function, argument_types, wrap) -> bytes:
    """Object code of numba's function for these types and of the wrapper that `wrap` builds."""
    from numba.core import types
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.registry import cpu_target

    arguments = tuple(getattr(types, name) for name in argument_types)
    function.compile(arguments)
    result = function.overloads[arguments]
    context = cpu_target.target_context
    with global_compiler_lock:
        library = context.codegen().create_library(WRAPPER)
        library.enable_object_caching()
        module = library.create_ir_module(WRAPPER)
        wrap(context, module, result.fndesc)
        library.add_ir_module(module)
        library.add_linking_library(result.library)
        library.finalize()
    _refuse_numbas_own(library, function)
    return library.serialize_using_object_code()[2][0]


def _refuse_numbas_own(library, function) -> None:
    """Without numba LLVM would end the process where code calls one of numba's helpers; to allocate is one of them."""
    process = ctypes.CDLL(None)
    wanted = [f.name for f in library._final_module.functions if f.is_declaration and not f.name.startswith("llvm.")]
    unknown = [name for name in wanted if name not in HELPERS and not hasattr(process, name)]
    if unknown:
        raise RuntimeError(f"{function.py_func.__name__} cannot be kept as machine code: it calls {', '.join(unknown)}")


def _wrap_for_c(context, module, description) -> None:
    """int wrapper(size_t, ...). Whatever numba's function would raise becomes -1."""
    from llvmlite import ir
    from numba.core import types

    word = context.get_value_type(types.uintp)
    wrapper = ir.Function(module, ir.FunctionType(ir.IntType(32), [word] * len(description.argtypes)), WRAPPER)
    builder = ir.IRBuilder(wrapper.append_basic_block())
    function = context.declare_function(module, description)
    status, value = context.call_conv.call_function(builder, function, description.restype, description.argtypes, wrapper.args)
    with builder.if_then(status.is_error, likely=False):
        builder.ret(ir.Constant(ir.IntType(32), -1))
    builder.ret(builder.trunc(value, ir.IntType(32)) if value.type.width > 32 else value)


def _wrap_for_python(context, module, description) -> None:
    """PyObject *wrapper(PyObject *self, PyObject **arguments, Py_ssize_t count): numbers in, a number or None out."""
    from llvmlite import ir
    from numba.core import types

    any_object, size, double = context.get_value_type(types.pyobject), context.get_value_type(types.intp), ir.DoubleType()  # Linux: a long is a size
    wrapper = ir.Function(module, ir.FunctionType(any_object, [any_object, any_object.as_pointer(), size]), WRAPPER)
    builder = ir.IRBuilder(wrapper.append_basic_block())
    python = context.get_python_api(builder)
    nothing = ir.Constant(any_object, None)

    def call(name, returns, *values):
        function = module.globals.get(name) or ir.Function(module, ir.FunctionType(returns, [value.type for value in values]), name)
        return builder.call(function, values)

    with builder.if_then(builder.icmp_signed("!=", wrapper.args[2], ir.Constant(size, len(description.argtypes))), likely=False):
        call("PyErr_BadArgument", ir.IntType(32))
        builder.ret(nothing)
    native, doubtful = [], ir.Constant(ir.IntType(1), 0)
    for i, kind in enumerate(description.argtypes):
        given = builder.load(builder.gep(wrapper.args[1], [ir.Constant(size, i)]))
        if kind is types.float64:
            value = call("PyFloat_AsDouble", double, given)
            failed = builder.fcmp_ordered("==", value, ir.Constant(double, -1.0))
        else:
            # On 32-bit ARM a long is made of a Python integer in a tenth of the instructions that a long long takes.
            wanted = size if context.get_value_type(kind).width == size.width else ir.IntType(64)
            name = ("PyLong_As" if kind.signed else "PyLong_AsUnsigned") + ("Long" if wanted is size else "LongLong")
            value = call(name, wanted, given)
            failed = builder.icmp_signed("==", value, ir.Constant(wanted, -1))
        native.append(value)
        doubtful = builder.or_(doubtful, failed)
    with builder.if_then(doubtful, likely=False):  # -1, or an error
        error = call("PyErr_Occurred", any_object)
        with builder.if_then(builder.icmp_unsigned("!=", error, nothing), likely=False):
            builder.ret(nothing)
    function = context.declare_function(module, description)
    # Not inlined: the function's own code, whoever calls it, so that the same numbers come out to the bit.
    status, value = context.call_conv.call_function(builder, function, description.restype, description.argtypes, native, attrs=("noinline",))
    with builder.if_then(status.is_error, likely=False):
        kind = module.globals.get("PyExc_RuntimeError") or ir.GlobalVariable(module, any_object, "PyExc_RuntimeError")
        call("PyErr_SetNone", ir.VoidType(), builder.load(kind))
        builder.ret(nothing)
    if description.restype == types.none:
        builder.ret(python.make_none())
    else:
        builder.ret(python.from_native_value(description.restype, value))
