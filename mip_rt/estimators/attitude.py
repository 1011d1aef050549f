"""Attitude from raw gyro and accelerometer, any orientation: an error-state Kalman filter that makes the robot independent of the DMP.

    x = [error of the attitude about the inertial x and y, gyro bias b (3), velocity v_x, v_y, gyro scale error k (3)]
    R' = R [(1 - k) w - b]x,   v' = (R a)_xy,   y = v

The accelerometer alone cannot tell leaning from accelerating, but no robot accelerates for ever: its velocity stays near a known one, zero
where nothing better is known. That knowledge is the measurement; the accelerometer drives the model. What the filter corrects is thus a
second-order low-pass of the acceleration in inertial axes, with the corner that noise and motion ask for, and where wheels measure the
velocity the same filter separates leaning from accelerating. Gyro errors grow with the rate (scale, axes, timing), so the process noise does:
a filter at rest is slow, one that turns is quick. The heading is the integral of the rates: nothing here measures it, so neither its error
nor the vertical velocity is a state.

All numbers are per second, so that one set holds at any sample rate. They were chosen on four trials of BROAD, each checked on the other
three (`mip-rt bench broad`); optima are flat. Tried there and removed, because they changed the error by less than 1 % or made it worse:
position and accelerometer bias as states, a decaying velocity, noise that grows with the acceleration, detection of rest.

Source: ours, on the kernel `ekf`; low-pass in inertial axes: Laidig and Seel, "VQF", Information Fusion 91 (2023); error states:
Sola, "Quaternion kinematics for the error-state Kalman filter", arXiv:1711.02508, sections 5 and 6.
"""

import math

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators import ekf

STATES = 10
MEASUREMENTS = 2
GYRO_VALID, ACCELEROMETER_VALID, VELOCITY_VALID = 1, 2, 4
ALL_VALID = GYRO_VALID | ACCELEROMETER_VALID | VELOCITY_VALID
ERROR, BIAS, VELOCITY, SCALE = 0, 2, 5, 7  # where they begin in x

GYRO_NOISE = 2e-4  # rad/s/sqrt(Hz)
GYRO_RATE_NOISE = 2.2e-3  # ... for each rad/s of rate: a scale error of 1 % that changes its direction twenty times a second
GYRO_WALK = 2.2e-4  # rad/s/sqrt(s), of the bias
ACCELEROMETER_NOISE = 0.02  # m/s^2/sqrt(Hz)
UNKNOWN_VELOCITY = 0.35  # m/s/sqrt(Hz): what is carried about stays near a velocity of zero
INITIAL_TILT, INITIAL_BIAS, INITIAL_VELOCITY, INITIAL_SCALE = 0.1, 0.0087, 0.1, 0.01  # rad, rad/s, m/s, 1
CALIBRATED_BIAS = 0.003  # rad/s, what a calibration in the hand leaves
LARGEST_TILT, LARGEST_BIAS, LARGEST_VELOCITY, LARGEST_SCALE = 1.0, 0.035, 5.0, 0.03

PARAMETERS = np.dtype(
    [
        ("noise", ekf.NOISE),
        ("gyro_noise_squared", "f8"),  # variance of the attitude a step
        ("rate_noise_squared", "f8"),  # ... for each (rad/s)^2
        ("lead", "f8"),  # gyro delay in steps
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("quaternion", "f8", (4,)),  # w, x, y, z, sensor to inertial (z up)
        ("rate_rad_s", "f8", (3,)),  # newest measured rates
        ("started", "i8"),
        ("filter", ekf.STATE),
    ],
    align=True,
)
PERSISTENT = STATE.fields["filter"][1] + ekf.PERSISTENT  # bytes at the beginning of the record that the next step reads

F_START, F_COLUMNS = ekf.pattern(
    [(0, (2, 3, 4, 7, 8, 9)), (1, (2, 3, 4, 7, 8, 9)), (2, ()), (3, ()), (4, ()), (5, (1,)), (6, (0,)), (7, ()), (8, ()), (9, ())]
)
H_START, H_COLUMNS = ekf.pattern([(0, (5,)), (1, (6,))])


