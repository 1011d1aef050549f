"""The momentum about the ball's contact against the exact equations of motion: what may not depend on the torques does not."""

import numpy as np
import pytest

from mip_rt.models import mbbr, mbbr_momentum

pytestmark = pytest.mark.armhf


def parameters(model):
    p = np.zeros(1, mbbr_momentum.PARAMETERS).view(np.recarray)[0]
    mbbr_momentum.configure(p, model)
    return p


def momentum(x, p, scale=1.0):
    return np.array(mbbr_momentum.momentum(p, scale, x[0], x[1], mbbr.gyro(x), x[8], x[9]))


@pytest.mark.parametrize("seed", range(20))
def test_derivative_is_that_of_the_exact_model_under_any_torque(seed):
    """Leans up to 0.6 rad, spins up to 20 rad/s, random masses and torques."""
    random = np.random.default_rng(seed)
    body = 2.42e-3 * random.uniform(0.5, 2.0)
    model = mbbr.parameters(
        body_mass_kg=random.uniform(0.3, 1.0), ball_mass_kg=random.uniform(0.05, 0.3), com_height_m=random.uniform(0.05, 0.2),
        body_inertia_kg_m2=(body, body, 0.79e-3 * random.uniform(0.5, 2.0)), wheel_inertia_kg_m2=random.uniform(0.0, 3e-5),
    )[0]  # fmt: skip
    p = parameters(model)
    x = np.concatenate([random.uniform(-0.6, 0.6, 2), random.uniform(-3, 3, 3), random.uniform(-3, 3, 2), random.uniform(-20, 20, 3)])
    torque, rates, h = random.uniform(-0.5, 0.5, 3), np.zeros(5), 1e-6
    mbbr.acceleration_from_torque(x, torque, model, rates)
    ahead, behind = x.copy(), x.copy()
    for y, step in ((ahead, h), (behind, -h)):
        y[:3] += step * x[5:8]
        y[5:] += step * rates
    change = (momentum(ahead, p) - momentum(behind, p)) / (2 * h)
    a, b, c = mbbr.gyro(x)
    found = mbbr_momentum.derivative(p, 1.0, 1.0, x[0], x[1], a, b, c, *momentum(x, p))
    assert found[:3] == pytest.approx(x[5:8], rel=1e-12)
    assert found[3:5] == pytest.approx(change, rel=1e-6, abs=1e-5)
    assert found[5:] == pytest.approx(mbbr.encoder_rate(x)[:2], rel=1e-9, abs=1e-12)
    assert mbbr_momentum.ball_rate(p, 1.0, x[0], x[1], a, b, c, *momentum(x, p)) == pytest.approx(x[8:10], rel=1e-12)


def test_scales_stand_for_another_robot():
    p, other = parameters(mbbr.parameters()[0]), parameters(mbbr.parameters()[0])
    other.body *= 1.3
    other.gravity_s2 *= 0.8
    x = np.array([0.2, -0.1, 0.0, 0.0, 0.0, 0.5, -0.7, 6.0, 3.0, -4.0])
    assert momentum(x, p, 1.3) == pytest.approx(momentum(x, other), rel=1e-12)
    arguments = (x[0], x[1], *mbbr.gyro(x), *momentum(x, other))
    assert mbbr_momentum.derivative(p, 1.3, 0.8, *arguments) == pytest.approx(mbbr_momentum.derivative(other, 1.0, 1.0, *arguments), rel=1e-12)
