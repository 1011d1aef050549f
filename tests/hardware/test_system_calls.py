"""System calls of a tick, counted by the kernel's own tracer: reused messages, open descriptors and writes only on change keep them at 12 at most."""

import re
import shutil
import subprocess
import sys
from collections import Counter

import pytest

MOST = 12
TICKS = 150
# A loop that balances on the driver's own ioctl, which does nothing, with real files for encoders and PWM, and a pipe that holds an event for each tick.
# The two accesses frame the ticks that are counted.
PROGRAM = f"""
import os
from mip_rt.lab import costs

loop, bench = costs.stubbed_loop("mbbr", {TICKS} + 20)
for _ in range(20):
    loop.tick()
before = loop.ticks
os.access("/begin-of-ticks", os.F_OK)
for _ in range({TICKS}):
    loop.tick()
os.access("/end-of-ticks", os.F_OK)
assert loop.ticks == before + {TICKS} and loop.supervisor.state.name == "BALANCING", loop.supervisor.fault
loop.supervisor.shut_down()
bench.close()
"""


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed (apt install strace)")
def test_a_tick_makes_at_most_12_system_calls(tmp_path, capsys):
    trace = tmp_path / "trace"
    command = ["strace", "-f", "-o", str(trace), sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    if "ptrace" in done.stderr and "not permitted" in done.stderr:
        pytest.skip("this container forbids tracing")
    assert done.returncode == 0, done.stderr[-2000:]
    lines = trace.read_text().splitlines()
    begin = next(i for i, line in enumerate(lines) if "begin-of-ticks" in line)
    end = next(i for i, line in enumerate(lines) if "end-of-ticks" in line)
    process = lines[begin].split()[0]
    calls = Counter(found[1] for line in lines[begin + 1 : end] if line.startswith(process) and (found := re.match(r"\d+\s+(\w+)\(", line)))
    per_tick = {name: round(count / TICKS, 2) for name, count in calls.most_common()}
    with capsys.disabled():
        print(f"\nsystem calls a tick: {sum(calls.values()) / TICKS:.2f}: {per_tick}")
    assert sum(calls.values()) <= MOST * TICKS, per_tick
    assert per_tick["ioctl"] >= 2 and per_tick["pread64"] >= 3 and per_tick["poll"] >= 1, "what is counted is not the tick"
