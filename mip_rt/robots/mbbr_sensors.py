"""The MBBR's sensors in SI units: those of `robots.sensors`, and the ball angle that its three wheels see."""

import numpy as np

from mip_rt.compiled import njit
from mip_rt.robots import onboard, sensors

WHEELS = 3

PARAMETERS = np.dtype([*sensors.parameter_fields(WHEELS), ("body_from_wheel", "f8", (3, 3)), ("wheel_ratio", "f8")], align=True)
STATE = np.dtype([*sensors.state_fields(WHEELS), ("rolling_rad_s", "f8", (3,))], align=True)


@njit
def step(p, s, pa, sa, row):
    """Reads the row's raw sensors; pa, sa: see `onboard.step`; returns the bits of frame.LIMITS that apply."""
    limits = sensors.step(p, s, row)
    for j in range(3):
        total = 0.0
        for i in range(3):
            total += p.body_from_wheel[j, i] * row.wheel_angle_rad[i]
        row.body_angle_rad[j] = p.wheel_ratio * total
    if p.source == sensors.ONBOARD:
        for j in range(3):
            rate = 0.0
            for i in range(3):
                rate += p.body_from_wheel[j, i] * row.wheel_rate_rad_s[i]
            s.rolling_rad_s[j] = p.wheel_ratio * rate + row.gyro_rad_s[j]
        onboard.step(p, s, pa, sa, row, s.rolling_rad_s, limits)
    return limits
