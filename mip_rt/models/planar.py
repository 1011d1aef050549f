"""A planar inverted pendulum on a massless wheel: the lab model of O'Murchadha.

State x = [theta, phi, theta', phi']: theta is the wheel's angle relative to the body, phi the body's lean, both clockwise; the wheel's
place is r (theta + phi). The torque is the motor's, on the wheel: positive rolls it forward and tips the body backward.

The printed equations (6) have two errors, which `derivative(..., printed=True)` keeps for comparison: the body's inertia enters as I_b r / m_b (a dimension
error that makes it thirty times too small for a wheel of 3.5 cm), and the torque with the wrong sign. The paper states no parameter values; those of
`parameters` are a hand-sized robot of ours.

Source: O'Murchadha, (1) to (6), corrected as in sections H and I.7 of the equations.
"""

import math

import numpy as np

from mip_rt.compiled import njit

PARAMETERS = np.dtype(
    [
        ("body_mass_kg", "f8"),  # m_b
        ("wheel_radius_m", "f8"),  # r
        ("com_height_m", "f8"),  # l
        ("body_inertia_kg_m2", "f8"),  # I_b about the centre of mass
        ("gravity_m_s2", "f8"),
    ],
    align=True,
)
HAND_SIZED = {"body_mass_kg": 0.25, "wheel_radius_m": 0.035, "com_height_m": 0.1, "body_inertia_kg_m2": 8e-4, "gravity_m_s2": 9.81}


def parameters(**overrides):
    """A hand-sized robot with changes, (1,) record array of PARAMETERS; KeyError for an unknown name."""
    unknown = set(overrides) - set(HAND_SIZED)
    if unknown:
        raise KeyError(f"no such model parameter: {', '.join(sorted(unknown))}")
    p = np.zeros(1, PARAMETERS).view(np.recarray)
    for name, value in {**HAND_SIZED, **overrides}.items():
        p[name] = value
    return p


@njit
def derivative_into(x, torque, p, printed, out):
    """x' (4,) under `torque` (N m); `printed` 1 for the equations with their errors."""
    r, length, mb = p.wheel_radius_m, p.com_height_m, p.body_mass_kg
    sine = math.sin(x[1])
    cosine = math.cos(x[1])
    square = x[3] * x[3]
    inertia = p.body_inertia_kg_m2 / mb * (r if printed == 1 else 1.0)
    drive = torque / (mb * r) * (-1.0 if printed == 1 else 1.0)
    m11 = r
    m12 = r + length * cosine
    m21 = r * m12
    m22 = r * r + 2.0 * r * length * cosine + length * length + inertia
    b1 = length * square * sine + drive
    b2 = p.gravity_m_s2 * length * sine + r * length * square * sine
    determinant = m11 * m22 - m12 * m21
    out[0] = x[2]
    out[1] = x[3]
    out[2] = (m22 * b1 - m12 * b2) / determinant
    out[3] = (m11 * b2 - m21 * b1) / determinant


@njit
def advance(x, torque, p, printed, dt_s, substeps):
    """Moves x (4,) by dt_s under a held torque: `substeps` Runge-Kutta steps, in place."""
    k = np.empty((4, 4))
    trial = np.empty(4)
    h = dt_s / substeps
    for _ in range(substeps):
        derivative_into(x, torque, p, printed, k[0])
        for stage in range(1, 4):
            reach = h if stage == 3 else 0.5 * h
            for i in range(4):
                trial[i] = x[i] + reach * k[stage - 1, i]
            derivative_into(trial, torque, p, printed, k[stage])
        for i in range(4):
            x[i] += h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


def derivative(x, torque, p, printed: bool = False) -> np.ndarray:
    """x' (4,); p: record of PARAMETERS."""
    out = np.empty(4)
    derivative_into(np.asarray(x, float), float(torque), p, int(printed), out)
    return out


def linear_matrices(p, printed: bool = False):
    """A (4, 4), B (4, 1) of x' = A x + B torque upright."""
    r, length, mb, g = p.wheel_radius_m, p.com_height_m, p.body_mass_kg, p.gravity_m_s2
    inertia = p.body_inertia_kg_m2 / mb * (r if printed else 1.0)
    M = np.array([[r, r + length], [r * (r + length), (r + length) ** 2 + inertia]])
    A, B = np.zeros((4, 4)), np.zeros((4, 1))
    A[0, 2] = A[1, 3] = 1.0
    A[2:, 1] = np.linalg.solve(M, [0.0, g * length])
    B[2:, 0] = np.linalg.solve(M, [(-1.0 if printed else 1.0) / (mb * r), 0.0])
    return A, B


def energy(x, p) -> float:
    """Kinetic and potential energy, J; constant without torque. From the velocity of the centre of mass, not from the mass matrix."""
    _, lean, roll, lean_rate = np.asarray(x, float)
    along = p.wheel_radius_m * (roll + lean_rate) + p.com_height_m * math.cos(lean) * lean_rate
    up = -p.com_height_m * math.sin(lean) * lean_rate
    moving = 0.5 * p.body_mass_kg * (along**2 + up**2) + 0.5 * p.body_inertia_kg_m2 * lean_rate**2
    return float(moving + p.body_mass_kg * p.gravity_m_s2 * p.com_height_m * math.cos(lean))


def momentum(x, p) -> float:
    """Horizontal momentum, kg m/s; without torque the massless wheel passes no force, and it is constant."""
    _, lean, roll, lean_rate = np.asarray(x, float)
    return float(p.body_mass_kg * (p.wheel_radius_m * (roll + lean_rate) + p.com_height_m * math.cos(lean) * lean_rate))
