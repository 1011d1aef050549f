"""Injects the faults of a scenario: begins each at its moment, ends it, and keeps a journal of what was done when.

Each injection has its own random numbers, from the seed, its number and its name: the world's noise and the other faults stay as they are
when one is added.
"""

import importlib
import random
from types import SimpleNamespace

from mip_rt.fake.faults import FAULTS, defaults
from mip_rt.fake.taps import Taps

NEVER_NS = 1 << 62


class Injection:
    """One fault under way or past.

    Attributes:
        name: of the fault.
        p: its parameters, as attributes.
        begin_ns, end_ns: when it began and ended; end_ns is NEVER_NS while it lasts.
        hits: how often it struck.
        random: its own random.Random.
    """

    def __init__(self, name: str, parameters: dict, begin_ns: int, source: random.Random):
        self.name, self.begin_ns, self.random = name, begin_ns, source
        self.p = SimpleNamespace(**{**defaults(name), **parameters})
        self.end_ns, self.hits = NEVER_NS, 0
        self._left = 0

    def strikes(self) -> bool:
        """Whether it strikes at this chance: by probability, then for the rest of the burst."""
        if self._left:
            self._left -= 1
        elif self.random.random() < self.p.probability:
            self._left = self.p.burst - 1
        else:
            return False
        self.hits += 1
        return True


class Injector:
    """All faults of one dry run.

    Args:
        bench: fake.bench.Bench, whose parts the faults act upon.
        seed: of all randomness here.

    Attributes:
        journal: every Injection, in order.
        until_ns: when the next one ends.
        taps: fake.taps.Taps, also for whoever wants to watch the boundary.
        count_offset: (wheel: counts) by which the shown encoder counts differ from the world's for good.
        stalls: list of (begin_ns, end_ns) in which the loop could not run.
        config_text: what the configuration file held before it was overwritten.
    """

    def __init__(self, bench, seed: int):
        self.bench, self._seed = bench, seed
        self.taps = Taps()
        self.journal, self._undo = [], []
        self.until_ns = NEVER_NS
        self.count_offset = {}
        self.stalls = []
        self.config_text = None

    def begin(self, name: str, parameters: dict, now_ns: int) -> None:
        """A fault begins."""
        kind = FAULTS[name]
        injection = Injection(name, parameters, now_ns, random.Random(f"{self._seed} {len(self.journal)} {name}"))
        self.journal.append(injection)
        start = getattr(importlib.import_module(f"mip_rt.fake.{kind.module}"), name)
        undo = start(self, injection)
        if not kind.lasts:
            injection.end_ns = now_ns
            return
        until_ns = now_ns + round(injection.p.for_s * 1e9)
        self._undo.append((until_ns, injection, undo))
        self.until_ns = min(self.until_ns, until_ns)

    def end(self, now_ns: int) -> None:
        """Ends what is over."""
        over = [entry for entry in self._undo if entry[0] <= now_ns]
        self._undo = [entry for entry in self._undo if entry[0] > now_ns]
        self.until_ns = min((entry[0] for entry in self._undo), default=NEVER_NS)
        for _, injection, undo in over:
            injection.end_ns = now_ns
            if undo is not None:
                undo()

    def close(self) -> None:
        """Ends everything, for example restores files and clocks."""
        self.end(NEVER_NS)

    def stall(self, seconds: float) -> None:
        """The loop does not run for so long, while the world does."""
        kernel = self.bench.kernel
        begin_ns = kernel.monotonic_ns()
        kernel.stall(seconds)
        self.stalls.append((begin_ns, kernel.monotonic_ns()))
