"""Linear-quadratic state feedback, designed from a model when the robot is configured; no library but numpy.

The continuous model is discretised with the command held over a tick, the Riccati equation is solved by doubling, and the
gain K gives u = -K x. Weights follow Bryson's rule: 1 / (tolerated value)^2.
"""

import numpy as np

TERMS = 20  # of the exponential's series after scaling to norm below 1/2
DOUBLINGS = 60  # each is worth twice the steps of the one before


def exponential(matrix) -> np.ndarray:
    """exp(matrix) by scaling and squaring."""
    m = np.asarray(matrix, float)
    halvings = max(0, int(np.ceil(np.log2(max(np.abs(m).sum(axis=1).max(), 1e-300)))) + 1)
    m = m / 2.0**halvings
    result = term = np.eye(len(m))
    for n in range(1, TERMS):
        term = term @ m / n
        result = result + term
    for _ in range(halvings):
        result = result @ result
    return result


def discretise(A, B, dt_s: float):
    """(Ad, Bd) of x_{k+1} = Ad x_k + Bd u_k with u held over a tick."""
    A, B = np.asarray(A, float), np.asarray(B, float)
    n, m = B.shape
    both = np.zeros((n + m, n + m))
    both[:n, :n], both[:n, n:] = A, B
    both = exponential(both * dt_s)
    return both[:n, :n], both[:n, n:]


def riccati(A, B, Q, R) -> np.ndarray:
    """The stabilising P of P = Q + A'P A - A'P B (R + B'P B)^-1 B'P A, by the structure-preserving doubling algorithm.

    Raises:
        ValueError: it does not settle: the pair cannot be stabilised, or a weight does not fit.
    """
    A, P = np.array(A, float), np.array(Q, float)
    G, unit = B @ np.linalg.solve(R, B.T), np.eye(len(A))
    for _ in range(DOUBLINGS):
        inverse = np.linalg.inv(unit + G @ P)
        growth = A.T @ P @ inverse @ A
        if not np.abs(growth).max() < 1e100:
            break
        G = G + A @ inverse @ G @ A.T
        A = A @ inverse @ A
        P = P + 0.5 * (growth + growth.T)
        if np.abs(growth).max() <= 1e-13 * np.abs(P).max():
            return P
    raise ValueError("the Riccati equation does not settle: the model cannot be stabilised with these weights")


def gains(A, B, tolerated_states, tolerated_commands, dt_s: float) -> np.ndarray:
    """K (m, n) of u = -K x for the continuous model x' = A x + B u.

    Args:
        tolerated_states: (n,) values that count as one; infinity for "does not matter".
        tolerated_commands: (m,) likewise.

    Raises:
        ValueError: see `riccati`, or the closed loop would not be stable.
    """
    Ad, Bd = discretise(A, B, dt_s)
    Q, R = np.diag(1.0 / np.square(tolerated_states)), np.diag(1.0 / np.square(tolerated_commands))
    P = riccati(Ad, Bd, Q, R)
    K = np.linalg.solve(R + Bd.T @ P @ Bd, Bd.T @ P @ Ad)
    if not np.abs(np.linalg.eigvals(Ad - Bd @ K)).max() < 1.0:
        raise ValueError("the closed loop would not be stable: give every state that drifts a weight")
    return K
