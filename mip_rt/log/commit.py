"""The end of a row, compiled: the last results, and the two counter stores that commit it, each visible only after all that was stored before it."""

import numpy as np

from mip_rt.compiled import barrier, entry, records_at


@entry("uintp", "int64", "int64")
def begin(rows_at, row_bytes, index):
    """Stores 0 into the sequence of a row: it is being written."""
    records_at(rows_at + np.uint64(row_bytes * index), 1, np.int64)[0] = 0
    barrier()


@entry("uintp", "int64", "uintp", "int64", "int64")
def commit(rows_at, row_bytes, counter_at, index, tick):
    """Stores tick + 1 into the sequence of a row, then into the counter: the row is complete."""
    barrier()
    records_at(rows_at + np.uint64(row_bytes * index), 1, np.int64)[0] = tick + 1
    barrier()
    records_at(counter_at, 1, np.int64)[0] = tick + 1


RESULTS = np.dtype([("fault", "i8"), ("step_ns", "i8"), ("write_ns", "i8")])


@entry("uintp", "int64", "uintp", "uintp", *("int64",) * 5)
def finish(rows_at, row_bytes, results_at, counter_at, index, tick, fault, step_ns, write_ns):
    """Writes what is known at the end of a tick (RESULTS, at `results_at` of the row) and commits it."""
    results = records_at(rows_at + np.uint64(row_bytes * index) + results_at, 1, RESULTS)[0]
    results.fault = fault
    results.step_ns = step_ns
    results.write_ns = write_ns
    commit(rows_at, row_bytes, counter_at, index, tick)
