"""A brushed motor behind a PWM bridge: average current with drive/brake and drive/coast, and the inverse.

Per unit: current in units of the stall current i_s = V/R, speed omega_r = k omega / V, period T_r = T_pwm R / L, diode drop
delta = 2 V_d / V. Drive/coast lets the current die in the diodes, so that the average current is not linear in the duty; the
inverse finds the duty that carries a wanted current.

Source: dissertation (4.1) to (4.36); the domains beyond |omega_r| <= 1 and the bracketed inverse are those of section I.5 of the
corrected equations (the printed step 3 of section 4.4 runs away from targets that cannot be reached).
"""

import math

from mip_rt.compiled import njit

TOLERANCE = 1e-12
ITERATIONS = 50


@njit
def _decay(t):
    """1 - exp(-t)."""
    return -math.expm1(-t)


@njit
def _border(a, b, t_r):
    """v_b: the duty above which the current no longer dies within a period, (4.27), written so that it cannot overflow."""
    if t_r > 1e-4:
        return 1.0 + math.log((b + a * math.exp(-t_r)) / (a + b)) / t_r
    share = a / (a + b)  # series for a period that is short against L/R
    return 1.0 - share + 0.5 * share * (1.0 - share) * t_r


@njit
def _core(v, a, b, t_r):
    """Average current at duty v for a > 0, b > 0."""
    border = _border(a, b, t_r)
    if v > border:
        return v * a - (1.0 - v) * b
    if t_r > 1e-4:
        return v * a - b / t_r * math.log1p(a * _decay(v * t_r) / b)
    return 0.5 * a * (a + b) * t_r * v * v / b


@njit
def coast_current(u, omega_r, t_r, delta=0.0):
    """Average current i / i_s of a drive/coast bridge at signed duty u, |u| <= 1.

    Args:
        u: signed duty.
        omega_r: speed over no-load speed, any finite number.
        t_r: PWM period over the electrical time constant, positive.
        delta: voltage of both diodes over the supply voltage.
    """
    v = abs(u)
    if v == 0.0:
        excess = abs(omega_r) - 1.0 - delta
        if not excess > 0.0:
            return 0.0 * omega_r
        return -excess if omega_r > 0.0 else excess
    sign = 1.0 if u > 0.0 else -1.0
    speed = sign * omega_r
    a = 1.0 - speed
    b = 1.0 + delta + speed
    if b <= 0.0:
        return sign * (v * a - (1.0 - v) * b)
    if a <= 0.0:
        if speed <= 1.0 + delta:
            rest = 1.0 + delta - speed
            if rest <= 0.0 or a == 0.0:
                return sign * v * a
            return -sign * _core(v, -a, rest, t_r)
        return -sign * (-v * a + (1.0 - v) * (speed - 1.0 - delta))
    return sign * _core(v, a, b, t_r)


@njit
def coast_inverse(current, omega_r, t_r, delta=0.0):
    """Signed duty that carries `current` (in units of i_s), and whether the target is out of reach (the duty is then the nearest).

    Newton's method inside a bracket: the curve is increasing and convex up to the border, so that it converges from any start; near
    zero current, where the slope vanishes, the square-root start is already exact to first order.
    """
    if current != current or omega_r != omega_r:
        return current + omega_r, False
    target = abs(current)
    if target == 0.0:
        return 0.0, False
    sign = 1.0 if current > 0.0 else -1.0
    speed = sign * omega_r
    a = 1.0 - speed
    b = 1.0 + delta + speed
    if a <= 0.0:
        return 0.0, True  # only braking current can flow at this speed: coast
    if target >= a:
        return sign, target > a
    if b <= 0.0:
        return sign * max(0.0, (target + b) / (a + b)), target + b < 0.0
    border = _border(a, b, t_r)
    at_border = border * a - (1.0 - border) * b
    if target >= at_border:
        return sign * (target + b) / (a + b), False
    if t_r <= 1e-4:
        return sign * math.sqrt(2.0 * b * target / (a * (a + b) * t_r)), False
    low = 0.0
    high = border
    v = border * math.sqrt(target / at_border)
    for _ in range(ITERATIONS):
        gone = _decay(v * t_r)
        error = v * a - b / t_r * math.log1p(a * gone / b) - target
        if abs(error) <= TOLERANCE * target:
            break
        if error > 0.0:
            high = v
        else:
            low = v
        slope = a * (a + b) * gone / (b + a * gone)
        step = error / slope
        v -= step
        if not low < v < high:
            v = 0.5 * (low + high)
        if abs(step) <= 1e-15:
            break
    return sign * v, False


@njit
def coast_command(current, omega_r, t_r, delta=0.0):
    """The duty of `coast_inverse` alone."""
    return coast_inverse(current, omega_r, t_r, delta)[0]


@njit
def brake_current(u, omega_r):
    """Average current i / i_s of a drive/brake bridge: linear."""
    return u - omega_r


@njit
def brake_command(current, omega_r):
    """Signed duty of a drive/brake bridge for a current, and whether it is out of reach (then clipped)."""
    u = current + omega_r
    if u > 1.0:
        return 1.0, True
    if u < -1.0:
        return -1.0, True
    return u, False
