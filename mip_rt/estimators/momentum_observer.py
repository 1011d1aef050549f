"""Ball rate and lean of the MBBR without a model of its motors: from gyro and encoders through the angular momentum about the floor contact.

    x = [roll, pitch, l_x, l_y, phi_Bx, phi_By, gyro bias b_x, b_y, scale of the inertia, scale of gravity]
    l' depends on the lean alone (models.mbbr_momentum), w = w(l, Omega - b),   y = phi_B, the encoders' ball angle

Friction, backlash, rollers and unknown commands act between ball and body; on l they have no effect. So what is fast in the ball's rate shows in
the gyro, which is a thousand times less noisy than a difference of counts, and the encoders need only hold the slow part: the filter follows a
vibrating ball without following the vibration of its sensors. What the encoders say of l' tells in turn how far the robot leans from where its
weight is over the ball, without the accelerometer and its place, and what a crooked gyro shows while the robot spins. The two scales are the
robot's true inertia and weight: constants that 20 s of driving teach to a percent.

The gyro drives the model and is no measurement. A crooked chip shows a part of the spin as a rate about the other axes: when the spin changes,
so does the bias, and its variance grows with the square of that change; of the low-passed spin, as a robot that only shivers about its axis
must not forget its bias. The yaw is not a state: nothing here depends on it.

Tried and left out, as `mip-rt bench beyond` shows: the DMP's lean or the accelerometer as further measurements, and sigma points, none of which
makes a difference. Tried and removed: rolling resistance as an eleventh state, which finds the resistance but takes backlash for it, and Euler's
rule in place of the midpoint, which errs with the spin.

Source: ours, on the kernel `ekf`.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf
from mip_rt.models import mbbr_momentum

STATES = 10
MEASUREMENTS = 2
LEAN, MOMENTUM, ANGLE, BIAS, INERTIA, GRAVITY = 0, 2, 4, 6, 8, 9  # where they begin in x
# Bits of `valid`, in the places of the 13-state EKF's measurements.
GYRO_VALID, ENCODER_SHIFT = 0b11, 3
ALL_VALID = 0b11011

MOUNTING_RAD, SPIN_RAD_S = 0.02, 10.0  # a gyro's usual mounting error; low-pass on the spin
BIAS_WANDER = 1e-11  # (rad/s)^2 a step
PUSH_RAD_S = 0.004  # what hands, floor and rolling resistance change l by in a step
SLIP_RAD = 1e-4  # of the encoders' angle, a step
SCALE_WANDER = 1e-9  # a step; nothing changes them but load
SCALE_SIGMA = 0.15  # a model's inertia and weight are known to so much
SCALE_LEAST, SCALE_MOST = 0.6, 1.6
# A body that turns or leans less teaches no scale: noise would, a wrong one.
LEARN_RAD_S, LEARN_RAD = 0.02, 0.005
LOST_RATE_RAD_S = 0.5  # what a body rate that is not measured may be wrong by
LOST_ANGLE_RAD = 0.1  # likewise an encoder angle: on return it is believed, not its difference from before
START = (1e-4, 1e-4, 0.1, 0.1, 1e-5, 1e-5, 1e-5, 1e-5, SCALE_SIGMA**2, SCALE_SIGMA**2)  # variances after a reset

F_START, F_COLUMNS = ekf.pattern(
    [
        (0, (1, 6)),
        (1, (0, 7)),
        (2, (0, 3, 9)),
        (3, (1, 2, 9)),
        (4, (1, 2, 6, 8)),
        (5, (0, 3, 7, 8)),
        *[(i, ()) for i in range(6, 10)],
    ]
)
H_START, H_COLUMNS = ekf.pattern([(0, (ANGLE,)), (1, (ANGLE + 1,))])

PARAMETERS = np.dtype(
    [
        ("noise", ekf.NOISE),
        ("model", mbbr_momentum.PARAMETERS),
        ("mounting_squared", "f8"),
        ("spin_gain", "f8"),
        ("lost_lean_squared", "f8"),  # variance a step of the lean while the gyro is missing
        ("lead", "f8"),  # delay of the gyro in samples
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("gyro_rad_s", "f8", (3,)),  # newest sample
        ("rate_rad_s", "f8", (3,)),  # the same without its delay
        ("spin_rad_s", "f8"),  # low-passed yaw rate
        ("filter", ekf.STATE),
    ],
    align=True,
)


def configure(p, model, dt_s: float, gyro_variance: float, encoder_variance: float, gate_sigma: float, gyro_delay_s: float = 0.0) -> None:
    """Fills a record of PARAMETERS.

    Args:
        model: record of models.mbbr.PARAMETERS.
        gyro_variance: of a sample, (rad/s)^2.
        encoder_variance: of the ball angle that the encoders show, rad^2: rollers and backlash, not counts.
        gate_sigma: an innovation beyond so many standard deviations is refused.
        gyro_delay_s: of the gyro's low-pass against the encoders.
    """
    mbbr_momentum.configure(p.model, model)
    n = p.noise
    lean = gyro_variance * dt_s * dt_s
    n.Q[:STATES] = [lean] * 2 + [PUSH_RAD_S**2] * 2 + [SLIP_RAD**2] * 2 + [BIAS_WANDER] * 2 + [SCALE_WANDER] * 2
    n.R[:MEASUREMENTS] = encoder_variance
    n.P0[:STATES] = START
    n.P_limit[:] = [1.0, 1.0, 1e4, 1e4, 10.0, 10.0, 1.0, 1.0, 2 * SCALE_SIGMA**2, 2 * SCALE_SIGMA**2] + [1.0] * (len(n.P_limit) - STATES)
    n.gate_squared, n.dt_s = gate_sigma**2, dt_s
    p.mounting_squared = MOUNTING_RAD**2
    p.spin_gain = 1.0 - math.exp(-SPIN_RAD_S * dt_s)
    p.lost_lean_squared = (LOST_RATE_RAD_S * dt_s) ** 2
    p.lead = gyro_delay_s / dt_s


def init(p):
    """A state for a record of PARAMETERS: upright, at rest."""
    state = np.zeros(1, STATE).view(np.recarray)[0]
    reset(p, state, 0.0, 0.0, np.zeros(3), np.zeros(3))
    return state


@njit
def reset(p, state, roll, pitch, body_angle, gyro):
    """Fresh covariance and scales; lean, body rates and encoder angles as measured, ball at rest."""
    f = state.filter
    ekf.reset(f, p.noise, STATES)
    x = f.x
    x[LEAN] = roll
    x[LEAN + 1] = pitch
    for i in range(3):
        state.gyro_rad_s[i] = gyro[i]
        state.rate_rad_s[i] = gyro[i]
    state.spin_rad_s = gyro[2]
    for i in range(BIAS, BIAS + 2):
        f.P[i, i] += p.mounting_squared * gyro[2] * gyro[2]
    x[MOMENTUM], x[MOMENTUM + 1] = mbbr_momentum.momentum(p.model, 1.0, roll, pitch, gyro, 0.0, 0.0)
    x[ANGLE] = body_angle[0]
    x[ANGLE + 1] = body_angle[1]
    x[INERTIA] = 1.0
    x[GRAVITY] = 1.0


@njit
def _predict(p, f, a, b, c):
    """Midpoint rule with the mean body rates (a, b, c) of the step; Jacobian to first order in the lean."""
    x = f.x
    m = p.model
    dt = p.noise.dt_s
    half = 0.5 * dt
    scale = x[INERTIA]
    gravity = x[GRAVITY]
    r0, r1, _, l0, l1, _, _ = mbbr_momentum.derivative(m, scale, gravity, x[0], x[1], a, b, c, x[2], x[3])
    roll = x[0] + half * r0
    pitch = x[1] + half * r1
    r0, r1, z, l0, l1, a0, a1 = mbbr_momentum.derivative(m, scale, gravity, roll, pitch, a, b, c, x[2] + half * l0, x[3] + half * l1)
    A = f.A
    spin = m.spin * z
    fall = gravity * m.gravity_s2
    for i in range(2):
        A[i, BIAS + i] = -1.0
        A[MOMENTUM + i, i] = fall
        A[ANGLE + i, MOMENTUM + i] = 1.0
        A[ANGLE + i, BIAS + i] = 1.0 + scale * m.body
    A[0, 1] = z
    A[1, 0] = -z
    A[2, 3] = z
    A[3, 2] = -z
    learn = m.gravity_s2 if roll * roll + pitch * pitch > LEARN_RAD * LEARN_RAD else 0.0
    A[2, GRAVITY] = learn * roll
    A[3, GRAVITY] = learn * pitch
    A[4, 1] = -spin
    A[5, 0] = spin
    learn = -m.body if a * a + b * b > LEARN_RAD_S * LEARN_RAD_S else 0.0
    A[4, INERTIA] = learn * a
    A[5, INERTIA] = learn * b
    x[0] += dt * r0
    x[1] += dt * r1
    x[2] += dt * l0
    x[3] += dt * l1
    x[4] += dt * a0
    x[5] += dt * a1
    ekf.predict(f, p.noise, F_START, F_COLUMNS, STATES)


@njit
def step(p, state, y, valid):
    """One tick. Without a gyro the last rates hold on, without encoders the gyro alone carries the ball's rate.

    Args:
        p: record of PARAMETERS.
        state: a record with the fields of STATE.
        y: (>= 5,) gyro (3), rad/s, body axes, and the encoders' ball angle phi_B x, y, rad.
        valid: GYRO_VALID and, from bit ENCODER_SHIFT on, a bit for each angle that is fresh.
    """
    f = state.filter
    f.status = 0
    flags = 0
    x = f.x
    P = f.P
    rate = state.rate_rad_s
    fresh = valid & GYRO_VALID == GYRO_VALID
    if fresh and not abs(y[0] + y[1] + y[2]) < math.inf:
        fresh = False
        flags = ekf.NOT_FINITE
    a, b, c = rate[0], rate[1], rate[2]
    change = 0.0
    if fresh:
        for i in range(3):
            rate[i] = y[i] + p.lead * (y[i] - state.gyro_rad_s[i])
            state.gyro_rad_s[i] = y[i]
        change = p.spin_gain * (rate[2] - state.spin_rad_s)
        state.spin_rad_s += change
        a = 0.5 * (a + rate[0])
        b = 0.5 * (b + rate[1])
        c = 0.5 * (c + rate[2])
    _predict(p, f, a - x[BIAS], b - x[BIAS + 1], c)
    encoders = valid >> ENCODER_SHIFT
    for i in range(2):
        P[BIAS + i, BIAS + i] += p.mounting_squared * change * change
        if not fresh:
            P[LEAN + i, LEAN + i] += p.lost_lean_squared
        if not encoders >> i & 1:
            P[ANGLE + i, ANGLE + i] += LOST_ANGLE_RAD * LOST_ANGLE_RAD
        f.h[i] = x[ANGLE + i]
        f.H[i, ANGLE + i] = 1.0
    ekf.update(f, p.noise, H_START, H_COLUMNS, STATES, MEASUREMENTS, y[3:], encoders)
    for i in range(INERTIA, STATES):
        if x[i] < SCALE_LEAST:
            x[i] = SCALE_LEAST
        elif x[i] > SCALE_MOST:
            x[i] = SCALE_MOST
    ekf.bound(f, p.noise, STATES)
    f.status |= flags


@njit
def show(p, state, out):
    """Writes roll, pitch, -, their rates, yaw rate, and the ball's rates w_x, w_y into out (>= 8,); the yaw's place is left."""
    x = state.filter.x
    roll = x[LEAN]
    pitch = x[LEAN + 1]
    a = state.rate_rad_s[0] - x[BIAS]
    b = state.rate_rad_s[1] - x[BIAS + 1]
    c = state.rate_rad_s[2]
    turn = (math.sin(roll) * b + math.cos(roll) * c) / math.cos(pitch)
    out[0] = roll
    out[1] = pitch
    out[3] = a + math.sin(pitch) * turn
    out[4] = math.cos(roll) * b - math.sin(roll) * c
    out[5] = turn
    out[6], out[7] = mbbr_momentum.ball_rate(p.model, x[INERTIA], roll, pitch, a, b, c, x[MOMENTUM], x[MOMENTUM + 1])
