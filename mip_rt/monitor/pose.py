"""How a robot stands and where: what a drawing needs, from the estimator in control. Axes of the drawing: x forward, y left, z up."""

import math

import numpy as np

LONGEST_STEP_M = 0.05  # a wheel cannot go further in a tick: the estimator was reset


def number(value, digits: int = 5):
    """A number for JSON, rounded; None where it is not finite, for which JSON has no word."""
    value = float(value)
    return round(value, digits) if math.isfinite(value) else None


def of_robot(header: dict, config: dict):
    """The Pose that suits the numbers which a run's estimators give."""
    names = header["estimate_names"]
    kind = OnBall if "ball_angle_x_rad" in names else OnWheels if "phi_rad" in names else Pose
    return kind(list(names), config)


class Pose:
    """A robot of which only the DMP's attitude is known.

    Args:
        names: of the numbers in a row of `estimates`.
        config: the run's configuration as plain dictionaries.
    """

    def __init__(self, names: list[str], config: dict):
        self._names, self._model = names, config.get("model", {})

    def estimate(self, rows, name: str):
        """A number of the estimator in control, of one row or many."""
        return rows["estimates"][..., 0, self._names.index(name)]

    def angles(self, rows):
        """Roll, pitch and yaw of rows or of one row, rad."""
        return tuple(rows["attitude_rad"][..., i] for i in range(3))

    def tilt_rad(self, rows):
        """Angle between the robot and upright."""
        roll, pitch, _ = self.angles(rows)
        return np.hypot(roll, pitch)

    def follow(self, rows) -> None:
        """Takes in rows in order, for what must be summed up."""

    def show(self, row) -> dict:
        """What is drawn of a row."""
        return {
            "attitude_rad": [number(angle) for angle in self.angles(row)],
            "wheel_angle_rad": [number(angle) for angle in row["wheel_angle_rad"]],
        }


class OnBall(Pose):
    """The ball-balancing robot: the ball's angles tell the place."""

    def angles(self, rows):
        """Roll, pitch and yaw."""
        return tuple(self.estimate(rows, f"{name}_rad") for name in ("roll", "pitch", "yaw"))

    def show(self, row) -> dict:
        """Attitude, ball and place."""
        angle_x, angle_y = (self.estimate(row, f"ball_angle_{axis}_rad") for axis in "xy")
        radius_m = self._model["ball_radius_m"]
        return {
            **super().show(row),
            "ball_angle_rad": [number(angle_x), number(angle_y)],
            "position_m": [number(radius_m * angle_y), number(-radius_m * angle_x)],
        }


class OnWheels(Pose):
    """A robot on two wheels, whose body axes are left, back, up: it leans about its axle only, and its place is the sum of its ways."""

    def __init__(self, names, config):
        super().__init__(names, config)
        self._last = None  # way along the ground and heading of the newest row
        self._place_m = np.zeros(2)

    def angles(self, rows):
        """No roll; pitch and yaw."""
        pitch = self.estimate(rows, "pitch_rad")
        return np.zeros_like(pitch), pitch, self.estimate(rows, "yaw_rad")

    def follow(self, rows) -> None:
        """Sums up the way in the direction of the heading."""
        _, pitch, yaw = self.angles(rows)
        way_m = self._model["wheel_radius_m"] * (self.estimate(rows, "phi_rad") + pitch)
        before_m, before_rad = self._last or (way_m[0], yaw[0])
        step_m = np.diff(way_m, prepend=before_m)
        step_m[~(np.abs(step_m) < LONGEST_STEP_M)] = 0.0
        middle = yaw - 0.5 * np.diff(yaw, prepend=before_rad)
        self._place_m += (np.nansum(step_m * np.cos(middle)), np.nansum(step_m * np.sin(middle)))
        self._last = way_m[-1], yaw[-1]

    def show(self, row) -> dict:
        """Attitude and place since the monitor looks."""
        return {**super().show(row), "position_m": [number(x) for x in self._place_m]}
