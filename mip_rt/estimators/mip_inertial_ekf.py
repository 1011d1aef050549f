"""The lean of a two-wheeled robot from gyro and accelerometer, aided by its wheels, without a model of motors, friction or masses.

    x = [lean, wheel angle against the ground W, forward speed of the IMU V, gyro bias x and y, share k of the yaw rate in gyro x, IMU's place e]
    lean' = w_x - b_x - k w_z,   W' = v / r,   V' = a_y cos(lean) - a_z sin(lean) - yaw'^2 p_y
    phi = W - lean,   w_y = b_y + w_z tan(lean)

with yaw' = w_z / cos(lean), v = V + yaw' p_x - lean' p_z the speed of the axle, and p the place of the IMU against the axle's middle in axes that
turn with the heading but do not lean: p_y = (l_y + e) cos(lean) - l_z sin(lean), p_z = (l_y + e) sin(lean) + l_z cos(lean).

Gyro and accelerometer (papers' sign) drive the model, so commands need not be known: friction, delay, battery, the wheels' inertia cannot bend
the lean. The wheels tell leaning from accelerating. A robot on two wheels has no sideways tilt, so while it turns the gyro's y axis shows
the lean directly: at 10 rad/s a rate of 1.75 mrad/s is a lean of 0.18 mrad; that is what makes the IMU's own place observable. Samples of the inputs
are at the end of their interval: the mean of the last two stands for it.

All noise is a density, so that one set holds at any sample rate; optima are flat. Errors beside those of the other estimators: `mip-rt bench
estimators --robot edumip`. Tried on the same motion, on other seeds, and removed: the dynamic EKF (`mip_ekf`) with a gyro bias as a state, with
a disturbance on the command as well, with the gyro's y axis and the IMU's place (each two to ten times the error of this filter, more where
friction or inertia are not the model's); this filter without the gyro's y axis or without share and place (as good while the IMU sits as
believed, up to a hundred times worse where it does not).

Source: ours, on the kernel `ekf`; kinematics: dissertation (3.26), section I.1 of the corrected equations.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf

STATES = 7
MEASUREMENTS = 2
PHI_VALID, GYRO_VALID, ACCELEROMETER_VALID = 1, 2, 4
ALL_VALID = PHI_VALID | GYRO_VALID | ACCELEROMETER_VALID
RATE, PUSH, ROLL, TURN = range(STATES, STATES + 4)  # in x, behind the states: lean', V', W' and w_z of the newest sample

GYRO_NOISE = 2e-4  # rad/s/sqrt(Hz)
GYRO_RATE_NOISE = 5e-4  # ... for each rad/s of yaw: timing, scale and axes
GYRO_WALK = 1e-4  # rad/s/sqrt(s), of the biases
ACCELEROMETER_NOISE = 0.02  # m/s^2/sqrt(Hz)
BLIND_NOISE = 5.0  # m/s^2 that a robot without an accelerometer may have
SLIP = 3e-3  # rad/sqrt(s), of the wheels
SHARE_WALK, PLACE_WALK = 1e-4, 1e-4  # 1/sqrt(s), m/sqrt(s)
ANGLE_NOISE = 4e-3  # rad, backlash and counts
SIDE_NOISE = 0.02  # rad/s of the gyro's y axis: axes 2 % off while the lean changes by 1 rad/s, an uneven floor
# What no robot of this kind can do is a spike: such a sample counts as missing, the gyro's at most PATIENCE times in a row.
LARGEST_SPIN_UP, LARGEST_TURN_UP = 800.0, 400.0  # rad/s^2 of lean and yaw
LARGEST_PUSH, LARGEST_UP = 30.0, 40.0  # m/s^2 along the ground, and across it with gravity
GATE_SIGMA, PATIENCE, GYRO = 20.0, 4, MEASUREMENTS  # GYRO: where the filter's state counts refused gyro samples
INITIAL = (0.02, 0.01, 0.02, 0.003, 0.003, 0.02, 0.005)  # standard deviations after a reset; biases as a calibration in the hand leaves them
LARGEST = (1.0, 10.0, 5.0, 0.035, 0.035, 0.1, 0.05)

PARAMETERS = np.dtype(
    [
        ("noise", ekf.NOISE),
        ("lever_m", "f8", (3,)),  # IMU from the axle's middle, body axes
        ("wheel_radius_m", "f8"),
        ("lead", "f8"),  # gyro delay in steps
        ("rate_noise", "f8"),  # variance of the lean a step for each (rad/s)^2 of yaw
        ("blind", "f8"),  # variance of the speed a step without an accelerometer
        ("rate_step", "f8"),  # largest change of lean rate and of yaw rate in a step
        ("turn_step", "f8"),
    ],
    align=True,
)

F_START, F_COLUMNS = ekf.pattern([(0, (3, 5)), (1, (0, 2, 3, 5, 6)), (2, (0, 6)), (3, ()), (4, ()), (5, ()), (6, ())])
H_START, H_COLUMNS = ekf.pattern([(0, (0, 1)), (1, (0, 4))])


def configure(p, dt_s: float, lever_m, wheel_radius_m: float, gyro_delay_s: float = 0.0) -> None:
    """Derives the constants, once.

    Args:
        lever_m: (3,) IMU from the middle of the axle, body axes.
        gyro_delay_s: delay of the gyro's low-pass, made good as in `attitude`.
    """
    n = p.noise
    n.dt_s = dt_s
    n.Q[:STATES] = np.square([GYRO_NOISE, SLIP, ACCELEROMETER_NOISE, GYRO_WALK, GYRO_WALK, SHARE_WALK, PLACE_WALK]) * dt_s
    n.R[:MEASUREMENTS] = ANGLE_NOISE**2, SIDE_NOISE**2
    n.P0[:STATES], n.P_limit[:STATES] = np.square(INITIAL), np.square(LARGEST)
    n.gate_squared = GATE_SIGMA**2
    p.lever_m[:], p.wheel_radius_m, p.lead = lever_m, wheel_radius_m, gyro_delay_s / dt_s
    p.rate_noise, p.blind = GYRO_RATE_NOISE**2 * dt_s, (BLIND_NOISE * dt_s) ** 2
    p.rate_step, p.turn_step = LARGEST_SPIN_UP * dt_s, LARGEST_TURN_UP * dt_s


def init(p, x0, P0):
    """A filter state with x = x0 (7,) and P = diag(P0) (7,)."""
    return ekf.init(p.noise, STATES, x0, P0)


@njit
def reset(p, state, lean, phi, rate, turn):
    """Fresh covariance; lean, wheel angle, lean rate and gyro z as measured, wheels at rest."""
    ekf.reset(state, p.noise, STATES)
    x = state.x
    x[0] = lean
    x[1] = phi + lean
    x[2] = rate * (p.lever_m[1] * math.sin(lean) + p.lever_m[2] * math.cos(lean))
    x[RATE] = rate
    x[TURN] = turn


@njit
def step(p, state, u, y, valid):
    """One cycle.

    Args:
        p: record of PARAMETERS.
        state: record of ekf.STATE.
        u: (4,) gyro x, gyro z, accelerometer y, accelerometer z (papers' sign), body axes.
        y: (2,) phi, gyro y.
        valid: PHI_VALID, GYRO_VALID, ACCELEROMETER_VALID where they are fresh; without a gyro the last rates hold.
    """
    state.status = 0
    flags = 0
    x = state.x
    A = state.A
    dt = p.noise.dt_s
    if valid & GYRO_VALID and not abs(u[0] + u[1]) < math.inf:
        valid &= ~GYRO_VALID
        flags |= ekf.NOT_FINITE
    if valid & ACCELEROMETER_VALID and not abs(u[2] + u[3]) < math.inf:
        valid &= ~ACCELEROMETER_VALID
        flags |= ekf.NOT_FINITE
    turn = x[TURN]
    rate = x[RATE]
    if valid & GYRO_VALID:
        newest = u[0] - x[3] - x[5] * u[1]
        if abs(newest - rate) > p.rate_step or abs(u[1] - turn) > p.turn_step:
            flags |= ekf.REJECTED
            state.rejected[GYRO] += 1
            state.refused_in_a_row[GYRO] += 1
        else:
            state.refused_in_a_row[GYRO] = 0
        if flags & ekf.REJECTED and state.refused_in_a_row[GYRO] <= PATIENCE:
            valid &= ~GYRO_VALID  # nor its y axis
        else:
            turn = u[1]
            rate = newest
            state.refused_in_a_row[GYRO] = 0
    x[TURN] = turn
    middle = 0.5 * (x[RATE] + rate) + p.lead * (rate - x[RATE])
    x[RATE] = rate
    x[0] += dt * middle
    sine = math.sin(x[0])
    cosine = math.cos(x[0])
    lever = p.lever_m[1] + x[6]
    py = lever * cosine - p.lever_m[2] * sine
    pz = lever * sine + p.lever_m[2] * cosine
    tangent = sine / cosine
    yaw = turn / cosine
    square = yaw * yaw
    push = 0.0
    up = 0.0
    if valid & ACCELEROMETER_VALID:
        push = u[2] * cosine - u[3] * sine - square * py
        up = square * (pz - 2.0 * tangent * py) - u[2] * sine - u[3] * cosine
        if not (abs(push) < LARGEST_PUSH and abs(up) < LARGEST_UP):
            push = 0.0
            up = 0.0
            valid &= ~ACCELEROMETER_VALID
            flags |= ekf.REJECTED
    before = x[2]
    x[2] += 0.5 * dt * (x[PUSH] + push)
    x[PUSH] = push
    inverse = 1.0 / p.wheel_radius_m
    x[1] += dt * inverse * (0.5 * (before + x[2]) + yaw * p.lever_m[0] - middle * pz)
    A[0, 3] = -1.0
    A[0, 5] = -turn
    A[1, 0] = inverse * (yaw * tangent * p.lever_m[0] - middle * py)
    A[1, 2] = inverse
    A[1, 3] = pz * inverse
    A[1, 5] = turn * pz * inverse
    A[1, 6] = -middle * sine * inverse
    A[2, 0] = up
    A[2, 6] = -square * cosine
    ekf.predict(state, p.noise, F_START, F_COLUMNS, STATES)
    state.P[0, 0] += p.rate_noise * turn * turn
    if not valid & ACCELEROMETER_VALID:
        state.P[2, 2] += p.blind
    state.h[0] = x[1] - x[0]
    state.h[1] = x[4] + turn * tangent
    H = state.H
    H[0, 0] = -1.0
    H[0, 1] = 1.0
    H[1, 0] = turn / (cosine * cosine)
    H[1, 4] = 1.0
    ekf.update(state, p.noise, H_START, H_COLUMNS, STATES, MEASUREMENTS, y, valid & 3)
    x[ROLL] = inverse * (x[2] + yaw * p.lever_m[0] - rate * pz)
    ekf.bound(state, p.noise, STATES)
    state.status |= flags
