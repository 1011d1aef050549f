"""What stands on the page of `mip-rt log plot`: panels of lines over time, bands of states and limits, faults, and a verdict in words.

Nothing here draws; `picture` makes a PNG of a page, `interactive` an HTML file. Robot-specific panels exist where the log has their fields.
"""

import math
from typing import NamedTuple

import numpy as np

from mip_rt.log import events
from mip_rt.log.codes import Codes
from mip_rt.log.columns import estimators, pick_groups
from mip_rt.log.configuration import as_dict, flatten

# Okabe and Ito's palette: told apart by colour-blind readers, too.
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILLION, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
)  # fmt: skip
GREY, PALE = "#8C8C8C", "#C4C4C4"
SERIES = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION, GREY, BLACK)
STATE_COLOURS = {
    "BOOT": "#D9D9D9", "CALIBRATING": "#BFBFBF", "DISARMED": "#E8DFC8", "ARMING": YELLOW, "BALANCING": GREEN, "FAULT": VERMILLION,
}  # fmt: skip
AXES = {3: "xyz", 2: "xz"}  # names of body commands by their number
DEGREES = 180.0 / math.pi
SILENCE_TICKS = 5  # a longer gap between rows interrupts the lines


class Line(NamedTuple):
    """One curve: (n,) values over the page's times."""

    label: str
    values: np.ndarray
    colour: str
    style: str = "solid"  # or dash, dot
    width: float = 1.2


class Panel(NamedTuple):
    """One pair of axes. `bounds` are horizontal marks."""

    title: str
    unit: str
    lines: list
    bounds: tuple = ()


class Band(NamedTuple):
    """Spans of time in a row of their own: (begin, end, text, colour)."""

    label: str
    spans: list


class Page(NamedTuple):
    """A whole plot.

    Attributes:
        heading: which log.
        verdict: sentences: the faults in the window, or that there was none.
        times_s: (n,) seconds since the loop's first tick.
        columns: lists of Panels; a column is drawn from top to bottom.
        bands: states first, then one a limit.
        faults: (time, code) in the window.
    """

    heading: str
    verdict: list
    times_s: np.ndarray
    columns: list
    bands: list
    faults: list


def page(log, times_s, mask, fields: str | None = None) -> Page:
    """The page of the rows in `mask`; of chosen fields where these are given (see `columns.pick_groups`).

    Raises:
        LogError: a chosen field is not in the log.
    """
    frames, times = log.frames[mask], times_s[mask]
    codes = Codes(log.header)
    begin, end = times[0], times[-1]
    found = [fault for fault in events.faults(log.frames, times_s, codes) if begin <= fault["time_s"] <= end]
    columns = [chosen(log.header, frames, fields)] if fields else standard(log, frames)
    heading = f"{log.path.name}: {begin:.2f} to {end:.2f} s of {times_s[0]:.2f} to {times_s[-1]:.2f} s; estimator {(estimators(log.header) or ['unknown'])[0]}"
    return Page(heading, verdict(found, frames), times, columns, bands(frames, times, codes), [(fault["time_s"], fault["code"]) for fault in found])


def verdict(faults: list, frames) -> list[str]:
    """One or two sentences a fault."""
    if not faults:
        return ["no fault in this window"]
    sentences = []
    for fault in faults[-2:]:
        sentences.append(f"{fault['code']} at {fault['time_s']:.3f} s (tick {fault['tick']}): {fault['sentence']}")
        before = {name: n for name, n in fault["limits_before"].items() if name != fault["code"]}
        if before:
            sentences.append("in the second before: " + events.in_words(before))
    if len(faults) > 2:
        sentences.append(f"{len(faults) - 2} earlier faults in this window")
    return sentences


# -- panels ------------------------------------------------------------------------------------------------------------
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
    """The two columns of the page that answers why it fell."""
    view = _View(log, frames)
    left = [*view.tilt(), view.yaw_rate(), *view.position(), view.speed(), view.latency()]
    right = [*view.commands(), view.duty(), view.wheel_rate(), view.battery()]
    return [[panel for panel in column if panel is not None and panel.lines] for column in (left, right)]