def configure(p, dt_s: float, velocity_noise: float = UNKNOWN_VELOCITY, gyro_delay_s: float = 0.0) -> None:
    """Derives the constants, once.

    Args:
        velocity_noise: density of the known velocity's error, m/s/sqrt(Hz).
        gyro_delay_s: delay of the gyro's low-pass; rates are extrapolated by it, so that the attitude is that of the sample's moment.
    """
    n = p.noise
    n.dt_s = dt_s
    n.P0[:STATES] = np.square([INITIAL_TILT] * 2 + [INITIAL_BIAS] * 3 + [INITIAL_VELOCITY] * 2 + [INITIAL_SCALE] * 3)
    n.P_limit[:] = np.inf
    n.P_limit[:STATES] = np.square([LARGEST_TILT] * 2 + [LARGEST_BIAS] * 3 + [LARGEST_VELOCITY] * 2 + [LARGEST_SCALE] * 3)
    n.Q[:STATES] = np.array([0.0] * 2 + [GYRO_WALK**2] * 3 + [ACCELEROMETER_NOISE**2] * 2 + [0.0] * 3) * dt_s
    n.R[:MEASUREMENTS] = velocity_noise**2 / dt_s
    n.gate_squared = np.inf  # the velocity is knowledge, not a sensor that may be sick
    p.gyro_noise_squared, p.rate_noise_squared = GYRO_NOISE**2 * dt_s, GYRO_RATE_NOISE**2 * dt_s
    p.lead = gyro_delay_s / dt_s


def init(p, x0=None, P0=None):
    """A state that starts at its first sample, or at the quaternion x0 (4,), with P = diag(P0) (10,) where given."""
    state = np.zeros(1, STATE).view(np.recarray)[0]
    if P0 is not None:
        p.noise.P0[:STATES] = P0
    if x0 is not None:
        ekf.reset(state.filter, p.noise, STATES)
        state.quaternion[:], state.started = x0, 1
    return state


@njit
def _start(p, state, y):
    """Level as the accelerometer says, heading zero; waits for a sample that says something."""
    norm = math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2])
    if not (norm > 0.0 and norm < math.inf):
        return False
    ekf.reset(state.filter, p.noise, STATES)
    q = state.quaternion
    if y[2] > -0.999 * norm:
        length = math.sqrt(2.0 * norm * (norm + y[2]))
        q[0] = (norm + y[2]) / length
        q[1] = y[1] / length
        q[2] = -y[0] / length
    else:
        q[0] = 0.0
        q[1] = 1.0
        q[2] = 0.0
    q[3] = 0.0
    return True


@njit
def forget_bias(state):
    """The caller has calibrated the gyro: what remains is none as far as one knows, whatever was learned before."""
    f = state.filter
    for i in range(BIAS, BIAS + 3):
        f.x[i] = 0.0
        for j in range(STATES):
            f.P[i, j] = 0.0
            f.P[j, i] = 0.0
        f.P[i, i] = CALIBRATED_BIAS * CALIBRATED_BIAS


@njit
def _turn(q, x, y, z):
    """q <- q * (rotation by the vector (x, y, z) in sensor axes), normalised."""
    square = 0.25 * (x * x + y * y + z * z)
    c = 1.0 - square * (0.5 - square / 24.0)
    s = 0.5 - square / 12.0
    x *= s
    y *= s
    z *= s
    a, b, d, e = q[0], q[1], q[2], q[3]
    w = a * c - b * x - d * y - e * z
    i = a * x + b * c + d * z - e * y
    j = a * y - b * z + d * c + e * x
    k = a * z + b * y - d * x + e * c
    scale = 1.0 / math.sqrt(w * w + i * i + j * j + k * k)
    q[0] = w * scale
    q[1] = i * scale
    q[2] = j * scale
    q[3] = k * scale


@njit
def _correct(q, x):
    """Moves the error of the attitude, inertial axes, from x into q."""
    a = 0.5 * x[0]
    b = 0.5 * x[1]
    x[0] = 0.0
    x[1] = 0.0
    w, i, j, k = q[0], q[1], q[2], q[3]
    q[0] = w - a * i - b * j
    q[1] = i + a * w + b * k
    q[2] = j + b * w - a * k
    q[3] = k + a * j - b * i


