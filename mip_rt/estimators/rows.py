"""Operations on rows of 16 numbers, the words in which the filters are written.

A compiler that meets ``P[i, j] -= a * g[j]`` cannot know that P and g do not overlap, and falls back to one number at a
time: the filter then takes twice as long. These two operations load, multiply and store a whole row as one LLVM vector,
which becomes two to eight instructions on a PC and plain scalar code on a Cortex-A8 (whose double precision has no vectors).

With NUMBA_DISABLE_JIT=1 the same two names are ordinary numpy.
"""

from mip_rt.compiled import JIT_DISABLED

ROW = 16  # numbers in a row: the largest filter has 13 states, and 16 fills whole vector registers

if JIT_DISABLED:

    def add_scaled_row(target, i, factor, source, k):
        """target[i] += factor * source[k] for whole rows; a one-dimensional array of ROW numbers is its own row 0."""
        target.reshape(-1, ROW)[i] += factor * source.reshape(-1, ROW)[k]

    def copy_row(target, i, source, k):
        """target[i] = source[k] for whole rows."""
        target.reshape(-1, ROW)[i] = source.reshape(-1, ROW)[k]

else:
    from llvmlite import ir
    from numba import types
    from numba.extending import intrinsic

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
    def add_scaled_row(typing_context, target, i, factor, source, k):
        """target[i] += factor * source[k] for whole rows; a one-dimensional array of ROW numbers is its own row 0."""

        def generate(context, builder, signature, arguments):
            to = _pointer(context, builder, signature.args[0], arguments[0], arguments[1])
            of = _pointer(context, builder, signature.args[3], arguments[3], arguments[4])
            product = builder.fmul(_broadcast(builder, arguments[2]), builder.load(of, align=8), flags=("contract",))
            builder.store(builder.fadd(builder.load(to, align=8), product, flags=("contract",)), to, align=8)
            return context.get_dummy_value()

        return types.void(target, types.uintp, types.float64, source, types.uintp), generate

    @intrinsic
    def copy_row(typing_context, target, i, source, k):
        """target[i] = source[k] for whole rows."""

        def generate(context, builder, signature, arguments):
            to = _pointer(context, builder, signature.args[0], arguments[0], arguments[1])
            of = _pointer(context, builder, signature.args[2], arguments[2], arguments[3])
            builder.store(builder.load(of, align=8), to, align=8)
            return context.get_dummy_value()

        return types.void(target, types.uintp, source, types.uintp), generate
