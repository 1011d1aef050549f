"""How far the ball has rolled, from encoders, gyro and attitude alone: position without a model of motors and friction.

Without slip the encoders give the ball's turn relative to the body, phi_B' = E v; adding the body's own turn Omega_B (the gyro) leaves the
ball's: phi_Bx' + Omega_x = cos(pitch) w_x and phi_By' + Omega_y = cos(roll) w_y + sin(roll) sin(pitch) w_x. Increments are exact
whatever the motors do, so this position drifts by gyro bias and yaw error only; the integral of a filter's ball rate (the
dissertation's way) also drifts by every error of its friction and motor model.

Source: dissertation (5.18), (5.19), first two rows of E in section I.2 of the corrected equations.
"""

import math

import numpy as np

from mip_rt.compiled import njit

STATE = np.dtype(
    [
        ("body_angle_rad", "f8", (2,)),  # phi_B x, y of the previous tick
        ("gyro_rad_s", "f8", (2,)),
        ("turn_rad", "f8", (2,)),  # the ball's turn in this tick about the body's x and y axes
    ],
    align=True,
)


@njit
def reset(s, body_angle_rad, gyro_rad_s):
    """Starts from here: nothing has rolled yet."""
    for i in range(2):
        s.body_angle_rad[i] = body_angle_rad[i]
        s.gyro_rad_s[i] = gyro_rad_s[i]
        s.turn_rad[i] = 0.0


@njit
def step(s, body_angle_rad, gyro_rad_s, dt_s):
    """Takes in one tick of encoder ball angle phi_B and gyro (body axes, only x and y are used)."""
    for i in range(2):
        s.turn_rad[i] = body_angle_rad[i] - s.body_angle_rad[i] + 0.5 * dt_s * (gyro_rad_s[i] + s.gyro_rad_s[i])
        s.body_angle_rad[i] = body_angle_rad[i]
        s.gyro_rad_s[i] = gyro_rad_s[i]


@njit
def add(s, roll_rad, pitch_rad, cosine_yaw, sine_yaw, half_turn_rad, ball_angle_rad):
    """Adds this tick's turn to the inertial ball angles (2,), seen with an estimator's attitude.

    Args:
        cosine_yaw, sine_yaw: of the yaw at the end of the tick.
        half_turn_rad: how far the body yaws in half a tick. The turn belongs to the yaw of the middle of the tick: at 1.5 Hz half a tick is
            24 mrad, which would bend every straight line.
    """
    shrink = 1.0 - 0.5 * half_turn_rad * half_turn_rad
    cosine = cosine_yaw * shrink + sine_yaw * half_turn_rad
    sine = sine_yaw * shrink - cosine_yaw * half_turn_rad
    x = s.turn_rad[0] / math.cos(pitch_rad)
    y = (s.turn_rad[1] - math.sin(roll_rad) * math.sin(pitch_rad) * x) / math.cos(roll_rad)
    ball_angle_rad[0] += cosine * x - sine * y
    ball_angle_rad[1] += sine * x + cosine * y
