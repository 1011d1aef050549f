"""A ring with known rows and a recorder that tests move by hand."""

import time

import numpy as np

from mip_rt.log import recorder as recorder_module
from mip_rt.log.ring import Ring, header
from mip_rt.log.ring_format import Status
from mip_rt.robots.mbbr_frame import FRAME, LAYOUT

SETTINGS = {
    "folder": "", "run_folder": "run", "files": 4, "file_bytes": 500_000, "flush_s": 0.0, "compression": 1, "fault_files": 2,
    "fault_before_s": 1.0, "fault_after_s": 0.5, "rate_hz": 200.0,
}  # fmt: skip


class Bench:
    """A ring with random rows and a recorder in this process, moved by hand."""

    def __init__(self, folder, rows=1000, state_bytes=0, **settings):
        description = {"recording": {**SETTINGS, "folder": str(folder), **settings}, "codes": {"fault": {"4": "tipped"}}}
        self.folder = folder
        self.ring = Ring(folder / "a.ring", FRAME, rows, header(LAYOUT, "robot: mbbr\n", description), state_bytes)
        self.recorder = recorder_module.Recorder(self.ring.path)
        self.random = np.random.default_rng(1)
        self.ticks = 0
        self.written = []

    def tick(self, count):
        for _ in range(count):
            index = self.ticks % self.ring.capacity
            self.ring.begin(index)
            self.ring.rows["duty"][index] = self.random.normal(size=3)
            self.ring.rows["tick"][index] = self.ticks
            self.ring.commit(index, self.ticks)
            self.written.append(self.ring.rows[index].tobytes())
            self.ticks += 1

    def record(self, ended=False):
        self.recorder._drain(time.monotonic(), ended)
        self.recorder._publish()

    def status(self, name):
        return self.recorder.status[Status[name.upper()]]

    def check(self, log):
        """Every frame of the log is exactly what was written."""
        assert [row.tobytes() for row in log.frames] == [self.written[tick] for tick in log.frames["tick"]]
        return log
