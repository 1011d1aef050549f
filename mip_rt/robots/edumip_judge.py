"""How the eduMIP's rows compare with the simulated truth, for the summary of a dry run."""

import numpy as np


class Judge:
    """Errors of estimates and of position.

    Args:
        config: loaded configuration.
    """

    def __init__(self, config):
        self._radius_m = config.model.wheel_radius_m
        self._start_m = None

    @staticmethod
    def estimated_tilt(rows):
        """(n,) lean by the estimator in control."""
        return np.abs(rows["estimates"][:, 0, 0])

    @staticmethod
    def tilt(truth):
        """(n,) true lean."""
        return np.abs(truth["pitch_rad"])

    @staticmethod
    def squared_errors(estimates, truth):
        """(n, estimators) squared errors of lean and of the wheels' rate against the ground."""
        tilt = (estimates[:, :, 0] - truth["pitch_rad"][:, None]) ** 2
        return tilt, (estimates[:, :, 3] + estimates[:, :, 4] - truth["wheel_rate_rad_s"][:, None]) ** 2

    def position_error(self, rows, truth):
        """(n,) distance along the way from the reference, from where both were in the first row ever judged.

        Along the way, because a robot that turns on the spot has its place only there: sideways it cannot move.
        """
        behind = truth["way_m"] - self._radius_m * rows["reference_angle_rad"]
        if self._start_m is None:
            self._start_m = behind[0]
        return np.abs(behind - self._start_m)
