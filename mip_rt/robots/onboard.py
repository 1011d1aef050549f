"""The attitude of a robot without the DMP: `estimators.attitude` on the words of the packet, with the velocity that the wheels show.

Whoever carries the robot moves it somehow: then the filter knows only that velocities stay near zero. A robot that balances rolls on the
ground, and its wheels tell how fast.
"""

import math

import numpy as np

from mip_rt import frame
from mip_rt.compiled import njit
from mip_rt.estimators import attitude, ekf
from mip_rt.robots import sensors

ANEW_TICKS = 10  # after so many missing samples the filter starts anew
WHEEL_VELOCITY_NOISE = 0.1  # m/s/sqrt(Hz), of the velocity that wheels show: slip, rollers, backlash

# The last fields of a robot's records.
PARAMETERS = np.dtype(
    [
        ("carried", attitude.PARAMETERS),  # in someone's hands: any velocity near zero
        ("rolling", attitude.PARAMETERS),  # balancing: the velocity that the wheels show
    ],
    align=True,
)
STATE = np.dtype(
    [
        ("edge_ns", "i8"),  # interrupt of the newest sample, 0 before the first
        ("gap", "i8"),  # samples in a row that are missing
        ("gyro_bias_rad_s", "f8", (3,)),  # of the newest sample's row
        ("rate", "f8", (3,)),
        ("measured", "f8", (5,)),
        ("filter", attitude.STATE),
    ],
    align=True,
)
SCRATCH = STATE.itemsize - STATE.fields["filter"][1] - attitude.PERSISTENT  # bytes at its end


def configure(p, config, dt_s: float) -> None:
    """Fills a record of PARAMETERS."""
    attitude.configure(p.carried, dt_s, attitude.UNKNOWN_VELOCITY, config.imu.gyro_delay_s)
    attitude.configure(p.rolling, dt_s, WHEEL_VELOCITY_NOISE, config.imu.gyro_delay_s)


@njit
def _known_velocity(p, s, q, rolling, y):
    """Puts the velocity of the IMU into y[3:]: of the centre of what rolls, from its rates, and of the lever about it."""
    w, i, j, k = q[0], q[1], q[2], q[3]
    lever = p.lever_m
    x0, x1, x2 = rolling[0], rolling[1], rolling[2]
    c0 = s.gyro_rad_s[1] * lever[2] - s.gyro_rad_s[2] * lever[1]
    c1 = s.gyro_rad_s[2] * lever[0] - s.gyro_rad_s[0] * lever[2]
    c2 = s.gyro_rad_s[0] * lever[1] - s.gyro_rad_s[1] * lever[0]
    a0 = 1.0 - 2.0 * (j * j + k * k)
    a1 = 2.0 * (i * j - w * k)
    a2 = 2.0 * (i * k + w * j)
    b0 = 2.0 * (i * j + w * k)
    b1 = 1.0 - 2.0 * (i * i + k * k)
    b2 = 2.0 * (j * k - w * i)
    y[3] = p.rolling_radius_m * (b0 * x0 + b1 * x1 + b2 * x2) + a0 * c0 + a1 * c1 + a2 * c2
    y[4] = -p.rolling_radius_m * (a0 * x0 + a1 * x1 + a2 * x2) + b0 * c0 + b1 * c1 + b2 * c2


@njit
def step(p, s, pa, sa, row, rolling, limits):
    """Fills quaternion and attitude of the row by the onboard filter, after `sensors.step`.

    Interrupts that never became a tick and packets that are missing are made up for with the last rates. After ANEW_TICKS of them (the motors
    are off by then) the filter starts anew, and with it the heading, as the DMP does. The wheels' velocity counts while the robot balances.

    Args:
        p, s: the sensors' parameters and state.
        pa: record of PARAMETERS.
        sa: record of STATE.
        rolling: (3,) rates of what rolls on the ground, rad/s, body axes.
        limits: what `sensors.step` returned.
    """
    f = sa.filter
    y = sa.measured
    carried = pa.carried
    calibrated = False
    for i in range(3):
        calibrated = calibrated or row.gyro_bias_rad_s[i] != sa.gyro_bias_rad_s[i]
        sa.gyro_bias_rad_s[i] = row.gyro_bias_rad_s[i]
    if calibrated and f.started == 1:
        attitude.forget_bias(f)
    lost = int(math.floor((row.edge_ns - sa.edge_ns) * 1e-9 * p.rate_hz + 0.5)) - 1 if sa.edge_ns > 0 else 0
    sa.edge_ns = row.edge_ns
    if limits & frame.LIMIT_IMU_MISSING:
        lost += 1
    sa.gap = sa.gap + lost if lost > 0 else 0
    if sa.gap > ANEW_TICKS:
        f.started = 0
    elif f.started == 1:
        for _ in range(lost):
            attitude.step(carried, f, sa.rate, y, 0)
    if not limits & frame.LIMIT_IMU_MISSING:
        for i in range(3):
            sa.rate[i] = s.gyro_rad_s[i]
            y[i] = -s.acceleration_m_s2[i]
        valid = attitude.GYRO_VALID | attitude.ACCELEROMETER_VALID
        if not row.request & frame.REQUEST_ENGAGED:
            y[3] = 0.0
            y[4] = 0.0
            attitude.step(carried, f, sa.rate, y, attitude.ALL_VALID)
        else:
            if not limits & frame.LIMIT_ENCODER_JUMP:
                valid |= attitude.VELOCITY_VALID
                _known_velocity(p, s, f.quaternion, rolling, y)
            attitude.step(pa.rolling, f, sa.rate, y, valid)
        if f.filter.status & ekf.UNHEALTHY:
            f.started = 0
    if f.started == 1:
        sensors.show_attitude(s, f.quaternion[0], f.quaternion[1], f.quaternion[2], f.quaternion[3])
    for i in range(4):
        row.quaternion[i] = s.quaternion[i]
    for i in range(3):
        row.attitude_rad[i] = s.attitude_rad[i]
