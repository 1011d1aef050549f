"""How far ordinary driving stays from every detector: hours of the shipped scenarios with nominal noise and vibration, faults counted.

Used by `mip-rt bench alarms`; a fault or a graded reaction here is a false alarm.
"""

import tempfile
from pathlib import Path

import numpy as np

from mip_rt import config as configuration
from mip_rt import frame, robots
from mip_rt import session as runner
from mip_rt.config import scenario as scenarios
from mip_rt.fake import bench as fake_bench
from mip_rt.lab import batch
from mip_rt.supervisor import State

# What must not happen in ordinary driving although it is no fault.
GRADED = ("encoder_jump", "not_finite", "estimator_reset", "wheels_disagree", "drive_reduced", "spin_down", "battery_warning")


def one(job) -> dict:
    """One run of (robot, scenario, seed): simulated seconds, faults, ticks of each graded reaction, largest mismatch of wheels and gyro."""
    robot, name, seed = job
    script = scenarios.load(name)
    config = configuration.load(
        configuration.default_path(robot), {"estimator.shadows": "[]", "log.ring_s": str(script.duration_s + 5.0)}
    )
    bench = fake_bench.build(config, script, seed, False)
    try:
        with tempfile.TemporaryDirectory() as folder:
            session = runner.Session(config, bench, Path(folder), bench.remote.device, seed, name)
            report = session.run(script.duration_s, runner.Stop(), None, False)
            rows = session.ring.rows[: report["ticks"]]
            balancing = rows[rows["state"] == State.BALANCING]
            return {
                "scenario": f"{robot} {name}",
                "seed": seed,
                "balanced_s": report["balanced_s"],
                "faults": report["faults"] + ([] if report["state"] == "BALANCING" else [report["state"]]),
                "graded": {bit: int(np.count_nonzero(balancing["limits"] & frame.LIMITS[bit])) for bit in GRADED},
                "mismatch_share": float(np.abs(balancing["wheel_mismatch_rad"]).max() / config.limits.wheel_mismatch_rad),
            }
    finally:
        bench.close()


def jobs(hours: float):
    """Runs of the shipped scenarios in turn, each with its own seed, that together last so long; spins in rad/s are the eduMIP's, those in Hz the MBBR's."""
    pairs = [
        (robot, name) for robot in robots.NAMES for name in sorted(scenarios.shipped())
        if name in ("hold", "drive") or name.endswith("-rad-s") == (robot == "edumip")
    ]  # fmt: skip
    lengths = {name: scenarios.load(name).duration_s for _, name in pairs}
    left_s, seed = hours * 3600.0, 1000
    while left_s > 0.0:
        for robot, name in pairs:
            yield robot, name, seed
            left_s -= lengths[name]
            seed += 1


def run(hours: float, cluster=None, workers=None) -> list[dict]:
    """Results of all runs; see lab.batch for where they run."""
    return [result for _, result in batch.completed(one, jobs(hours), "alarms", cluster, workers)]


def print_table(found: list[dict]) -> None:
    """Markdown: by scenario, then every run with a fault or a graded reaction."""
    print("| scenario | hours | faults | graded reactions (ticks) | largest wheel mismatch, share of its limit |")
    print("|---|---|---|---|---|")
    for name in sorted({result["scenario"] for result in found}):
        runs = [result for result in found if result["scenario"] == name]
        graded = sum(sum(result["graded"].values()) for result in runs)
        print(f"| {name} | {sum(r['balanced_s'] for r in runs) / 3600:.2f} | {sum(bool(r['faults']) for r in runs)} | {graded} "
              f"| {max(r['mismatch_share'] for r in runs):.2f} |")  # fmt: skip
    for result in found:
        reactions = {name: ticks for name, ticks in result["graded"].items() if ticks}
        if result["faults"] or reactions:
            print(f"{result['scenario']} --seed {result['seed']}: {result['faults']} {reactions}")
