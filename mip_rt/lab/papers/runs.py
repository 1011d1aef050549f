"""Dry runs for the papers' experiments: the shipped code on the simulated world, with what it logged beside what was true."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mip_rt import config as configuration
from mip_rt import session as runner
from mip_rt.config.scenario import Event, Scenario
from mip_rt.fake import bench as fake_bench
from mip_rt.supervisor import State

DT_S = 0.005


@dataclass
class Record:
    """Rows of the loop while it balanced, with the truth of the same moments.

    Attributes:
        names: estimators by slot; the first controlled.
        rows, truth: (n,) records of the robot's frame and of the plant's TRUTH.
        time_s: (n,) since the robot began to balance.
        fell: it fell, or ended in a fault.
    """

    names: list
    rows: np.ndarray
    truth: np.ndarray
    time_s: np.ndarray
    fell: bool

    def slot(self, name: str) -> int:
        """The estimator's slot."""
        return self.names.index(name)

    def after(self, begin_s: float, end_s: float = np.inf):
        """(rows, truth, time_s) between two moments."""
        chosen = (self.time_s >= begin_s) & (self.time_s < end_s)
        return self.rows[chosen], self.truth[chosen], self.time_s[chosen]


class _Keeper:
    """Takes the summary's place in the session: keeps rows and truth."""

    def __init__(self, names):
        self.names, self.rows, self.truth = names, [], []

    def absorb(self, rows, truth=None, fake_ns=None) -> None:
        """Takes rows in."""
        self.rows.append(rows.copy())
        self.truth.append(truth.copy())

    def report(self, *_) -> dict:
        """Nothing to say."""
        return {}


def drive(robot: str, overrides: dict, events, duration_s: float, seed: int) -> Record:
    """A dry run on virtual time, in this process.

    Args:
        events: config.scenario.Event after the arming, times since the start of the loop; the robot is armed at 2 s and balances at about 2.5 s.
    """
    settings = {"log.ring_s": "5", **{key: str(value) for key, value in overrides.items()}}
    config = configuration.load(configuration.default_path(robot), settings)
    scenario = Scenario("reproduce", "", duration_s, [Event(2.0, press="arm"), *events])
    bench = fake_bench.build(config, scenario, seed, False)
    try:
        with tempfile.TemporaryDirectory() as folder:
            session = runner.Session(config, bench, Path(folder), bench.remote.device, seed, scenario.name)
            keeper = session.summary = _Keeper(session.robot.names)
            session.run(duration_s, runner.Stop(), None, False)
            fell = session.tipped or session.supervisor.state is State.FAULT
    finally:
        bench.close()
    rows, truth = np.concatenate(keeper.rows), np.concatenate(keeper.truth)
    balancing = rows["state"] == State.BALANCING
    rows, truth = rows[balancing], truth[balancing]
    time_s = (rows["edge_ns"] - rows["edge_ns"][0]) * 1e-9 if len(rows) else np.zeros(0)
    return Record(list(keeper.names), rows, truth, time_s, fell)


def rms(values) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
