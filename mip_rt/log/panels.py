"""The panels of a page: chosen fields, or those that answer why a robot fell. What only one robot has is taken where the log has its fields."""

import math

import numpy as np

from mip_rt.log import events
from mip_rt.log.columns import estimators, pick_groups
from mip_rt.log.configuration import as_dict, flatten
from mip_rt.log.page import BLACK, BLUE, GREEN, GREY, ORANGE, PALE, SERIES, Line, Panel

DEGREES = 180.0 / math.pi
TURNS = 0.5 / math.pi


def chosen(header: dict, frames, fields: str) -> list[Panel]:
    """One panel for each group of fields."""
    found = []
    for group in pick_groups(header, fields):
        joined = len({c.field for c in group}) > 1  # lines that may coincide: the first is drawn broadly, so that it shows
        lines = [Line(c.name, _finite(c.of(frames)), SERIES[i % len(SERIES)], "solid", 2.8 if joined and not i else 1.2)
                 for i, c in enumerate(group) if not c.is_bytes]  # fmt: skip
        title = " + ".join(dict.fromkeys(c.field for c in group))
        found.append(Panel(title, ", ".join(dict.fromkeys(c.unit for c in group)), lines))
    return found


def standard(log, frames) -> list[list[Panel]]:
    """The two columns of the page: how the robot moved, and what was asked of its motors."""
    names = log.header.get("estimate_names", [])
    kind = _OnBall if "ball_rate_x_rad_s" in names else _OnWheels if "phi_rad" in names else _View
    view = kind(log, frames)
    left = [*view.tilt(), view.yaw_rate(), *view.position(), view.speed(), view.latency()]
    right = [*view.commands(), *view.wheel_commands(), view.duty(), view.wheel_rate(), view.battery()]
    return [[panel for panel in column if panel is not None and panel.lines] for column in (left, right)]


