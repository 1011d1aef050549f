"""The eduMIP's sensors in SI units: those of `robots.sensors`, the board's mounting angle, and what two encoders say of place and heading.

The quaternion in the frame stays the board's, as the DMP gives it; `attitude_rad` is the body's.
"""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.estimators.complementary import accelerometer_tilt
from mip_rt.robots import onboard, sensors

WHEELS = 2

PARAMETERS = np.dtype(
    [
        *sensors.parameter_fields(WHEELS),
        ("mount_angle_rad", "f8"),  # added to the DMP's lean; accelerometer and gyro have it in `mounting`
        ("radius_by_track", "f8"),  # r / d
    ],
    align=True,
)
STATE = np.dtype([*sensors.state_fields(WHEELS), ("rolling_rad_s", "f8", (3,))], align=True)


@njit
def step(p, s, pa, sa, row):
    """Reads the row's raw sensors; pa, sa: see `onboard.step`; returns the bits of frame.LIMITS that apply."""
    limits = sensors.step(p, s, row)
    if p.source == sensors.ONBOARD:
        s.rolling_rad_s[0] = 0.5 * (row.wheel_rate_rad_s[0] + row.wheel_rate_rad_s[1]) + row.gyro_rad_s[0]
        onboard.step(p, s, pa, sa, row, s.rolling_rad_s, limits)
    else:
        # R = Rz Ry Rx(lean): a turn of the board about the axle only adds to the lean.
        row.attitude_rad[0] += p.mount_angle_rad
    row.phi_rad = 0.5 * (row.wheel_angle_rad[0] + row.wheel_angle_rad[1])
    row.encoder_yaw_rad = p.radius_by_track * (row.wheel_angle_rad[0] - row.wheel_angle_rad[1])
    row.accelerometer_tilt_rad = accelerometer_tilt(row.acceleration_m_s2[1], row.acceleration_m_s2[2])
    return limits
