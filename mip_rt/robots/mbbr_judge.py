"""How the MBBR's rows compare with the simulated truth, for the summary of a dry run."""

import numpy as np


class Judge:
    """Errors of estimates and of position.

    Args:
        config: loaded configuration.
    """

    def __init__(self, config):
        self._radius_m = config.model.ball_radius_m
        self._origin = None

    @staticmethod
    def estimated_tilt(rows):
        """(n,) lean by the estimator in control."""
        return np.hypot(*rows["estimates"][:, 0, :2].T)

    @staticmethod
    def tilt(truth):
        """(n,) true lean."""
        return np.hypot(truth["roll_rad"], truth["pitch_rad"])

    @staticmethod
    def squared_errors(estimates, truth):
        """(n, estimators) squared errors of tilt and of ball rate, per axis.

        Ball rates are compared in the yaw-rotated frame of the filters, with the true yaw: yaw drift is not a rate error.
        """
        tilt = (estimates[:, :, 0] - truth["roll_rad"][:, None]) ** 2
        tilt += (estimates[:, :, 1] - truth["pitch_rad"][:, None]) ** 2
        cosine, sine = np.cos(truth["yaw_rad"]), np.sin(truth["yaw_rad"])
        rate_x = cosine * truth["ball_rate_x_rad_s"] + sine * truth["ball_rate_y_rad_s"]
        rate_y = -sine * truth["ball_rate_x_rad_s"] + cosine * truth["ball_rate_y_rad_s"]
        rate = (estimates[:, :, 6] - rate_x[:, None]) ** 2 + (estimates[:, :, 7] - rate_y[:, None]) ** 2
        return tilt / 2.0, rate / 2.0

    def position_error(self, rows, truth):
        """(n,) distance from the reference position, from where both were in the first row ever judged."""
        wanted_x = self._radius_m * rows["reference_angle_rad"][:, 1]
        wanted_y = -self._radius_m * rows["reference_angle_rad"][:, 0]
        if self._origin is None:
            self._origin = (truth["x_m"][0] - wanted_x[0], truth["y_m"][0] - wanted_y[0])
        return np.hypot(truth["x_m"] - wanted_x - self._origin[0], truth["y_m"] - wanted_y - self._origin[1])
