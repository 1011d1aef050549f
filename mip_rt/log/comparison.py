"""Recorded against replayed rows, field by field: equal bit for bit, or within a tolerance; where first, and how much.

The tolerance of a number is 1e-9 of the largest magnitude that its column has in the log. Whole numbers must be equal, except a pulse in
whole nanoseconds, which rounding may move by one.
"""

import math
from dataclasses import dataclass

import numpy as np

from mip_rt.frame import LOOP_LIMITS

TOLERANCE = 1e-9  # relative, between two types of machines
SMALLEST_SCALE = 1e-12  # a column that never exceeds this is compared absolutely
ROUNDED = {"duty_ns": 1}  # whole numbers that are rounded from floating point: allowed difference


@dataclass
class Difference:
    """Where a field first differs.

    Attributes:
        field, column: name, and index in the flattened field.
        tick: number of the tick.
        recorded, replayed: the two numbers.
    """

    field: str
    column: int
    tick: int
    recorded: float
    replayed: float


class Column:
    """What is known of one field, column by column.

    Attributes:
        ticks: ticks in which any column differs by more than is allowed.
        largest: (columns,) largest difference; infinite where only one of the two is a number.
        at_tick: (columns,) where that was.
        squares: (3, columns) sums of squares of recorded, replayed and difference over `rows` rows, finite ones only.
        first: Difference, or None.
    """

    def __init__(self, width: int):
        self.ticks, self.first, self.rows = 0, None, 0
        self.largest, self.at_tick, self.squares = np.zeros(width), np.zeros(width, np.int64), np.zeros((3, width))


class Comparison:
    """Takes batches of rows, and says in the end whether they were equal.

    Args:
        frames: all recorded rows, for the scale of each column.
        fields: names of the fields to compare.
        exact: bit for bit; otherwise to TOLERANCE.
        slots: recorded slot of each replayed estimator; None where slots are the same in both.
        statistics: also sum the squares of fields that are equal.

    Attributes:
        columns: {field: Column}.
        first: the first Difference of all; None where everything was equal.
        rows: rows compared.
        state_ticks: ticks whose state row differs.
    """

    def __init__(self, frames, fields, exact: bool, slots=None, statistics: bool = False):
        self.exact, self.slots, self.statistics = exact, slots, statistics
        self.columns = {name: Column(self._pair(name, frames[:1], frames[:1])[0].shape[1]) for name in fields}
        self._frames, self._scales = frames, {}
        self.first, self.rows, self.state_ticks = None, 0, []

    def take(self, recorded, replayed) -> None:
        """Compares rows; both are (n,) records, in order."""
        self.rows += len(recorded)
        for name in self.columns:
            a, b = self._pair(name, recorded, replayed)
            column = self.columns[name]
            column.rows += len(a)
            same = a.view(np.int64) == b.view(np.int64)
            if not same.all():
                self._differing(name, column, a, b, same, recorded)
            elif self.statistics:
                column.squares[:2] += (np.where(np.isfinite(a), a, 0.0).astype(float) ** 2).sum(axis=0)

    def _differing(self, name, column, a, b, same, recorded) -> None:
        x, y = a.astype(float), b.astype(float)
        finite = np.isfinite(x) & np.isfinite(y)
        with np.errstate(invalid="ignore"):
            gap = np.where(finite, np.abs(x - y), np.where(same | (x == y) | (np.isnan(x) & np.isnan(y)), 0.0, math.inf))
        for i, values in enumerate((x, y, x - y)):
            with np.errstate(over="ignore"):  # a flipped exponent makes any number
                column.squares[i] += (np.where(finite, values, 0.0) ** 2).sum(axis=0)
        at = gap.argmax(axis=0)
        peak = gap[at, np.arange(gap.shape[1])]
        higher = peak > column.largest
        column.largest = np.where(higher, peak, column.largest)
        column.at_tick = np.where(higher, recorded["tick"][at], column.at_tick)
        if self.exact:
            wrong = ~same
        elif a.dtype.kind == "f":
            wrong = gap > TOLERANCE * self.scale(name)
        else:
            wrong = gap > ROUNDED.get(name, 0)
        rows = wrong.any(axis=1)
        column.ticks += int(rows.sum())
        if column.first is None and rows.any():
            row = int(rows.argmax())
            index = int(wrong[row].argmax())
            column.first = Difference(name, index, int(recorded["tick"][row]), a[row, index].item(), b[row, index].item())
            if self.first is None or column.first.tick < self.first.tick:
                self.first = column.first

    def _pair(self, name, recorded, replayed):
        """Both as contiguous (n, columns) arrays of eight-byte numbers, with the estimators' slots brought together."""
        a, b = recorded[name], replayed[name]
        if name == "limits":
            a, b = a & ~LOOP_LIMITS, b & ~LOOP_LIMITS
        if self.slots is not None and name in ("estimates", "estimator_flags"):
            a, b = a[:, self.slots], b[:, : len(self.slots)]
        return tuple(np.ascontiguousarray(x.reshape(len(recorded), -1)) for x in (a, b))

    def scale(self, name):
        """(columns,) largest recorded magnitude of each column of a field, in the whole log."""
        if name not in self._scales:
            scale = np.full(len(self.columns[name].largest), SMALLEST_SCALE)
            for begin in range(0, len(self._frames), 65536):
                part = self._frames[begin : begin + 65536]
                values = np.abs(self._pair(name, part, part)[0].astype(float))
                scale = np.maximum(scale, np.where(np.isfinite(values), values, 0.0).max(axis=0))
            self._scales[name] = scale
        return self._scales[name]

    @property
    def equal(self) -> bool:
        """Every field of every row was equal, as far as was asked."""
        return self.first is None and not self.state_ticks

    def relative(self, name) -> float:
        """Largest difference of a field, relative to the largest magnitude of its column."""
        largest = self.columns[name].largest
        return float((largest / self.scale(name)).max()) if largest.any() else 0.0

    def differing(self) -> list[str]:
        """Fields that differ at all, the largest relative difference first."""
        found = [name for name, column in self.columns.items() if column.largest.any() or column.ticks]
        return sorted(found, key=self.relative, reverse=True)
