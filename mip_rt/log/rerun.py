"""Runs a log's recorded inputs through the compiled step again: the robot rebuilt from the log, no device, no clock, no plant.

Where a log does not begin with tick 0 (a ring that has turned), or ticks are missing in it, the replay resumes at the next state row.
A state row is the state after its tick.
"""

import math
from dataclasses import dataclass

import numpy as np

from mip_rt import compiled, robots
from mip_rt import config as configuration
from mip_rt.errors import ConfigError, LogError
from mip_rt.log.selection import seconds

BATCH = 4096  # rows replayed at a time


@dataclass
class Span:
    """Consecutive ticks that are replayed in one go.

    Attributes:
        begin, end: range of rows of the log's frames.
        state: persistent state before the first of them; None for that of a robot that has just started.
    """

    begin: int
    end: int
    state: bytes | None


class Rerun:
    """A log and the robot that it came from.

    Args:
        log: what `mip_rt.log.open` returns.
        overrides: dotted key to value, applied to the log's configuration.
        config: a configuration to use in place of the log's (overrides included).
        asserted: the replay is to be equal. Otherwise it begins with a fresh state where no state row fits.
        limits: (first tick, first tick no longer) that count, as `tick_of` understands them; None for all.

    Attributes:
        robot: the rebuilt robot.
        names, recorded_names: estimator names by slot, as replayed and as recorded.
        recorded_command: the estimators are told the recorded command, not the one that the replayed controller computed. Controller
            and filters alone, without the plant that answers, are an unstable system: where rounding, code or configuration may
            differ, a replay must be open-loop in this one place, or it would run away from what the robot did.
        other_machine: {item: (recorded, here)} of what makes this another type of machine; empty on the same.
        other_sources: True where the log was written by other sources.
        missing: fields that this program's step reads and the log does not have; zero is taken.
        states: {tick: state row} of those that fit; unfit_states: how many do not, since this program's state has other fields; times_s: (rows of the log,) seconds since the loop's first tick.
        spans: list of Span.
        cold_ticks: first ticks of spans that begin with a fresh state although the log does not.
        skipped: rows between the wanted limits that cannot be replayed.

    Raises:
        LogError: the log is of another robot, or nothing in it can be replayed.
        ConfigError: its configuration, with the changes, is not valid for this program.
    """

    def __init__(self, log, overrides=None, config=None, asserted: bool = True, limits=(None, None)):
        header, frames = log.header, log.frames
        if not len(frames):
            damage = "".join(f" {sentence}." for sentence in log.damage)
            raise LogError(f"{log.path} holds no complete tick.{damage}", "Name another log.", "replay_empty")
        self.log = log
        if config is None:
            config = configuration.loads(log.config, f"the configuration in {log.path}", overrides)
        self.robot = robots.setup(config.robot).build(config)
        self.names, self.recorded_names = list(self.robot.names), list(header.get("estimators", self.robot.names))
        self._own_slots = [self.recorded_names.index(name) if name in self.recorded_names else None for name in self.names]
        self.layout = self.robot.layout
        self.dt_s = 1.0 / config.realtime.rate_hz
        here, there = compiled.machine_type(), header.get("machine_type")
        if there is None:
            self.other_machine = {"machine": ("unknown", here["machine"])}
        else:
            self.other_machine = {item: (there.get(item), value) for item, value in here.items() if there.get(item) != value}
        self.other_sources = header.get("source_hash") != compiled.source_hash()
        self.recorded_command = bool(self.other_machine) or not asserted
        self._check_layout()
        self._fresh = self.robot.persistence.present()
        fits = header.get("state_layout") == self.robot.persistence.layout
        self.states, self.unfit_states = (log.states, 0) if fits else ({}, len(log.states))
        self.times_s = seconds(log)
        self.first, self.last = self._rows(limits)
        self.cold_ticks, self.skipped, self.spans = [], 0, []
        self._find_spans(not asserted)
        if not self.spans:
            raise LogError(
                f"{log.path} holds neither tick 0 nor a state row that fits{'' if fits else ' this program'}: nothing can be replayed.",
                "Use --force to start with a fresh state.", "replay_no_state",
            )  # fmt: skip

    def _check_layout(self) -> None:
        recorded, own = self.log.frames.dtype, self.layout.dtype
        for name in set(recorded.names) & set(own.names):
            if recorded[name] != own[name]:
                raise LogError(f"the log's field {name} is {recorded[name]}, this robot's {own[name]}.", "Name the robot's own log.", "replay_layout")
        self.missing = [name for name in self.layout.step_inputs if name not in recorded.names]
        self.outputs = [name for name in self.layout.step_outputs if name in recorded.names]
        if self.names[0] != self.recorded_names[0]:  # these are of the estimator in control: another one means something else by them
            self.outputs = [name for name in self.outputs if name not in ("state_estimate", "state_variance", "innovation")]

    def _rows(self, limits):
        """Range of rows from the first limit up to and without the second."""
        ticks = self.log.frames["tick"]
        low, high = (None if text is None else tick_of(text, ticks, self.times_s) for text in limits)
        first = 0 if low is None else int(np.searchsorted(ticks, low))
        last = len(ticks) if high is None else int(np.searchsorted(ticks, high))
        if first >= last:
            raise LogError(f"the log has ticks {ticks[0]} to {ticks[-1]}, none in the range asked for.", code="replay_range")
        return first, last

    def _find_spans(self, cold: bool) -> None:
        ticks = self.log.frames["tick"]
        breaks = np.flatnonzero(np.diff(ticks) != 1) + 1
        edges = [0, *map(int, breaks), len(ticks)]
        kept = np.array(sorted(self.states), np.int64)
        for begin, end in zip(edges[:-1], edges[1:]):
            wanted, end = max(begin, self.first), min(end, self.last)
            if wanted >= end:
                continue
            # States that precede a row of this stretch; the last of them before the first wanted row, else the first after it.
            usable = kept[(kept >= ticks[begin] - 1) & (kept < ticks[end - 1])]
            before = usable[usable < ticks[wanted]]
            if len(before):
                state = before[-1]
            elif ticks[begin] == 0:
                state = -1
            elif len(usable):
                state = usable[0]
            elif cold:
                state = None
                self.cold_ticks.append(int(ticks[begin]))
            else:
                self.skipped += end - wanted
                continue
            start = begin if state is None else begin + int(state + 1 - ticks[begin])
            self.skipped += max(0, start - wanted)
            self.spans.append(Span(start, end, self.states.get(int(state)) if state is not None and state >= 0 else None))

    @property
    def recorded_slots(self) -> list[int]:
        """The recorded slot that each replayed estimator is compared with: its own, or the one in control where it was not there."""
        return [slot or 0 for slot in self._own_slots]

    @property
    def count(self) -> int:
        """Rows that `batches` replays."""
        return sum(span.end - span.begin for span in self.spans)

    def batches(self):
        """Replays everything; yields (recorded rows, replayed rows, ticks whose state row differs, how many of the rows count).

        The rows before the first wanted one, between the state row and it, do not count; they come first. The arrays are views that the next
        batch overwrites.
        """
        frames, robot = self.log.frames, self.robot
        work = np.zeros(min(BATCH, max(span.end - span.begin for span in self.spans)), self.layout.dtype)
        robot.attach(work)
        inputs = [name for name in self.layout.step_inputs if name not in self.missing]
        for span in self.spans:
            if span.state is None:
                robot.persistence.restore(self._fresh)
            else:
                robot.persistence.restore(span.state, self._own_slots)
            command = None
            for begin in range(span.begin, span.end, BATCH):
                recorded = frames[begin : min(begin + BATCH, span.end)]
                rows = work[: len(recorded)]
                for name in inputs:
                    rows[name] = recorded[name]
                if self.recorded_command:
                    command = self._run_open(recorded, command)
                    differing = []
                else:
                    differing = self._run_closed(recorded["tick"])
                counted = max(0, min(len(recorded), begin + len(recorded) - self.first))
                yield recorded, rows, differing, counted

    def _run_closed(self, ticks) -> list[int]:
        """Replays rows as the robot ran them; returns the ticks after which the state is not that of the log's state row."""
        step, states, persistence, differing = self.robot.step, self.states, self.robot.persistence, []
        for index, tick in enumerate(ticks.tolist()):
            step(index)
            if tick in states and states[tick] != persistence.present():
                differing.append(tick)
        return differing

    def _run_open(self, recorded, before):
        """Replays rows with the recorded command in force; `before` is the command before the first, None where the state has it."""
        step, in_force = self.robot.step, self.robot.command_in_force
        commands = np.where(np.isfinite(recorded["command_applied"]), recorded["command_applied"], 0.0)
        for index in range(len(recorded)):
            if before is not None:
                in_force[:] = before
            step(index)
            before = commands[index]
        return before


def tick_of(text: str, ticks, times_s) -> int:
    """The tick that `--from` or `--to` names: t1200 is a tick, a plain number is seconds since the loop's first tick.

    Raises:
        ConfigError: it is neither.
    """
    try:
        if text.startswith("t"):
            return int(text[1:])
        time_s = float(text)
        if math.isfinite(time_s):
            row = int(np.searchsorted(times_s, time_s - 1e-9))
            return int(ticks[row]) if row < len(ticks) else int(ticks[-1]) + 1
    except ValueError:
        pass
    raise ConfigError(f"{text!r} is neither a time nor a tick.", "Write 6.5 for seconds, t1300 for a tick.", "arguments")
