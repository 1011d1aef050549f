"""What the log costs the loop: the operations of one tick, and the latencies while the recorder is stopped, slow or without room."""

import shutil
import signal
import subprocess
import tempfile
import time
import tracemalloc
from pathlib import Path

import numpy as np

from mip_rt import config as configuration
from mip_rt import session as runner
from mip_rt.config import scenario as scenarios
from mip_rt.fake import bench as fake_bench
from mip_rt.log.ring import STATE_EVERY, Ring, header
from mip_rt.robots.mbbr_frame import FRAME, LAYOUT

STATE_BYTES = 50_000  # about what an MBBR with four estimators keeps
CONDITIONS = ("no recorder", "recording", "recorder slow", "recorder stopped", "disk full")


def operations(ring, parts, count: int) -> float:
    """Seconds that `count` ticks' dealings with the log take: begin, commit, and once a second the state."""
    capacity = ring.capacity
    begin = time.perf_counter()
    for tick in range(count):
        index = tick % capacity
        ring.begin(index)
        ring.commit(index, tick)
        if tick % STATE_EVERY == 0:
            ring.keep_state(tick, parts)
    return time.perf_counter() - begin


def tick_cost(count: int = 100_000) -> dict:
    """Microseconds a tick, and bytes that stay allocated after 10,000 ticks."""
    shared = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=shared if shared.is_dir() else None) as folder:
        ring = Ring(Path(folder) / "bench.ring", FRAME, 2000, header(LAYOUT, ""), STATE_BYTES)
        parts = [np.zeros(STATE_BYTES // 5, np.uint8) for _ in range(5)]
        operations(ring, parts, 1000)
        best = min(operations(ring, parts, count) for _ in range(5))
        tracemalloc.start()
        only = [tracemalloc.Filter(True, str(Path(__file__).parents[1] / "log" / "*"))]
        before = tracemalloc.take_snapshot().filter_traces(only)
        operations(ring, parts, 10_000)
        after = tracemalloc.take_snapshot().filter_traces(only)
        tracemalloc.stop()
        grown = sum(max(0, difference.size_diff) for difference in after.compare_to(before, "lineno"))
    return {"us_per_tick": best / count * 1e6, "bytes_grown": grown}


# Waits for this process's recorder, then stops it for good, or for nine tenths of the time.
STOP = "until P=$(pgrep -P $PPID -f '[m]ip_rt.log.recorder'); do sleep 0.1; done; sleep 1; kill -STOP $P; while sleep 0.9; do {}; done"
TROUBLE = {
    "recorder stopped": STOP.format(":"),
    "recorder slow": STOP.format("kill -CONT $P; sleep 0.1; kill -STOP $P"),
}


def small_disk(folder: Path) -> bool:
    """Mounts a file system of 64 kB, full within seconds; False where that is not allowed."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "mip-rt-bench", str(folder)]
    return subprocess.run(mount, capture_output=True, check=False).returncode == 0


def run_under(condition: str, duration_s: float) -> dict | None:
    """Summary of a dry run in real time; None where the condition cannot be made here. The ring is short, so that it overruns."""
    config = configuration.load(configuration.default_path("mbbr"), {"estimator.shadows": "[]", "log.ring_s": "2"})
    shared = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(dir=shared if shared.is_dir() else None))
    disk, mounted, child = folder / "disk", False, None
    bench = fake_bench.build(config, scenarios.load("hold"), 1, True)
    try:
        if condition == "disk full":
            mounted = small_disk(disk)
            if not mounted:
                return None
        record = None if condition == "no recorder" else disk
        session = runner.Session(config, bench, folder, bench.remote.device, 1, "hold", record)
        if condition in TROUBLE:
            child = subprocess.Popen(["sh", "-c", TROUBLE[condition]])
        return session.run(duration_s, runner.Stop(), None, True)
    finally:
        if child:
            child.kill()
            child.wait()
            session.recorder.process.send_signal(signal.SIGCONT)
        bench.close()
        if mounted:
            subprocess.run(["umount", "-l", str(disk)], check=False)
        shutil.rmtree(folder, ignore_errors=True)


def disturbance(duration_s: float, rounds: int, progress=lambda done, total, what: None) -> dict:
    """By condition: p99.9 of edge to motor write in microseconds (the best and the median of the rounds), missed ticks, rows not recorded.

    The conditions take turns, so that what else the machine does meets all of them; on a machine that does much else only the best counts.
    """
    found = {condition: [] for condition in CONDITIONS}
    for number in range(rounds):
        for place, condition in enumerate(CONDITIONS):
            progress(number * len(CONDITIONS) + place, rounds * len(CONDITIONS), condition)
            report = run_under(condition, duration_s)
            if report is not None:
                found[condition].append(report)
    table = {}
    for condition, reports in found.items():
        if reports:
            p999_us = [report["latency_us"]["edge_to_write"]["p999"] for report in reports]
            table[condition] = {
                "p999_best_us": float(np.min(p999_us)),
                "p999_us": float(np.median(p999_us)),
                "missed": sum(report["missed"] for report in reports),
                "ticks": sum(report["ticks"] for report in reports),
                "recorded": sum(report["recorder"]["recorded"] for report in reports if report["recorder"]),
                "not_recorded": sum(report["recorder"]["dropped"] + report["recorder"]["backlog"] for report in reports if report["recorder"]),
            }
    return table


def report(quick: bool, progress) -> dict:
    """For `mip-rt bench log`: the cost of a tick and the disturbance."""
    return {"tick": tick_cost(20_000 if quick else 100_000), "loop": disturbance(6.0 if quick else 20.0, 1 if quick else 5, progress)}


def render(figures: dict) -> None:
    """Markdown."""
    tick = figures["tick"]
    print(f"log in the loop: {tick['us_per_tick']:.2f} us a tick, {tick['bytes_grown']} bytes grown in 10,000 ticks\n")
    print("| recorder | edge to motors p99.9 (us), best round | median | missed | ticks | recorded | not recorded |")
    print("|---|---|---|---|---|---|---|")
    for condition, row in figures["loop"].items():
        print(f"| {condition} | {row['p999_best_us']:.0f} | {row['p999_us']:.0f} | {row['missed']} | {row['ticks']} | {row['recorded']} | {row['not_recorded']} |")
    for condition in CONDITIONS:
        if condition not in figures["loop"]:
            print(f"\n{condition}: left out, needs the right to mount a file system")
