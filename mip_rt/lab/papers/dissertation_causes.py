"""What made the EKF err in Table 6.1? One imperfection at a time, in several sizes, against all of its rows.

The row at 0.5 Hz is the puzzle: its error is nearly that at 1 Hz. A candidate must give it, and leave the other rows right.
"""

import numpy as np

from mip_rt.lab.papers import mbbr_runs
from mip_rt.lab.papers.dissertation_table61 import SWAY_M_S, TABLE_6_1, WITHIN, condition_name, moved
from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.lab.papers.mbbr_runs import fly, see
from mip_rt.lab.papers.runs import DT_S, rms

# Candidate: (unit, sizes, settings of the dry run with {} for the size)
FLOWN = {
    "crooked IMU": ("rad", (0.01, 0.03, 0.07), {"dry_run.imu_misalignment_rad": "[{}, 0.0, 0.0]"}),
    "IMU off the axis": ("m", (0.01, 0.03, 0.06), {"dry_run.imu_position_error_m": "[{}, 0.0, 0.0]"}),
    "torque that nobody commanded": ("of a command", (0.05, 0.1, 0.2), {"dry_run.input_error": "[{}, 0.0, 0.0]"}),
    "drifting gyro": ("rad/s²", (3e-4, 1e-3, 3e-3), {"dry_run.gyro_drift_rad_s2": "[{}, 0.0, 0.0]"}),
    "more friction than compensated": ("times", (1.2, 1.5, 2.0), {"dry_run.friction": "{}"}),
    "rolling resistance": ("N m", (0.003, 0.005, 0.007), {"dry_run.rolling_resistance_n_m": "{}"}),
    "backlash": ("rad", (0.005, 0.01, 0.02), {"dry_run.backlash_rad": "{}"}),
    "roller vibration, torque": ("N m", (0.04, 0.08, 0.12), {"dry_run.vibration_torque_n_m": "{}"}),
    "roller vibration, accelerometer": ("m/s²", (1.0, 3.0, 6.0), {"dry_run.vibration_accel_m_s2": "{}"}),
    "late DMP": ("s", (0.01, 0.02, 0.03), {"dry_run.dmp_lag_s": "{}"}),
}  # fmt: skip
SEEN = {"cameras' clock late": ("s", (0.02, 0.05, 0.1)), "cameras' vertical tilted": ("rad", (0.02, 0.04, 0.06))}
MOTION = ("motion while it spins in its place", "m/s", (0.06, SWAY_M_S, 0.12))
OVERRIDES = {"estimator.control": "dmp_ekf", "estimator.shadows": "[ekf_flown]", "estimator.noise_set": "friction"}


def _flight(condition, seed, duration_s, overrides, sway_m_s=0.0):
    speed, rate = condition
    return fly(rate, moved(speed, rate, sway_m_s), {**OVERRIDES, **overrides}, duration_s, seed)


def _error(record, seed, late_s: float = 0.0, tilted_rad: float = 0.0) -> float:
    """RMS tilt error; infinite where the robot fell. A tilted vertical shows only once the robot has turned away from where it was matched."""
    if record.fell:
        return np.inf
    seen = see(record, seed)
    shift = round(late_s / DT_S)
    estimate, mocap = seen.estimates["ekf_flown"][0][shift:], seen.tilt_rad[: len(seen.tilt_rad) - shift or None]
    yaw = record.after(mbbr_runs.SETTLE_S)[1]["yaw_rad"][: len(mocap)]
    return rms(estimate - mocap - tilted_rad * np.stack([np.cos(yaw) - 1.0, -np.sin(yaw)], axis=1))


def distance(errors: dict) -> float:
    """Root mean square of the logarithms of ours over published."""
    return rms([np.log(value / TABLE_6_1[condition][0]) for condition, value in errors.items()])


def _bars(figure, chosen):
    axes = figure.add_subplot()
    conditions = list(next(iter(chosen.values()))[1])
    places = np.arange(len(conditions))
    axes.bar(places, [TABLE_6_1[c][0] for c in conditions], 0.9, color="0.88", label="published")
    for number, (name, (size, errors)) in enumerate(chosen.items()):
        shift = 0.8 * (number / (len(chosen) - 1) - 0.5)
        axes.plot(
            places + shift,
            list(errors.values()),
            "osvD^PX*<>hpd"[number % 13],
            color=f"C{number % 10}",
            ms=6,
            mec="k",
            mew=0.4,
            label=name + size,
        )
    axes.set(
        xticks=places,
        xticklabels=[condition_name(*c).replace(" & ", "\n& ") for c in conditions],
        ylabel="RMSE of θ (rad)",
        ylim=(0, 0.1),
    )
    axes.tick_params(axis="x", labelsize=8)
    axes.grid(alpha=0.3, axis="y")
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    figure.tight_layout()


