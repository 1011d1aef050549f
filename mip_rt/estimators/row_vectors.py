"""Operations on rows of 16 numbers as LLVM vectors, for `estimators.rows`; imported when one of them is compiled."""

from llvmlite import ir

from mip_rt.compiled import numba
from mip_rt.estimators.rows import ROW

types, intrinsic = numba.types, numba.extending.intrinsic
_VECTOR = ir.VectorType(ir.DoubleType(), ROW)
_LANES = ir.VectorType(ir.IntType(32), ROW)


def _pointer(context, builder, array_type, array, row):
    data = context.make_array(array_type)(context, builder, array).data
    element = builder.gep(data, [builder.mul(row, ir.Constant(row.type, ROW))])
    return builder.bitcast(element, _VECTOR.as_pointer())


def _broadcast(builder, scalar):
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(_LANES, [0] * ROW))


@intrinsic
def add_scaled(typing_context, target, i, factor, source, k):
    """target[i] += factor * source[k] for whole rows; a one-dimensional array of ROW numbers is its own row 0."""

    def generate(context, builder, signature, arguments):
        to = _pointer(context, builder, signature.args[0], arguments[0], arguments[1])
        of = _pointer(context, builder, signature.args[3], arguments[3], arguments[4])
        product = builder.fmul(_broadcast(builder, arguments[2]), builder.load(of, align=8), flags=("contract",))
        builder.store(builder.fadd(builder.load(to, align=8), product, flags=("contract",)), to, align=8)
        return context.get_dummy_value()

    return types.void(target, types.uintp, types.float64, source, types.uintp), generate


@intrinsic
def copy(typing_context, target, i, source, k):
    """target[i] = source[k] for whole rows."""

    def generate(context, builder, signature, arguments):
        to = _pointer(context, builder, signature.args[0], arguments[0], arguments[1])
        of = _pointer(context, builder, signature.args[2], arguments[2], arguments[3])
        builder.store(builder.load(of, align=8), to, align=8)
        return context.get_dummy_value()

    return types.void(target, types.uintp, source, types.uintp), generate
