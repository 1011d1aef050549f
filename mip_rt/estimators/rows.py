"""Operations on rows of 16 numbers, the words in which the filters are written; each in the form that suits the machine.

On a PC: a compiler that meets ``P[i, j] -= a * g[j]`` cannot know that P and g do not overlap, and falls back to one number at a time:
the filter then takes twice as long. So there an operation loads, multiplies and stores a whole row as one LLVM vector (two to
eight instructions) and does not care which columns are needed.

On 32-bit ARM, whose double precision has no vectors, every number that is loaded or stored costs an instruction for itself and one for its
address: there, and with NUMBA_DISABLE_JIT=1, an operation is a loop over the columns that are needed, and up to four products are added before a
number is stored.

Arguments in common: `first` and `n` bound the needed columns, first <= j < n; columns outside may be written or not. The sums are the same in
both forms, to the bit: products are added one after the other.
"""

import importlib
import sys

from mip_rt.compiled import JIT_DISABLED, Later, njit

ROW = 16  # numbers in a row: the largest filter has 15 states, and 16 fills whole vector registers
VECTORS = sys.maxsize > 2**32 and not JIT_DISABLED


def row_vectors():
    """The module of the vector operations; it needs numba."""
    return importlib.import_module("mip_rt.estimators.row_vectors")


if VECTORS:

    @Later
    def _add_scaled():
        return row_vectors().add_scaled

    @Later
    def _copy():
        return row_vectors().copy

    @njit(forceinline=True)
    def combine_rows(target, i, base, b, factors, f, scale, columns, begin, end, source, first, n):
        """target[i, j] = base[b, j] + the sum over the entries e, begin <= e < end, of scale * factors[f, c] * source[c, j], c = columns[e]."""
        _copy(target, i, base, b)
        for e in range(begin, end):
            c = columns[e]
            _add_scaled(target, i, scale * factors[f, c], source, c)

    @njit(forceinline=True)
    def add_scaled_vector(target, factor, source, n):
        """target[j] += factor * source[j]."""
        _add_scaled(target, 0, factor, source, 0)

    @njit(forceinline=True)
    def subtract_square(matrix, factor, vector, n):
        """matrix -= factor * vector vector' for a symmetric matrix."""
        for i in range(n):
            _add_scaled(matrix, i, -vector[i] * factor, vector, 0)

else:

    @njit(forceinline=True)
    def _add_one(target, i, base, b, f0, k0, source, first, n):
        for j in range(first, n):
            target[i, j] = base[b, j] + f0 * source[k0, j]

    @njit(forceinline=True)
    def _add_two(target, i, base, b, f0, k0, f1, k1, source, first, n):
        for j in range(first, n):
            target[i, j] = base[b, j] + f0 * source[k0, j] + f1 * source[k1, j]

    @njit(forceinline=True)
    def _add_three(target, i, base, b, f0, k0, f1, k1, f2, k2, source, first, n):
        for j in range(first, n):
            target[i, j] = base[b, j] + f0 * source[k0, j] + f1 * source[k1, j] + f2 * source[k2, j]

    @njit(forceinline=True)
    def _add_four(target, i, base, b, f0, k0, f1, k1, f2, k2, f3, k3, source, first, n):
        for j in range(first, n):
            target[i, j] = base[b, j] + f0 * source[k0, j] + f1 * source[k1, j] + f2 * source[k2, j] + f3 * source[k3, j]

    @njit(forceinline=True)
    def combine_rows(target, i, base, b, factors, f, scale, columns, begin, end, source, first, n):
        """target[i, j] = base[b, j] + the sum over the entries e, begin <= e < end, of scale * factors[f, c] * source[c, j], c = columns[e]."""
        odd = (end - begin) % 4
        e = begin
        if odd == 0:
            for j in range(first, n):
                target[i, j] = base[b, j]
        else:
            c0 = columns[e]
            f0 = scale * factors[f, c0]
            if odd == 1:
                _add_one(target, i, base, b, f0, c0, source, first, n)
            else:
                c1 = columns[e + 1]
                f1 = scale * factors[f, c1]
                if odd == 2:
                    _add_two(target, i, base, b, f0, c0, f1, c1, source, first, n)
                else:
                    c2 = columns[e + 2]
                    _add_three(target, i, base, b, f0, c0, f1, c1, scale * factors[f, c2], c2, source, first, n)
        e = begin + odd
        while e < end:  # a range with a step costs a division
            c0, c1, c2, c3 = columns[e], columns[e + 1], columns[e + 2], columns[e + 3]
            _add_four(
                target, i, target, i, scale * factors[f, c0], c0, scale * factors[f, c1], c1, scale * factors[f, c2], c2,
                scale * factors[f, c3], c3, source, first, n,
            )  # fmt: skip
            e += 4

    @njit(forceinline=True)
    def add_scaled_vector(target, factor, source, n):
        """target[j] += factor * source[j]."""
        for j in range(n):
            target[j] += factor * source[j]

    @njit(forceinline=True)
    def subtract_square(matrix, factor, vector, n):
        """matrix -= factor * vector vector' for a symmetric matrix: the upper half is computed, the lower one copied."""
        for i in range(n):
            scaled = -vector[i] * factor
            for j in range(i, n):
                value = matrix[i, j] + scaled * vector[j]
                matrix[i, j] = value
                matrix[j, i] = value
