"""Operations on rows of 16 numbers, the words in which the filters are written; each in the form that suits the machine.

On a PC: a compiler that meets ``P[i, j] -= a * g[j]`` cannot know that P and g do not overlap, and falls back to one number at a time:
the filter then takes twice as long. So there an operation loads, multiplies and stores a whole row as one LLVM vector (two to
eight instructions) and does not care which columns are needed.

On 32-bit ARM, whose double precision has no vectors, every number costs five instructions: there, and with NUMBA_DISABLE_JIT=1, an
operation is a loop over the columns that are needed.

Arguments in common: `first` and `n` bound the needed columns, first <= j < n; columns outside may be written or not.
"""

import sys

from mip_rt.compiled import JIT_DISABLED, njit

ROW = 16  # numbers in a row: the largest filter has 15 states, and 16 fills whole vector registers
VECTORS = sys.maxsize > 2**32 and not JIT_DISABLED

if VECTORS:
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
    def _add_scaled(typing_context, target, i, factor, source, k):
        """target[i] += factor * source[k] for whole rows; a one-dimensional array of ROW numbers is its own row 0."""

        def generate(context, builder, signature, arguments):
            to = _pointer(context, builder, signature.args[0], arguments[0], arguments[1])
            of = _pointer(context, builder, signature.args[3], arguments[3], arguments[4])
            product = builder.fmul(_broadcast(builder, arguments[2]), builder.load(of, align=8), flags=("contract",))
            builder.store(builder.fadd(builder.load(to, align=8), product, flags=("contract",)), to, align=8)
            return context.get_dummy_value()

        return types.void(target, types.uintp, types.float64, source, types.uintp), generate

    @intrinsic
    def _copy(typing_context, target, i, source, k):
        """target[i] = source[k] for whole rows."""

        def generate(context, builder, signature, arguments):
            to = _pointer(context, builder, signature.args[0], arguments[0], arguments[1])
            of = _pointer(context, builder, signature.args[2], arguments[2], arguments[3])
            builder.store(builder.load(of, align=8), to, align=8)
            return context.get_dummy_value()

        return types.void(target, types.uintp, source, types.uintp), generate

    @njit
    def copy_row(target, i, source, k, first, n):
        """target[i, j] = source[k, j]."""
        _copy(target, i, source, k)

    @njit
    def add_scaled_row(target, i, factor, source, k, first, n):
        """target[i, j] += factor * source[k, j]."""
        _add_scaled(target, i, factor, source, k)

    @njit
    def add_scaled_row_to_vector(target, factor, source, k, n):
        """target[j] += factor * source[k, j]."""
        _add_scaled(target, 0, factor, source, k)

    @njit
    def add_scaled_vector(target, factor, source, n):
        """target[j] += factor * source[j]."""
        _add_scaled(target, 0, factor, source, 0)

    @njit
    def subtract_square(matrix, factor, vector, n):
        """matrix -= factor * vector vector' for a symmetric matrix."""
        for i in range(n):
            _add_scaled(matrix, i, -vector[i] * factor, vector, 0)

else:

    @njit
    def copy_row(target, i, source, k, first, n):
        """target[i, j] = source[k, j]."""
        for j in range(first, n):
            target[i, j] = source[k, j]

    @njit
    def add_scaled_row(target, i, factor, source, k, first, n):
        """target[i, j] += factor * source[k, j]."""
        for j in range(first, n):
            target[i, j] += factor * source[k, j]

    @njit
    def add_scaled_row_to_vector(target, factor, source, k, n):
        """target[j] += factor * source[k, j]."""
        for j in range(n):
            target[j] += factor * source[k, j]

    @njit
    def add_scaled_vector(target, factor, source, n):
        """target[j] += factor * source[j]."""
        for j in range(n):
            target[j] += factor * source[j]

    @njit
    def subtract_square(matrix, factor, vector, n):
        """matrix -= factor * vector vector' for a symmetric matrix: the upper half is computed, the lower one copied."""
        for i in range(n):
            scaled = -vector[i] * factor
            for j in range(i, n):
                value = matrix[i, j] + scaled * vector[j]
                matrix[i, j] = value
                matrix[j, i] = value
