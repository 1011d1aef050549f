"""What several tests need: a dry run without a subprocess, on virtual time."""

import functools
import math
import struct

import numpy as np

from mip_rt import config as configuration
from mip_rt import session
from mip_rt.config import scenario as scenarios
from mip_rt.fake import bench as fake_bench


def make_config(robot="mbbr", **overrides):
    """The shipped configuration of a robot with changes; `__` in a name stands for the dot."""
    return configuration.load(
        configuration.default_path(robot), {name.replace("__", "."): value for name, value in overrides.items()}
    )


class DryRun:
    """A session on fakes, virtual time, opened in a context."""

    def __init__(self, folder, config=None, scenario="hold", seed=1, remote=True):
        self.config = config or make_config(estimator__shadows="[]")
        found = scenarios.load(scenario) if isinstance(scenario, str) else scenario
        self.bench = fake_bench.build(self.config, found, seed, False)
        self.session = session.Session(
            self.config, self.bench, folder, self.bench.remote.device if remote else None, seed, found.name
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.session.supervisor.shut_down()
        self.bench.close()

    def run(self, duration_s):
        """The whole session; its summary."""
        return self.session.run(duration_s, session.Stop(), None, False)

    def until(self, predicate, limit_s=10.0):
        """Ticks (with what happens between ticks) until predicate() or the limit; returns seconds of virtual time that passed."""
        kernel, loop = self.bench.kernel, self.session.loop
        begin = kernel.monotonic_ns()
        while not predicate():
            elapsed = (kernel.monotonic_ns() - begin) * 1e-9
            assert elapsed < limit_s, f"nothing happened in {limit_s} s"
            if loop.tick():
                self.session._between_ticks(loop.ticks - 1)
        return (kernel.monotonic_ns() - begin) * 1e-9

    @property
    def state(self):
        return self.session.supervisor.state

    @property
    def row(self):
        """The newest complete row."""
        return self.session.ring.rows[(self.session.loop.ticks - 1) % self.session.ring.capacity]

    def motors_on(self) -> bool:
        """As the motor drivers see it: enabled, with a duty."""
        import numpy as np

        duty = np.zeros(len(self.config.motors.signs))
        return self.bench.kernel.motor_wiring.read(duty) and bool(duty.any())


@functools.cache
def _mounting():
    return np.array(make_config().imu.mounting)


def felt_by_chip(world):
    """Specific force (m/s^2) and rate (rad/s) in body axes, from the registers of a fake.world.World."""
    words = np.array(struct.unpack(">3hh3h", world.raw), float)
    return _mounting() @ words[:3] * 8 * 9.80665 / 32768, _mounting() @ words[4:] * math.radians(2000) / 32768