class _View:
    """Rows of one log with the robot's fields at hand, by name where the log has them."""

    def __init__(self, log, frames):
        self.frames, self.names = frames, frames.dtype.names
        self.estimate_names = list(log.header.get("estimate_names", []))
        self.estimators = estimators(log.header) or ["estimator"]
        self.config = flatten(as_dict(log.config))
        self.radius_m = self.config.get("model.ball_radius_m")

    def estimate(self, name: str, slot: int = 0, factor: float = 1.0):
        """(n,) one number of one estimator; NaN where none was engaged."""
        values = self.frames["estimates"][:, slot, self.estimate_names.index(name)] * factor
        return _finite(values)

    def estimate_lines(self, name: str, factor: float) -> list[Line]:
        """The estimator in control strongly, shadows thinly below it."""
        if name not in self.estimate_names:
            return []
        shadows = [Line(e, self.estimate(name, i, factor), SERIES[1 + (i - 1) % 4], "solid", 0.9)
                   for i, e in enumerate(self.estimators) if i]  # fmt: skip
        return [*shadows, Line(self.estimators[0], self.estimate(name, 0, factor), BLUE, "solid", 1.8)]

    def field(self, name: str, index: int, factor: float = 1.0):
        """(n,) one element of a field, None where the log has no such field."""
        if name not in self.names or self.frames[name].ndim < 2 or index >= self.frames[name].shape[1]:
            return None
        return _finite(self.frames[name][:, index] * factor)

    def with_reference(self, lines: list, name: str, index: int, factor: float) -> list[Line]:
        values = self.field(name, index, factor)
        return lines if values is None else [*lines, Line("reference", values, BLACK, "dash", 1.1)]

    def tilt(self) -> list[Panel]:
        tip = self.config.get("limits.tip_rad")
        bounds = () if tip is None else (-tip * DEGREES, tip * DEGREES)
        found = []
        for index, angle in enumerate(("roll", "pitch")):
            lines = [Line("DMP", self.field("attitude_rad", index, DEGREES), PALE, "solid", 3.6)]
            lines += self.estimate_lines(f"{angle}_rad", DEGREES)
            if f"{angle}_rad" in self.estimate_names:
                lines = self.with_reference(lines, "reference_lean_rad", index, DEGREES)
            found.append(Panel(angle, "deg", lines, bounds))
        return found

    def yaw_rate(self) -> Panel:
        lines = [Line("gyro", self.field("gyro_rad_s", 2, 0.5 / math.pi), PALE, "solid", 3.6)]
        if "yaw_rate_rad_s" in self.estimate_names:
            lines.append(Line(self.estimators[0], self.estimate("yaw_rate_rad_s", 0, 0.5 / math.pi), BLUE, "solid", 1.5))
        return Panel("yaw rate", "turns/s", self.with_reference(lines, "reference_yaw_rad", 1, 0.5 / math.pi))

    def position(self) -> list[Panel]:
        """Of the ball, inertial: p = r (angle_y, -angle_x)."""
        if self.radius_m is None or "ball_angle_y_rad" not in self.estimate_names:
            return []
        lines = []
        for axis, name, index, sign, colour in (("x", "ball_angle_y_rad", 1, 1.0, BLUE), ("y", "ball_angle_x_rad", 0, -1.0, ORANGE)):
            factor = 100.0 * sign * self.radius_m
            lines.append(Line(axis, self.estimate(name, 0, factor), colour, "solid", 1.5))
            reference = self.field("reference_angle_rad", index, factor)
            if reference is not None:
                lines.append(Line(f"{axis} reference", reference, colour, "dash", 1.0))
        return [Panel("position", "cm", lines)]

    def speed(self) -> Panel:
        remote = np.hypot(*self.frames["remote_velocity_m_s"].T)
        lines = [Line("remote", _finite(remote), GREY, "dot", 1.4)]
        if self.radius_m is not None and "ball_rate_x_rad_s" in self.estimate_names:
            rate = np.hypot(self.estimate("ball_rate_x_rad_s"), self.estimate("ball_rate_y_rad_s"))
            lines.append(Line(self.estimators[0], rate * self.radius_m, BLUE, "solid", 1.5))
            if "reference_velocity_rad_s" in self.names:
                reference = np.hypot(*self.frames["reference_velocity_rad_s"].T) * self.radius_m
                lines.append(Line("reference", _finite(reference), BLACK, "dash", 1.1))
        return Panel("ground speed", "m/s", lines)

    def latency(self) -> Panel | None:
        stages = events.stage_ns(self.frames)
        if not stages["edge_to_write"].any():
            return None  # virtual time
        lines = [Line("edge to write", stages["edge_to_write"] / 1e6, BLUE), Line("wake", stages["wake"] / 1e6, ORANGE)]
        return Panel("latency", "ms", lines)

    def commands(self) -> list[Panel]:
        """One panel a body axis: what each stage makes of the command."""
        if "command_feedback" not in self.names:
            return []
        axes = self.frames["command_feedback"].shape[1]
        found = []
        for axis in range(axes):
            lines = [Line("feedback", self.field("command_feedback", axis), BLUE, "solid", 1.5)]
            friction = self.field("command_friction", axis)
            if friction is not None:
                lines.append(Line("friction", friction, ORANGE))
            applied = self.field("command_applied", axis)
            if applied is not None:
                lines.append(Line("applied", applied, BLACK, "dash", 1.1))
            found.append(Panel(f"body command {AXES.get(axes, '123456')[axis]}", "of full voltage", lines))
        return found

    def wheels(self, name: str, factor: float = 1.0) -> list[Line]:
        if name not in self.names:
            return []
        return [Line(f"wheel {i + 1}", self.field(name, i, factor), SERIES[i]) for i in range(self.frames[name].shape[1])]

    def duty(self) -> Panel:
        limit = self.config.get("limits.duty")
        return Panel("duty", "of the period", self.wheels("duty"), () if limit is None else (-limit, limit))

    def wheel_rate(self) -> Panel:
        return Panel("wheel rate", "rad/s", self.wheels("wheel_rate_rad_s"))

    def battery(self) -> Panel:
        low = self.config.get("battery.minimum_v")
        return Panel("battery", "V", [Line("battery", _finite(self.frames["battery_v"]), GREEN, "solid", 1.5)], () if low is None else (low,))


