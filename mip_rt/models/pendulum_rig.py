"""An inverted pendulum on a fixed pivot, swayed by hand, with an IMU at a distance from the pivot: the rig of Aoyagi and Choi.

Nothing is driven: the hand imposes the angle. What matters are the sensors: rate, transverse and radial specific force at the lever
arm, late, offset, noisy and saturated as those of the rig were.

Source: Aoyagi and Choi (2018), (1), sections 2.3 and 3.
"""

from dataclasses import dataclass

import numpy as np

LEVER_M = 0.5
GRAVITY_M_S2 = 9.816
DT_S = 0.01
FAST_S = 82.5  # Fig. 4 shows the onset of 4 Hz from 82.4 to 83.4 s


@dataclass(frozen=True)
class Sensor:
    """An IMU as it appeared on the rig.

    Attributes:
        lag_s: delay of the raw signals (Fig. 4).
        tilt_offset_rad: constant error of the accelerometer's tilt (0.5 to 1 deg, and 2.5 deg after the calibration of the other one).
        gyro_bias_rad_s: drift of the integrated gyro in Fig. 2.
        force_limit_m_s2: full scale; +-2 g was the default.
        gyro_noise_rad_s, force_noise_m_s2: standard deviation a sample, the square roots of the paper's R.
    """

    lag_s: float
    tilt_offset_rad: float
    gyro_bias_rad_s: float
    force_limit_m_s2: float
    gyro_noise_rad_s: float = 2e-6**0.5
    force_noise_m_s2: float = 1e-3**0.5


SENSORS = {
    "BNO055": Sensor(0.05, np.radians(2.5), np.radians(0.15), 4.0 * GRAVITY_M_S2),
    "MPU-9250": Sensor(0.02, np.radians(0.5), np.radians(0.02), 2.0 * GRAVITY_M_S2),
}


def output(angle, rate, acceleration, lever_m: float = LEVER_M, gravity_m_s2: float = GRAVITY_M_S2):
    """(rate, transverse, radial specific force) at the IMU, (1); arrays or numbers."""
    return rate, gravity_m_s2 * np.sin(angle) - lever_m * acceleration, gravity_m_s2 * np.cos(angle) - lever_m * np.square(rate)


def hand(wanted, dt_s: float, corner_rad_s: float = 40.0):
    """(angle, rate, acceleration) of a pendulum that follows `wanted` (n,) like a critically damped spring: a hand has no steps."""
    angle, rate, acceleration = np.zeros((3, len(wanted)))
    a = v = 0.0
    for k, target in enumerate(wanted):
        force = corner_rad_s**2 * (target - a) - 2.0 * corner_rad_s * v
        angle[k], rate[k], acceleration[k] = a, v, force
        v += dt_s * force
        a += dt_s * v
    return angle, rate, acceleration


def protocol(time_s):
    """(n,) angle that the hand wants, rad: rest to 20 s, sweeps of 20 deg to 60 s, swaying at 2 Hz from 60 s and at 4 Hz from 82.5 s, steps from 90 to 120 s.

    The paper's pattern (Fig. 2); the amplitudes of the swaying (10 and 5 deg) are ours, read from the text's limits.
    """
    t = np.asarray(time_s, float)
    degrees = np.zeros_like(t)
    sweep, sway, fast, steps = (t >= 20) & (t < 60), (t >= 60) & (t < 80), (t >= FAST_S) & (t < 90), (t >= 90) & (t < 120)
    degrees[sweep] = 20.0 * np.sin(2 * np.pi * 0.2 * (t[sweep] - 20))
    degrees[sway] = 10.0 * np.sin(2 * np.pi * 2.0 * (t[sway] - 60))
    degrees[fast] = 5.0 * np.sin(2 * np.pi * 4.0 * (t[fast] - FAST_S))
    degrees[steps] = np.array([0.0, 15.0, 0.0, -15.0])[((t[steps] - 90) / 2.5).astype(int) % 4]
    return np.radians(degrees)


def measure(sensor: Sensor, time_s, angle, rate, acceleration, random, sample_s: float = DT_S):
    """(samples,) times, (samples, 3) what the IMU reports of a motion given on a finer grid (n,): late, crooked, biased, noisy, saturated."""
    times = np.arange(time_s[0], time_s[-1], sample_s)
    late = [np.interp(times - sensor.lag_s, time_s, signal) for signal in output(angle, rate, acceleration)]
    turn = sensor.tilt_offset_rad
    transverse = np.cos(turn) * late[1] + np.sin(turn) * late[2]
    radial = np.cos(turn) * late[2] - np.sin(turn) * late[1]
    y = np.stack([late[0] + sensor.gyro_bias_rad_s, transverse, radial], axis=1)
    y += random.normal(size=y.shape) * [sensor.gyro_noise_rad_s, sensor.force_noise_m_s2, sensor.force_noise_m_s2]
    y[:, 1:] = np.clip(y[:, 1:], -sensor.force_limit_m_s2, sensor.force_limit_m_s2)
    return times, y
