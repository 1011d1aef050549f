"""The battery's voltage that commands are scaled with, in every robot's compiled step."""

import math

from mip_rt import frame
from mip_rt.compiled import njit


@njit
def step(p, s, row):
    """The smoothed reading, the last good one for 2 s, then nominal, into s.battery_v; returns limit bits.

    Args:
        p: parameters of a robot: battery_pole, battery_hold_ticks, nominal_voltage_v.
        s: its state: battery_v, battery_unknown.
    """
    reading = row.battery_v
    if reading > 0.0 and reading < math.inf:
        s.battery_v += (1.0 - p.battery_pole) * (reading - s.battery_v)
        s.battery_unknown = 0
        return 0
    s.battery_unknown += 1
    if s.battery_unknown >= p.battery_hold_ticks:
        s.battery_v = p.nominal_voltage_v
    return frame.LIMIT_BATTERY_UNKNOWN


@njit
def rest(p, s, row):
    """The same without control: the reading as it is, or nominal; returns limit bits."""
    if row.battery_v > 0.0 and row.battery_v < math.inf:
        s.battery_v = row.battery_v
        s.battery_unknown = 0
        return 0
    s.battery_v = p.nominal_voltage_v
    s.battery_unknown = p.battery_hold_ticks
    return frame.LIMIT_BATTERY_UNKNOWN
