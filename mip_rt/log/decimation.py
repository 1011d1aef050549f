"""Fewer points for a screen that has fewer dots, without losing a spike."""

import numpy as np

SILENCE_TICKS = 5  # a longer gap between rows interrupts the lines


def decimated(times_s, values, bins: int):
    """At most 2 `bins` points and the gaps between them: the lowest and the highest of each bin in their order, so that every spike survives.

    A NaN interrupts the line, also where rows are missing for more than SILENCE_TICKS ticks.
    """
    if len(times_s) > 2 * bins:
        size = -(-len(times_s) // bins)
        full = len(times_s) // size * size
        rows = _extremes(values[:full].reshape(-1, size)) + np.arange(0, full, size)[:, None]
        rest = np.arange(full, len(times_s))
        if len(rest):
            rows = np.concatenate((rows, _extremes(values[None, full:]) + full))
        rows = np.unique(rows)
        step_s = size * float(np.median(np.diff(times_s)))
    else:
        rows = np.arange(len(times_s))
        step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.005
    times, kept = times_s[rows], values[rows]
    breaks = np.flatnonzero(np.diff(times) > SILENCE_TICKS * step_s) + 1
    return np.insert(times, breaks, times[breaks]), np.insert(kept, breaks, np.nan)


def _extremes(table):
    """(rows, 2) indices of the lowest and the highest number of each row of a table; NaN counts as neither."""
    missing = np.isnan(table)
    low = np.argmin(np.where(missing, np.inf, table), axis=1)
    high = np.argmax(np.where(missing, -np.inf, table), axis=1)
    return np.stack((low, high), axis=1)
