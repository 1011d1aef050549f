"""What filters and wheel drive say of a tick, as bits of frame.limits."""

from mip_rt import frame
from mip_rt.compiled import njit
from mip_rt.controllers import wheel_drive
from mip_rt.estimators import ekf


@njit
def of_filter(flags):
    """From the status of the filter in control."""
    limits = 0
    if flags & (ekf.REJECTED | ekf.REACCEPTED):
        limits |= frame.LIMIT_INNOVATION_REJECTED
    if flags & ekf.NOT_FINITE:
        limits |= frame.LIMIT_NOT_FINITE
    if flags & ekf.UNHEALTHY:
        limits |= frame.LIMIT_ESTIMATOR_RESET
    if flags & ekf.BOUNDED:
        limits |= frame.LIMIT_COVARIANCE_BOUNDED
    return limits


@njit
def of_drive(bits):
    """From what the wheel drive returns."""
    limits = 0
    if bits & wheel_drive.CLIPPED:
        limits |= frame.LIMIT_WHEEL_SATURATED
    if bits & wheel_drive.CURRENT_SATURATED:
        limits |= frame.LIMIT_COAST_SATURATED
    if bits & wheel_drive.NOT_FINITE:
        limits |= frame.LIMIT_DUTY_REFUSED | frame.LIMIT_NOT_FINITE
    return limits