def run(seed: int, quick: bool, progress) -> Result:
    """Every candidate at the size that comes nearest to the whole column."""
    duration_s = 12.0 if quick else 20.0
    conditions = [(0.0, 0.0), (0.0, 0.5), (0.0, 1.0), (0.1, 0.25)] if quick else list(TABLE_6_1)
    kept = slice(1, 2) if quick else slice(None)
    spins = [c for c in conditions if c[1] and not c[0]]
    total = len(conditions) * (1 + sum(len(sizes[kept]) for _, sizes, _ in FLOWN.values())) + len(spins) * len(MOTION[2][kept])
    done = [0]

    def flights(chosen, overrides, sway_m_s=0.0):
        found = {}
        for condition in chosen:
            progress(done[0], total)
            done[0] += 1
            found[condition] = _flight(condition, seed, duration_s, overrides, sway_m_s)
        return found

    plain = flights(conditions, {})
    base = {c: _error(record, seed) for c, record in plain.items()}
    tried = {}
    for name, (unit, sizes, settings) in FLOWN.items():
        for size in sizes[kept]:
            found = flights(conditions, {key: value.format(size) for key, value in settings.items()})
            tried[name, size, unit] = {c: _error(record, seed) for c, record in found.items()}
    for place, (name, (unit, sizes)) in enumerate(SEEN.items()):
        for size in sizes[kept]:
            kind = ("late_s", "tilted_rad")[place]
            tried[name, size, unit] = {c: _error(record, seed, **{kind: size}) for c, record in plain.items()}
    name, unit, sizes = MOTION
    for size in sizes[kept]:
        swaying = {c: _error(record, seed) for c, record in flights(spins, {}, size).items()}
        tried[name, size, unit] = {**base, **swaying}
    best = {}
    for (candidate, size, unit), errors in tried.items():
        if candidate not in best or distance(errors) < distance(best[candidate][1]):
            best[candidate] = f", {size:g} {unit}", errors
    chosen = {"none of these": ("", base), **best}
    result = Result(
        settings={
            **OVERRIDES,
            **mbbr_runs.EXPLAINED,
            "Q": "(6.28)",
            "sizes": "; ".join(
                f"{n}: {', '.join(map(str, s[1]))} {s[0]}" for n, s in {**FLOWN, **SEEN, name: (unit, sizes)}.items()
            ),
            "chosen size": "that whose errors come nearest to the whole column (least mean square of the logarithms)",
        }
    )
    for candidate, (size, errors) in chosen.items():
        line = candidate + size
        for condition, value in errors.items():
            column = condition_name(*condition)
            what = f"{line}: RMSE of θ, {column} (rad)"
            result.rows.append(
                Row(what, value, TABLE_6_1[condition][0], cell=("RMSE of θ of the EKF as flown (rad)", line, column))
            )
        result.rows.append(
            Row(
                f"{line}: factor off, mean",
                float(np.exp(distance(errors))),
                cell=("RMSE of θ of the EKF as flown (rad)", line, "factor off, mean"),
            )
        )
    right = {c: all(abs(v / TABLE_6_1[k][0] - 1.0) <= WITHIN for k, v in errors.items()) for c, (_, errors) in chosen.items()}
    others = {c: found for c, found in best.items() if c != MOTION[0]}
    rival = min(others, key=lambda c: distance(others[c][1]))
    rows = ", ".join(f"{condition_name(*c)} {value / TABLE_6_1[c][0]:.2f} times" for c, value in others[rival][1].items())
    result.claims = [
        Claim("without any of these the EKF as flown does not show the errors of spinning in place", not right["none of these"]),
        Claim(f"with {MOTION[0]} every row is within {100 * WITHIN:g} % of the published", right[MOTION[0]]),
        Claim("nothing else that was tried puts every row there", not any(value for c, value in right.items() if c != MOTION[0])),
    ]
    result.notes = [
        "The EKF that flew lacks the rotation of the ball's velocity (mip_rt/models/mbbr_yaw.py), so it errs where the robot turns and moves at once: the "
        "rows of driving while spinning come out without any imperfection. Spinning in place they need a robot that moves; that of the paper did "
        "(section 6.4.3). Its row at 0.5 Hz wants more motion than its row at 1 Hz; one value for both is a compromise.",
        f"The nearest of the others: {rival}{others[rival][0]}: {rows}. A mixture of it and of motion is possible, too; the paper's data would tell.",
    ]
    result.figures = [
        Figure(
            "dissertation-table-6.1-causes", "Table 6.1 by candidate, each at its best size", lambda f: _bars(f, chosen), (13, 6)
        )
    ]
    return result


EXPERIMENTS = [
    Experiment("dissertation-table-6.1-causes", "dissertation", (), "Table 6.1: which imperfection gives the row at 0.5 Hz", run),
]
