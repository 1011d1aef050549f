"""EKF accuracy with known inputs and the paper's sensor noise alone: the experiment behind errata items 2 and 3.

Exact plant with the constants of the printed coefficients (so that only the printed errors differ), linear motors, no friction; the
controller sees the true state and drives circles of a given speed while the robot spins; filters see noisy measurements (6.23) and the true
command.
"""

import math

import numpy as np

from mip_rt.estimators import mbbr_ekf
from mip_rt.models import mbbr, mbbr_yaw

DT = 0.005
SUBSTEPS = 5
NOISE = np.array([2.08e-6] * 3 + [7.62e-5] * 3 + [1.41] * 2)
PROCESS = np.array([1e-5, 1e-5, 1e-4, 1e-4, 1e-4, 0.1, 0.1, 2.0, 0.1, 0.1, 1e-3, 1e-3, 1e-3])  # (6.30)
C1, C2, C3, C4, C5, C6 = 16.0, 0.34, 1.94, 0.31, 0.4, 1.2


def filter_of(variant: str, model):
    """(parameters, state) of a 13-state EKF with the noise of (6.23) and (6.30)."""
    p = np.zeros(1, mbbr_ekf.PARAMETERS).view(np.recarray)[0]
    coefficients = mbbr_yaw.coefficients(model, variant)[0]
    for name in mbbr_yaw.COEFFICIENTS.names:
        p.model[name] = coefficients[name]
    p.noise.Q[:13], p.noise.R[:], p.noise.P_limit[:] = PROCESS, NOISE, 10.0
    p.noise.gate_squared, p.noise.dt_s = 1e18, DT
    return p, mbbr_ekf.init(p, np.zeros(13), np.full(13, 1e-5))


def command(x, angle, time_s, yaw_rate, speed_rad_s):
    """State feedback on the true state towards a circling reference of the ball's inertial rates."""
    c, s = math.cos(x[2]), math.sin(x[2])
    turn = 0.5 * time_s
    wanted = speed_rad_s * np.array([math.cos(turn), math.sin(turn)])
    place = speed_rad_s / 0.5 * np.array([math.sin(turn), 1.0 - math.cos(turn)])
    lag = place - angle
    error_angle = np.array([c * lag[0] + s * lag[1], -s * lag[0] + c * lag[1]])
    error_rate = np.array([c * wanted[0] + s * wanted[1], -s * wanted[0] + c * wanted[1]]) - x[8:10]
    tilt = C1 * x[:2] + C3 * x[5:7] - C2 * error_angle - C4 * error_rate
    return np.array([*tilt, -C5 * (yaw_rate * time_s - x[2]) - C6 * (yaw_rate - x[7])])


def run(variants, yaw_rate_hz: float, speed_m_s: float, duration_s: float = 20.0, seed: int = 1) -> dict:
    """{variant: (tilt RMS error in rad, ball speed RMS error in rad/s)}, per axis, after the first two seconds.

    Args:
        variants: names of mbbr_yaw.VARIANTS.
    """
    model = mbbr.printed_parameters()[0]
    filters = {variant: filter_of(variant, model) for variant in variants}
    random = np.random.default_rng(seed)
    x, body_angle, u = np.zeros(10), np.zeros(3), np.zeros(3)
    yaw_rate, ticks, skipped = 2 * math.pi * yaw_rate_hz, round(duration_s / DT), round(2.0 / DT)
    squares = {variant: np.zeros(2) for variant in variants}
    h = DT / SUBSTEPS
    for k in range(ticks):
        for _ in range(SUBSTEPS):
            before = mbbr.encoder_rate(x)
            k1 = mbbr.derivative(x, u, model)
            k2 = mbbr.derivative(x + h / 2 * k1, u, model)
            k3 = mbbr.derivative(x + h / 2 * k2, u, model)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + mbbr.derivative(x + h * k3, u, model))
            body_angle += 0.5 * h * (before + mbbr.encoder_rate(x))
        force = mbbr.accelerometer(x, mbbr.acceleration(x, u, model), model)
        y = np.concatenate([mbbr.gyro(x), body_angle, force[:2]]) + random.normal(size=8) * np.sqrt(NOISE)
        for variant, (p, state) in filters.items():
            mbbr_ekf.step(p, state, u, y, mbbr_ekf.ALL_VALID)
            if k >= skipped:
                squares[variant] += ((np.asarray(state.x[:2]) - x[:2]) ** 2).sum(), ((np.asarray(state.x[8:10]) - x[8:10]) ** 2).sum()
        u = command(x, x[3:5], (k + 1) * DT, yaw_rate, speed_m_s / model.ball_radius_m)
    counted = 2 * (ticks - skipped)
    return {variant: tuple(np.sqrt(total / counted)) for variant, total in squares.items()}