class _View:
    """Rows of one log, and the panels that every robot has."""

    def __init__(self, log, frames):
        self.frames, self.names = frames, frames.dtype.names
        self.estimate_names = list(log.header.get("estimate_names", []))
        self.estimators = estimators(log.header) or ["estimator"]
        self.config = flatten(as_dict(log.config))

    def field(self, name: str, index: int | None = None, factor: float = 1.0):
        """(n,) a scalar field, or one element of another; None where the log has no such field."""
        if name not in self.names:
            return None
        values = self.frames[name]
        return _finite((values if index is None else values[:, index]) * factor)

    def estimate(self, name: str, slot: int = 0, factor: float = 1.0):
        """(n,) one number of one estimator."""
        return _finite(self.frames["estimates"][:, slot, self.estimate_names.index(name)] * factor)

    def estimate_lines(self, name: str, factor: float) -> list[Line]:
        """The estimator in control strongly, shadows thinly below it; nothing where estimates have no such number."""
        if name not in self.estimate_names:
            return []
        shadows = [Line(e, self.estimate(name, i, factor), SERIES[1 + (i - 1) % 4], "solid", 0.9)
                   for i, e in enumerate(self.estimators) if i]  # fmt: skip
        return [*shadows, Line(self.estimators[0], self.estimate(name, 0, factor), BLUE, "solid", 1.8)]

    @staticmethod
    def with_reference(lines: list, values) -> list[Line]:
        """The lines, and a reference above them where there is one."""
        return lines if values is None else [*lines, Line("reference", values, BLACK, "dash", 1.1)]

    def tilt_panel(self, title: str, attitude: int, estimate: str, reference=None) -> Panel:
        """The angle of imu.attitude, the estimators' and the reference."""
        tip = self.config.get("limits.tip_rad")
        estimates = self.estimate_lines(estimate, DEGREES)
        look = (PALE, "solid", 3.6) if estimates else (GREY, "solid", 1.3)  # broad where others lie upon it
        lines = [Line("attitude", self.field("attitude_rad", attitude, DEGREES), *look), *estimates]
        return Panel(title, "deg", self.with_reference(lines, reference), () if tip is None else (-tip * DEGREES, tip * DEGREES))

    def tilt(self) -> list[Panel]:
        """Roll and pitch."""
        return [self.tilt_panel("roll", 0, "roll_rad"), self.tilt_panel("pitch", 1, "pitch_rad")]

    def yaw_rate(self) -> Panel:
        """Gyro, estimator in control, reference."""
        lines = [Line("gyro", self.field("gyro_rad_s", 2, TURNS), PALE, "solid", 3.6)]
        if "yaw_rate_rad_s" in self.estimate_names:
            lines.append(Line(self.estimators[0], self.estimate("yaw_rate_rad_s", 0, TURNS), BLUE, "solid", 1.5))
        return Panel("yaw rate", "turns/s", self.with_reference(lines, self.field("reference_yaw_rad", 1, TURNS)))

    def position(self) -> list[Panel]:
        """Place over the ground, for robots that know theirs."""
        return []

    def speed_lines(self) -> list[Line]:
        """Speed over the ground, likewise."""
        return []

    def speed(self) -> Panel:
        """What the remote asks, and what became of it."""
        return Panel("ground speed", "m/s", [Line("remote", self.remote_speed(), GREY, "dot", 1.4), *self.speed_lines()])

    def remote_speed(self):
        """(n,) magnitude of the remote's command."""
        return _finite(np.hypot(*self.frames["remote_velocity_m_s"].T))

    def latency(self) -> Panel | None:
        """None on virtual time."""
        stages = events.stage_ns(self.frames)
        if not stages["edge_to_write"].any():
            return None
        lines = [Line("edge to write", stages["edge_to_write"] / 1e6, BLUE), Line("wake", stages["wake"] / 1e6, ORANGE)]
        return Panel("latency", "ms", lines)

    axes = ()  # names of the body commands
    friction_by_wheel = False

    def commands(self) -> list[Panel]:
        """One panel a body axis: what each stage makes of the command."""
        if "command_feedback" not in self.names:
            return []
        found = []
        for i in range(self.frames["command_feedback"].shape[1]):
            lines = [Line("feedback", self.field("command_feedback", i), BLUE, "solid", 1.5)]
            if "command_friction" in self.names and not self.friction_by_wheel:
                lines.append(Line("friction", self.field("command_friction", i), ORANGE))
            if "command_applied" in self.names:
                lines.append(Line("applied", self.field("command_applied", i), BLACK, "dash", 1.1))
            found.append(Panel(f"body command {self.axes[i] if i < len(self.axes) else i + 1}", "of full voltage", lines))
        return found

    def wheel_commands(self) -> list[Panel]:
        """What is added by wheel, for robots whose friction is compensated there."""
        return []

    wheels = ()  # names of the wheels

    def wheel_lines(self, name: str) -> list[Line]:
        """One line a wheel of a field; of two, which often coincide, the first is broad."""
        if name not in self.names:
            return []
        count = self.frames[name].shape[1]
        names = self.wheels if len(self.wheels) == count else [f"wheel {i + 1}" for i in range(count)]
        return [Line(names[i], self.field(name, i), SERIES[i], "solid", 2.8 if count == 2 and not i else 1.2) for i in range(count)]

    def duty(self) -> Panel:
        """Duty by wheel, with its limit."""
        limit = self.config.get("limits.duty")
        return Panel("duty", "of the period", self.wheel_lines("duty"), () if limit is None else (-limit, limit))

    def wheel_rate(self) -> Panel:
        """Wheels relative to the body."""
        return Panel("wheel rate", "rad/s", self.wheel_lines("wheel_rate_rad_s"))

    def battery(self) -> Panel:
        """Voltage, with the least with which the robot is armed."""
        low = self.config.get("battery.minimum_v")
        return Panel("battery", "V", [Line("battery", self.field("battery_v"), GREEN, "solid", 1.5)], () if low is None else (low,))