@njit
def step(p, state, u, y, valid):
    """One tick. Without a gyro the attitude is carried on by the last rates, without an accelerometer the velocity stays.

    Args:
        p: record of PARAMETERS.
        state: record of STATE; the estimate is `quaternion`, `filter` holds biases, velocity, scale errors and their covariance.
        u: (3,) gyro, rad/s, sensor axes.
        y: (5,) specific force (+g up at rest), m/s^2, sensor axes, and the known velocity x, y, m/s, inertial axes of this filter's heading.
        valid: GYRO_VALID, ACCELEROMETER_VALID, VELOCITY_VALID where they are fresh.
    """
    f = state.filter
    f.status = 0
    flags = 0
    if valid & GYRO_VALID and not abs(u[0] + u[1] + u[2]) < math.inf:
        valid &= ~GYRO_VALID
        flags |= ekf.NOT_FINITE
    if valid & ACCELEROMETER_VALID and not abs(y[0] + y[1] + y[2]) < math.inf:
        valid &= ~ACCELEROMETER_VALID
        flags |= ekf.NOT_FINITE
    if state.started == 0:
        if not valid & ACCELEROMETER_VALID or not _start(p, state, y):
            f.status = flags
            return
        for i in range(3):
            state.rate_rad_s[i] = u[i] if valid & GYRO_VALID else 0.0
        state.started = 1
    x = f.x
    q = state.quaternion
    last = state.rate_rad_s
    noise = p.noise
    dt = noise.dt_s
    lead = p.lead if valid & GYRO_VALID else 0.0
    rate = f.dx  # scratch, as far as the update
    square = 0.0
    for i in range(3):
        newest = u[i] if valid & GYRO_VALID else last[i]
        trusted = (1.0 - x[SCALE + i]) * newest - x[BIAS + i]
        rate[i] = dt * (trusted + lead * (newest - last[i]))
        last[i] = newest
        square += trusted * trusted
    _turn(q, rate[0], rate[1], rate[2])
    w, i, j, k = q[0], q[1], q[2], q[3]
    r00 = 1.0 - 2.0 * (j * j + k * k)
    r01 = 2.0 * (i * j - w * k)
    r02 = 2.0 * (i * k + w * j)
    r10 = 2.0 * (i * j + w * k)
    r11 = 1.0 - 2.0 * (i * i + k * k)
    r12 = 2.0 * (j * k - w * i)
    A = f.A
    A[0, BIAS] = -r00
    A[0, BIAS + 1] = -r01
    A[0, BIAS + 2] = -r02
    A[1, BIAS] = -r10
    A[1, BIAS + 1] = -r11
    A[1, BIAS + 2] = -r12
    for m in range(3):
        A[0, SCALE + m] = A[0, BIAS + m] * last[m]
        A[1, SCALE + m] = A[1, BIAS + m] * last[m]
    up = 9.81
    if valid & ACCELEROMETER_VALID:
        x[VELOCITY] += dt * (r00 * y[0] + r01 * y[1] + r02 * y[2])
        x[VELOCITY + 1] += dt * (r10 * y[0] + r11 * y[1] + r12 * y[2])
        up = 2.0 * (i * k - w * j) * y[0] + 2.0 * (j * k + w * i) * y[1] + (1.0 - 2.0 * (i * i + j * j)) * y[2]
    A[VELOCITY, 1] = up
    A[VELOCITY + 1, 0] = -up
    ekf.predict(f, noise, F_START, F_COLUMNS, STATES)
    wander = p.gyro_noise_squared + p.rate_noise_squared * square
    f.P[0, 0] += wander
    f.P[1, 1] += wander
    f.h[0] = x[VELOCITY]
    f.h[1] = x[VELOCITY + 1]
    f.H[0, VELOCITY] = 1.0
    f.H[1, VELOCITY + 1] = 1.0
    ekf.update(f, noise, H_START, H_COLUMNS, STATES, MEASUREMENTS, y[3:], 3 if valid & VELOCITY_VALID else 0)
    _correct(q, x)
    ekf.bound(f, noise, STATES)
    f.status |= flags
    if not abs(q[0] + q[1] + q[2] + q[3]) < math.inf:
        f.status |= ekf.UNHEALTHY


@njit
def run(p, state, gyro, force, quaternion):
    """A recording: gyro (n, 3), specific force (n, 3), velocity unknown; fills quaternion (n, 4)."""
    y = np.zeros(5)
    for n in range(len(gyro)):
        for i in range(3):
            y[i] = force[n, i]
        step(p, state, gyro[n], y, ALL_VALID)
        for i in range(4):
            quaternion[n, i] = state.quaternion[i]
