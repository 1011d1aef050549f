"""`mip-rt bench board` on the fake board: every stage has figures beside its budget, and the motors stay off."""

import json
import subprocess
import sys

import pytest

from mip_rt.hardware import i2c_time
from mip_rt.lab.board import STAGES, histogram


@pytest.mark.slow
def test_every_stage_is_measured():
    command = [sys.executable, "-m", "mip_rt", "bench", "board", "--dry-run", "--seconds", "2", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-1500:]
    found = json.loads(done.stdout)
    assert set(found["idle"]["stages"]) == set(STAGES) and found["idle"]["ticks"] > 300
    for name, figures in found["idle"]["stages"].items():
        assert figures["n"] > 100 and 0.0 < figures["p50"] <= figures["p99"] <= figures["p100"], (name, figures)
    assert found["budget_us"]["i2c_packet"] == 895  # 795 us of wire time and what the kernel may add
    assert sum(count for _, count in found["idle"]["wake_histogram_us"]) == found["idle"]["stages"]["wake"]["n"]


def test_wire_times_are_those_of_the_bus():
    """Against a table that was made by hand: us at 400 kHz of transfers that the drivers make."""
    for bits, us in ((i2c_time.write_bits(1), 72), (i2c_time.read_bits(1), 98), (i2c_time.read_bits(2), 120), (i2c_time.read_bits(15), 412), (i2c_time.read_bits(32), 795)):
        assert abs(bits / i2c_time.FAST_HZ * 1e6 - us) < 1.0
    assert round(i2c_time.tick_bits("dmp") / i2c_time.FAST_HZ * 1e3, 2) == 0.92 and round(i2c_time.tick_bits("onboard") / i2c_time.FAST_HZ * 1e3, 2) == 0.41
    assert abs(i2c_time.tick_bits("dmp") / i2c_time.STANDARD_HZ * 1e3 - 3.66) < 0.01


def test_histogram_counts_everything_once():
    assert histogram([1_000, 9_000, 40_000, 10**12]) == [[8.0, 1], [16.0, 1], [64.0, 1], [float("inf"), 1]]