def _finite(values) -> np.ndarray:
    """A copy as floats with NaN for infinities, which no axis can show."""
    values = np.array(values, float)
    values[~np.isfinite(values)] = np.nan
    return values


# -- bands -------------------------------------------------------------------------------------------------------------
def bands(frames, times_s, codes: Codes) -> list[Band]:
    """States, then missed ticks, IMU troubles and limits that occur in the rows."""
    step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.005
    states = frames["state"]
    edges = [0, *(np.flatnonzero(states[1:] != states[:-1]) + 1).tolist(), len(states)]
    spans = [
        (float(times_s[a]), float(times_s[b - 1]) + step_s, codes.state(states[a]), STATE_COLOURS.get(codes.state(states[a]), GREY))
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]
    found = [Band("state", spans)]
    for label, mask in _conditions(frames, codes):
        found.append(Band(label, [(a, b, label, VERMILLION) for a, b in _runs(mask, times_s, step_s)]))
    return found


def _conditions(frames, codes: Codes):
    if frames["missed"].any():
        yield "missed ticks", frames["missed"] > 0
    for name, entry in events.imu_troubles(frames, codes).items():
        yield f"IMU {name}", frames["imu_status"] & entry["bit"] != 0
    for name, entry in events.limits(frames, codes).items():
        yield name, frames["limits"] & entry["bit"] != 0


def _runs(mask, times_s, step_s: float) -> list[tuple]:
    """(begin, end) of each run of True."""
    padded = np.concatenate(([False], mask, [False]))
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return [(float(times_s[a]), float(times_s[b - 1]) + step_s) for a, b in zip(edges[::2], edges[1::2], strict=True)]


# -- fewer points --------------------------------------------------------------------------------------------------------
def decimated(times_s, values, bins: int):
    """At most 2 `bins` points and the gaps between them: the lowest and the highest of each bin in their order, so that every spike survives.

    A NaN interrupts the line, also where rows are missing for more than SILENCE_TICKS ticks.
    """
    if len(times_s) > 2 * bins:
        size = -(-len(times_s) // bins)
        full = len(times_s) // size * size
        rows = _extremes(values[:full].reshape(-1, size)) + np.arange(0, full, size)[:, None]
        rest = np.arange(full, len(times_s))
        if len(rest):
            rows = np.concatenate((rows, _extremes(values[None, full:]) + full))
        rows = np.unique(rows)
        step_s = size * float(np.median(np.diff(times_s)))
    else:
        rows = np.arange(len(times_s))
        step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.005
    times, kept = times_s[rows], values[rows]
    breaks = np.flatnonzero(np.diff(times) > SILENCE_TICKS * step_s) + 1
    return np.insert(times, breaks, times[breaks]), np.insert(kept, breaks, np.nan)


def _extremes(table):
    """(rows, 2) indices of the lowest and the highest number of each row of a table; NaN counts as neither."""
    missing = np.isnan(table)
    low = np.argmin(np.where(missing, np.inf, table), axis=1)
    high = np.argmax(np.where(missing, -np.inf, table), axis=1)
    return np.stack((low, high), axis=1)
