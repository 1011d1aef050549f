"""The two counter stores that commit a row, compiled; each becomes visible only after all that was stored before it."""

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
