"""Logs for the tests of `mip-rt log`: a fall from a dry run, and made-up rows of any layout."""

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt.config import scenario as scenarios
from mip_rt.log.ring import Ring, header
from mip_rt.robots.mbbr_frame import LAYOUT

FALL = """
description: somebody pushes the robot over while it drives, and its battery gives out
duration_s: 11
events:
  - {at_s: 2.0, press: arm}
  - {at_s: 5.0, speed_m_s: [0.2, 0.0]}
  - {at_s: 7.0, fault: pushed, rate_rad_s: 3.5}
  - {at_s: 7.1, set: {battery_v: 4.2}}
"""


@pytest.fixture(scope="session")
def fallen(tmp_path_factory):
    """Path of the ring of a run that ends in the fault `tipped`; the same at every call."""
    with DryRun(tmp_path_factory.mktemp("fall"), make_config(log__ring_s="20", limits__tip_rad="0.35"), scenarios.loads(FALL, "fall"), seed=1) as dry:
        summary = dry.run(11.0)
        assert summary["faults"] == ["tipped"], summary
        return dry.session.ring.path


@pytest.fixture
def make_log(tmp_path):
    """Callable that writes a finished ring: (frames without sequence, layout, configuration text, name, header entries) -> path."""

    def make(frames, layout=LAYOUT, config="robot: mbbr\nrealtime: {rate_hz: 200.0}\n", name="made", **extra):
        ring = Ring(tmp_path / f"{name}.ring", layout.dtype, max(1, len(frames)), header(layout, config, {"estimators": ["one", "two"], **extra}))
        if len(frames):
            index = frames["tick"] % ring.capacity
            ring.rows[index] = frames
            ring.rows["sequence"][index] = frames["tick"] + 1
            ring.commit(int(index[-1]), int(frames["tick"][-1]))
        ring.close()
        return ring.path

    return make


@pytest.fixture
def rows():
    """Callable that makes n consecutive rows of a layout, 5 ms apart, everything else zero."""

    def make(n, layout=LAYOUT, first=0):
        frames = np.zeros(n, layout.dtype)
        frames["tick"] = np.arange(first, first + n)
        frames["edge_ns"] = 1_000_000_000 + 5_000_000 * np.arange(first, first + n, dtype=np.int64)
        for stage, delay_ns in (("wake", 50_000), ("read", 250_000), ("step", 260_000), ("write", 300_000)):
            frames[f"{stage}_ns"] = frames["edge_ns"] + delay_ns
        return frames

    return make
