"""The MBBR linearised upright at zero yaw rate: the model of the 8-state Kalman filter.

Source: dissertation (5.28), (5.29), with the coefficients of section I.3 of the corrected equations.
"""

import numpy as np

from mip_rt.models.mbbr_yaw import coefficients

STATE_NAMES = ("roll", "pitch", "phi_x", "phi_y", "roll_rate", "pitch_rate", "w_x", "w_y")


def linear_matrices(p):
    """A (8, 8), B (8, 2), C (6, 8), D (6, 2) of x' = A x + B u, y = C x + D u.

    x as STATE_NAMES, u = [u_x, u_y]; y = [gyro x, gyro y, encoder x, encoder y, accelerometer x, accelerometer y] in the papers'
    sign. p: record of models.mbbr.PARAMETERS.
    """
    c = coefficients(p, "exact")[0]
    A, B, C, D = np.zeros((8, 8)), np.zeros((8, 2)), np.zeros((6, 8)), np.zeros((6, 2))
    for axis, (tilt, ball, accel) in enumerate(((c.tilt_x, c.ball_x, c.accel_x), (c.tilt_y, c.ball_y, c.accel_y))):
        A[axis, 4 + axis] = A[2 + axis, 6 + axis] = 1.0
        for row, terms in ((4 + axis, tilt), (6 + axis, ball)):
            A[row, axis], A[row, 4 + axis], A[row, 6 + axis] = terms[0], terms[1], -terms[1]
            B[row, axis] = terms[2]
        C[axis, 4 + axis] = 1.0
        C[2 + axis, axis], C[2 + axis, 2 + axis] = -1.0, 1.0
        output = 5 - axis  # a1 hangs on pitch, a2 on roll
        C[output, axis], C[output, 4 + axis], C[output, 6 + axis] = accel[0], accel[1], -accel[1]
        D[output, axis] = accel[2]
    return A, B, C, D
