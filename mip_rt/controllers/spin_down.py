"""Losing balance while spinning: the spin is taken away until the robot is calm.

A spinning ball-balancing robot that is pushed spirals outwards, and the faster it spins the less its controller can do. So where the
lean, the ball's angle or its speed is far from its reference, the spin command is zero and the gains are those of standing, until all three are
small again. The idea is the robot author's; the errors here are norms, and a number that is not finite counts as too large.
"""

import numpy as np

from mip_rt.compiled import njit

PARAMETERS = np.dtype(
    [
        ("enter_squared", "f8", (3,)),  # lean (rad), ball angle (rad), ball speed (rad/s), squared
        ("leave_squared", "f8", (3,)),
    ],
    align=True,
)
STATE = np.dtype([("active", "i8")], align=True)


def configure(p, enter, leave) -> None:
    """Derives the constants, once: errors of lean, ball angle, ball speed at which it begins and ends."""
    p.enter_squared[:] = [value * value for value in enter]
    p.leave_squared[:] = [value * value for value in leave]


@njit
def step(p, s, spinning, error):
    """One tick; returns True while the spin must be taken away.

    Args:
        spinning: the robot spins or is told to.
        error: (10,) see state_feedback.step.
    """
    lean = error[0] * error[0] + error[1] * error[1]
    angle = error[3] * error[3] + error[4] * error[4]
    speed = error[8] * error[8] + error[9] * error[9]
    if s.active:
        if lean < p.leave_squared[0] and angle < p.leave_squared[1] and speed < p.leave_squared[2]:
            s.active = 0
    elif spinning and not (lean <= p.enter_squared[0] and angle <= p.enter_squared[1] and speed <= p.enter_squared[2]):
        s.active = 1
    return s.active == 1
