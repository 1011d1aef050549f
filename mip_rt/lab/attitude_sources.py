"""Both robots with the DMP and without it: tilt error of the attitude in every shipped scenario."""

import numpy as np

from mip_rt.config import scenario as scenarios

WORST_RATIO = 1.2  # of the onboard attitude's tilt error to the DMP's


def scenarios_of(robot: str) -> list[str]:
    """The shipped scenarios that are meant for a robot: spins in rad/s are the eduMIP's, those in Hz the MBBR's."""
    return [name for name in sorted(scenarios.shipped()) if name in ("hold", "drive") or name.endswith("-rad-s") == (robot == "edumip")]


def run(dry_run, quick: bool, progress) -> list[dict]:
    """One entry a robot and scenario: RMS tilt errors in rad over the seeds by source, and how many runs ended in a fall or fault.

    Args:
        dry_run: bench.dry_run.
    """
    seeds, duration_s = ((1,), 20.0) if quick else ((1, 2, 3), 60.0)
    listed = [(robot, name) for robot in ("mbbr", "edumip") for name in scenarios_of(robot)]
    found = []
    for number, (robot, name) in enumerate(listed):
        progress(number, len(listed), f"{robot} {name}")
        entry = {"robot": robot, "scenario": name, "failed": 0}
        for source in ("dmp", "onboard"):
            overrides = {"imu.attitude": source, "estimator.shadows": "[]", "log.ring_s": "5"}
            reports = [dry_run(overrides, name, seed, duration_s, robot) for seed in seeds]
            entry[source] = float(np.sqrt(np.mean([report["tilt_rms_error_rad"] ** 2 for report in reports])))
            entry["failed"] += sum(bool(report["fell"] or report["faults"]) for report in reports)
        found.append(entry)
    progress(len(listed), len(listed), "")
    return found


def passed(found: list[dict]) -> bool:
    """No run failed, and nowhere is the onboard attitude worse than WORST_RATIO times the DMP's."""
    return not any(entry["failed"] or entry["onboard"] > WORST_RATIO * entry["dmp"] for entry in found)


def render(found: list[dict]) -> str:
    """Markdown."""
    lines = ["| robot | scenario | tilt error with the DMP (mrad) | onboard (mrad) | falls or faults |", "|---|---|---|---|---|"]
    for entry in found:
        lines.append(f"| {entry['robot']} | {entry['scenario']} | {1e3 * entry['dmp']:.2f} | {1e3 * entry['onboard']:.2f} | {entry['failed']} |")
    return "\n".join(lines)