class _OnBall(_View):
    """The MBBR. Estimates have the ball's rates in the yaw-rotated frame, and its inertial angles: place p = r (angle_y, -angle_x)."""

    axes = "xyz"

    def __init__(self, log, frames):
        super().__init__(log, frames)
        self.radius_m = self.config.get("model.ball_radius_m", math.nan)

    def tilt(self) -> list[Panel]:
        """Roll and pitch, with the outer loop's lean."""
        return [self.tilt_panel(name, i, f"{name}_rad", self.field("reference_lean_rad", i, DEGREES)) for i, name in enumerate(("roll", "pitch"))]

    def position(self) -> list[Panel]:
        """Of the ball, inertial."""
        lines = []
        for axis, name, index, sign, colour in (("x", "ball_angle_y_rad", 1, 1.0, BLUE), ("y", "ball_angle_x_rad", 0, -1.0, ORANGE)):
            factor = 100.0 * sign * self.radius_m
            lines.append(Line(axis, self.estimate(name, 0, factor), colour, "solid", 1.5))
            reference = self.field("reference_angle_rad", index, factor)
            if reference is not None:
                lines.append(Line(f"{axis} reference", reference, colour, "dash", 1.0))
        return [Panel("position", "cm", lines)]

    def speed_lines(self) -> list[Line]:
        """Magnitudes: they are the same in every frame."""
        rate = np.hypot(self.estimate("ball_rate_x_rad_s"), self.estimate("ball_rate_y_rad_s"))
        reference = None
        if "reference_velocity_rad_s" in self.names:
            reference = _finite(np.hypot(*self.frames["reference_velocity_rad_s"].T) * self.radius_m)
        return self.with_reference([Line(self.estimators[0], rate * self.radius_m, BLUE, "solid", 1.5)], reference)


class _OnWheels(_View):
    """The eduMIP. `attitude_rad` begins with the lean about the axle; place is r (phi + pitch)."""

    axes = ("x (forward)", "z (left)")
    wheels = ("right wheel", "left wheel")
    friction_by_wheel = True

    def __init__(self, log, frames):
        super().__init__(log, frames)
        self.radius_m = self.config.get("model.wheel_radius_m", math.nan)

    def tilt(self) -> list[Panel]:
        """Lean about the axle with its reference, and what a robot on two wheels should not have."""
        lean = self.tilt_panel("lean, forward", 0, "pitch_rad", self.field("reference_lean_rad", None, DEGREES))
        return [lean, self.tilt_panel("tilt, sideways", 1, "")]

    def rolled(self, suffix: str, factor: float):
        """(n,) phi + pitch of the estimator in control, or their rates."""
        return self.estimate(f"phi_{suffix}", 0, factor) + self.estimate(f"pitch_{suffix}", 0, factor)

    def position(self) -> list[Panel]:
        """Way along the path."""
        factor = 100.0 * self.radius_m
        line = Line(self.estimators[0], self.rolled("rad", factor), BLUE, "solid", 1.5)
        return [Panel("way", "cm", self.with_reference([line], self.field("reference_angle_rad", None, factor)))]

    def speed_lines(self) -> list[Line]:
        """Forward speed, signed."""
        line = Line(self.estimators[0], self.rolled("rate_rad_s", self.radius_m), BLUE, "solid", 1.5)
        return self.with_reference([line], self.field("reference_velocity_rad_s", None, self.radius_m))

    def remote_speed(self):
        """Forward only: the robot cannot go sideways."""
        return self.field("remote_velocity_m_s", 0)

    def wheel_commands(self) -> list[Panel]:
        """Friction compensation by wheel."""
        return [Panel("friction compensation", "of full voltage", self.wheel_lines("command_friction"))]


def _finite(values) -> np.ndarray:
    """A copy as floats with NaN for infinities, which no axis can show."""
    values = np.array(values, float)
    values[~np.isfinite(values)] = np.nan
    return values
