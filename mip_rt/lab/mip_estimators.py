"""Every estimator of the eduMIP on the same samples, against the simulated truth, while it sways as in ACC Table III and turns: `mip-rt bench estimators`.

The inertial EKF controls. Beside the shipped imperfections two that no filter is told of: the IMU crooked by a degree about the axes back and
up, and 4 mm from where it is believed to be.
"""

import numpy as np

from mip_rt import frame
from mip_rt.config.scenario import Event
from mip_rt.lab.papers.runs import drive
from mip_rt.robots.edumip_setup import ESTIMATORS

CONTROL = "inertial_ekf"
SWAY_M_S, SWAY_S, SETTLE_S, DURATION_S = 0.28, 0.5, 4.0, 34.0
CROOKED = {"dry_run.imu_misalignment_rad": "[0.0, 0.0175, 0.0175]"}
DISPLACED = {"dry_run.imu_position_error_m": "[0.002, 0.003, -0.002]"}
COLUMNS = {
    "0 rad/s": (0.0, {}),
    "5 rad/s": (5.0, {}),
    "10 rad/s": (10.0, {}),
    "15 rad/s": (15.0, {}),
    "10 rad/s, crooked": (10.0, CROOKED),
    "10 rad/s, displaced": (10.0, DISPLACED),
}


def groups() -> list[list[str]]:
    """The estimators in as many runs as there are slots for, without the one that controls."""
    names = [name for name in ESTIMATORS if name != CONTROL]
    return [names[first : first + frame.ESTIMATORS - 1] for first in range(0, len(names), frame.ESTIMATORS - 1)]


def work(job: tuple) -> dict:
    """{estimator: mean square of the lean's error} of one run: job is (column, shadows, seed)."""
    column, shadows, seed = job
    rate_rad_s, changes = COLUMNS[column]
    sway = [Event(6.0 + SWAY_S * k, speed_m_s=[SWAY_M_S * (-1) ** k, 0.0]) for k in range(int((DURATION_S - 6.0) / SWAY_S))]
    settings = {"estimator.control": CONTROL, "estimator.shadows": f"[{', '.join(shadows)}]", **changes}
    record = drive("edumip", settings, [Event(4.0, yaw_rate_hz=rate_rad_s / (2.0 * np.pi)), *sway], DURATION_S, seed)
    rows, truth, _ = record.after(SETTLE_S)
    errors = rows["estimates"][:, : len(record.names), 0] - truth["pitch_rad"][:, None]
    return {**dict(zip(record.names, np.mean(errors**2, axis=0).tolist())), "fell": record.fell}


def run(quick: bool, completed) -> dict:
    """{column: {estimator: RMS error of the lean in rad over the seeds, "fell": runs that ended in a fall or fault}}.

    Args:
        completed: batch.results without its work: jobs -> results in the same order.
    """
    jobs = [(column, shadows, seed) for column in COLUMNS for shadows in groups() for seed in ((1,) if quick else (1, 2, 3))]
    squares = {column: {} for column in COLUMNS}
    for (column, _, _), found in zip(jobs, completed(jobs)):
        for name, value in found.items():
            squares[column].setdefault(name, []).append(value)
    return {
        column: {name: sum(values) if name == "fell" else float(np.sqrt(np.mean(values))) for name, values in found.items()}
        for column, found in squares.items()
    }


def render(table: dict) -> str:
    """Markdown, mrad."""
    lines = ["| estimator | " + " | ".join(table) + " |", "|---|" + "---|" * len(table)]
    lines += [f"| {name} | " + " | ".join(f"{1e3 * column[name]:.2f}" for column in table.values()) + " |" for name in ESTIMATORS]
    return "\n".join([*lines, f"Falls or faults: {sum(column['fell'] for column in table.values())}."])
