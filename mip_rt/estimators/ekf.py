"""The extended Kalman filter's arithmetic, once, for every filter of this project.

What is known beforehand is used: the Jacobians F = I + dt A and H are sparse (the places of their non-zero entries are fixed), R is
diagonal (so the measurements are taken one after the other as scalars, which equals the joint update exactly), P is symmetric.
All matrices have rows of `ROW` numbers (padding columns stay zero) and live in the filter's state record.

Numerics. The dense form P = (I - K H) P goes non-finite within seconds on these unstable models, because its rounding
asymmetry is multiplied by F from both sides at every step. Here each update subtracts one rank-one product g g'/S
(the Joseph form and this one agree for the optimal gain), and each prediction ends with a copy of the upper triangle to the
lower one, so that asymmetry cannot grow. Unobservable states (yaw, ball angle against its augmentation) only gain variance; `bound`
scales their rows and columns back (a congruence, which keeps P positive) so that hours of spinning change nothing.

Source: dissertation (5.35) and the cycle of section I.4 of the corrected equations; Bierman (1977) for sequential processing.
"""

import math
from typing import NamedTuple

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators.rows import ROW, VECTORS, add_scaled_vector, combine_rows, subtract_square

# Of indices that are loaded: unsigned ones need no test for negative values, 64 bits are dear on a 32-bit machine.
INDEX = np.uint64 if VECTORS else np.int32

MEASUREMENTS = 8  # the most measurements a filter may have

# Bits of STATE.status, set anew at every step.
REJECTED = 1  # an innovation failed its gate and was not used
REACCEPTED = 2  # a sensor had been rejected so often that the filter believed it again
NOT_FINITE = 4  # a measurement was not finite and was not used
UNHEALTHY = 8  # state or covariance is not finite, or a variance is not positive: reset the filter
BOUNDED = 16  # the variance of an unobservable state was held at its limit

# A sensor rejected this many times in a row is believed again: then the filter is wrong, not the sensor.
PATIENCE = 40

STATE = np.dtype(
    [
        ("x", "f8", (ROW,)),  # state estimate; entries beyond the n of the covariance stay zero, or are the filter's own memory
        ("P", "f8", (ROW, ROW)),  # its covariance
        ("innovation", "f8", (MEASUREMENTS,)),  # y - h(x) before the update; zero where a measurement was missing
        ("innovation_variance", "f8", (MEASUREMENTS,)),
        ("rejected", "i8", (MEASUREMENTS,)),  # innovations refused since the last reset, by measurement
        ("refused_in_a_row", "i8", (MEASUREMENTS,)),
        ("status", "i8"),
        # From here on scratch: nothing of it outlives a step, but for places that are written with the same number in each.
        ("A", "f8", (ROW, ROW)),  # df/dx, only its structural entries are ever written
        ("H", "f8", (MEASUREMENTS, ROW)),  # dh/dx, likewise
        ("h", "f8", (MEASUREMENTS,)),
        ("dx", "f8", (ROW,)),
        ("product", "f8", (ROW, ROW)),
        ("transposed", "f8", (ROW, ROW)),
    ],
    align=True,
)
PERSISTENT = STATE.fields["A"][1]  # bytes at the beginning of the record that the next step reads

NOISE = np.dtype(
    [
        ("Q", "f8", (ROW,)),  # process noise variance added per step (not per second)
        ("R", "f8", (MEASUREMENTS,)),  # measurement noise variance
        ("P0", "f8", (ROW,)),  # variance after a reset
        ("P_limit", "f8", (ROW,)),  # largest variance a state may have
        ("gate_squared", "f8"),  # an innovation beyond gate_squared * S is refused
        ("dt_s", "f8"),
    ],
    align=True,
)


class Pattern(NamedTuple):
    """Places of the structural non-zero entries of a matrix, row by row (compressed rows).

    Attributes:
        start: (rows + 1,) INDEX, where each row's entries begin in `columns`.
        columns: (entries,) INDEX.
    """

    start: np.ndarray
    columns: np.ndarray


def pattern(rows) -> Pattern:
    """The `Pattern` of a sequence of (row, columns) pairs, one for each row in order; a row may have no columns."""
    listed = [tuple(columns) for _, columns in sorted(rows)]
    start = np.cumsum([0] + [len(columns) for columns in listed]).astype(INDEX)
    return Pattern(start, np.array([c for columns in listed for c in columns], dtype=INDEX))


def init(noise, n, x0, P0):
    """A record of STATE with x = x0 (n,) and P = diag(P0) (n,); the noise's initial variances are replaced by P0."""
    state = np.zeros(1, STATE).view(np.recarray)[0]
    noise.P0[:n] = P0
    reset(state, noise, n)
    state.x[:n] = x0
    return state


@njit
def reset(state, noise, n):
    """Forgets everything: x = 0, P = diag(P0), counters zero. The caller then writes what it knows into state.x."""
    for i in range(ROW):
        state.x[i] = 0.0
        for j in range(ROW):
            state.P[i, j] = 0.0
    for i in range(n):
        state.P[i, i] = noise.P0[i]
    for m in range(MEASUREMENTS):
        state.innovation[m] = 0.0
        state.innovation_variance[m] = 0.0
        state.rejected[m] = 0
        state.refused_in_a_row[m] = 0
    state.status = 0


@njit
def _multiply(result, A, dt, start, columns, n, matrix, upper):
    """result = (I + dt A) matrix for the first n rows; where `upper` is 1, only the columns from the diagonal on are needed."""
    for i in range(n):
        combine_rows(result, i, matrix, i, A, i, dt, columns, start[i], start[i + 1], matrix, i * upper, n)


@njit
def predict(state, noise, start, columns, n):
    """P <- F P F' + Q with F = I + dt A from state.A; state.x is the caller's to advance."""
    P = state.P
    product = state.product
    transposed = state.transposed
    _multiply(product, state.A, noise.dt_s, start, columns, n, P, 0)
    for i in range(n):
        for j in range(n):
            transposed[j, i] = product[i, j]
    _multiply(P, state.A, noise.dt_s, start, columns, n, transposed, 1)
    for i in range(n):
        for j in range(i):
            P[i, j] = P[j, i]
        P[i, i] += noise.Q[i]


@njit
def update(state, noise, start, columns, n, m, y, valid):
    """Takes the measurements y (m,) one by one, those whose bit is set in `valid`; needs state.h and state.H at the prediction.

    Refused, missing and non-finite measurements leave state and covariance as they are and are flagged and counted.
    """
    P = state.P
    gain = state.product[0]
    dx = state.dx
    flags = state.status
    for i in range(ROW):
        dx[i] = 0.0
    for k in range(m):
        innovation = y[k] - state.h[k]
        state.innovation[k] = 0.0
        if not (valid >> k) & 1:
            continue
        if not abs(innovation) < math.inf:
            flags |= NOT_FINITE
            continue
        state.innovation[k] = innovation
        combine_rows(state.product, 0, P, ROW - 1, state.H, k, 1.0, columns, start[k], start[k + 1], P, 0, n)  # the last row of P is zero
        variance = noise.R[k]
        for e in range(start[k], start[k + 1]):
            c = columns[e]
            variance += state.H[k, c] * gain[c]
            innovation -= state.H[k, c] * dx[c]
        state.innovation_variance[k] = variance
        if not variance > 0.0:
            flags |= UNHEALTHY
            continue
        if innovation * innovation > noise.gate_squared * variance:
            state.rejected[k] += 1
            state.refused_in_a_row[k] += 1
            flags |= REJECTED
            if state.refused_in_a_row[k] <= PATIENCE:
                continue
            flags |= REACCEPTED
        else:
            state.refused_in_a_row[k] = 0
        inverse = 1.0 / variance
        add_scaled_vector(dx, innovation * inverse, gain, n)
        subtract_square(P, inverse, gain, n)
    add_scaled_vector(state.x, 1.0, dx, n)
    state.status = flags


@njit
def bound(state, noise, n):
    """Holds variances at their limits and tells whether the filter is still healthy (flags BOUNDED, UNHEALTHY)."""
    P = state.P
    total = 0.0
    for i in range(n):
        variance = P[i, i]
        total += state.x[i] * 0.0
        if variance > noise.P_limit[i]:
            scale = math.sqrt(noise.P_limit[i] / variance)
            for j in range(n):
                P[i, j] *= scale
            for j in range(n):
                P[j, i] *= scale
            state.status |= BOUNDED
        if not 0.0 < variance < math.inf:
            state.status |= UNHEALTHY
    if not total == 0.0:
        state.status |= UNHEALTHY
