"""Beyond the papers: the momentum observer against the papers' estimators and other ideas, on robots that differ from their model in everything.

Each draw is one robot: masses, inertias, height, friction and motor constant 10 % off in a random direction, torques of up to 0.1 in u that nobody
commanded, a crooked and displaced IMU whose gyro drifts, backlash, roller vibration and ripple, rolling resistance, delay. All estimators see the
same samples of the same run, which the shipped estimator controls; then the momentum observer controls the same robots alone. The draws are not
those on which it was tuned.
"""

import numpy as np

from mip_rt import config as configuration
from mip_rt.lab import batch, beyond_ekf, beyond_momentum
from mip_rt.lab.papers import mbbr_runs
from mip_rt.lab.papers.runs import rms
from mip_rt.robots.mbbr_judge import Judge

SEED, DRAWS = 2020, 20
RATES_HZ = (0.0, 0.5, 0.75, 1.0, 1.5)
SPEED_M_S, DURATION_S = 0.2, 30.0
ALONE = ((2.0, 0.0), (1.5, 0.2))  # yaw rate Hz, drive m/s
ALONE_S = 62.5  # it balances from 2.5 s on
CANDIDATES = {
    "no model, DMP lean": beyond_ekf.kinematic,
    "ekf, torque noise": beyond_ekf.torque_noise,
    "ekf, torque and bias states": beyond_ekf.torque_states,
    "momentum, scales not learned": beyond_momentum.unlearned,
    "momentum and DMP lean": beyond_momentum.with_dmp,
    "momentum and accelerometer": beyond_momentum.with_accelerometer,
    "momentum, unscented": beyond_momentum.unscented,
}
OURS, SHIPPED = "momentum", ("dmp_ekf", "dmp_kf", "ekf", "ekf_printed", "kf")


def draw(index: int) -> dict:
    """One robot: settings of the dry run."""
    random = np.random.default_rng([SEED, index])

    def listed(values):
        return f"[{', '.join(f'{value:.6f}' for value in values)}]"

    heading, size = random.uniform(0.0, 2.0 * np.pi), random.uniform(0.0, 0.1)
    errors = ("mass", "inertia", "com_height", "friction", "motor")
    return {
        **{f"dry_run.model_error.{name}": f"{1.0 + 0.1 * random.choice((-1, 1)):.1f}" for name in errors},
        "dry_run.input_error": listed((size * np.cos(heading), size * np.sin(heading), 0.0)),
        "dry_run.imu_misalignment_rad": listed((*(0.0075 * random.choice((-1, 1), 2)), 0.0)),
        "dry_run.imu_position_error_m": listed(random.uniform(-0.01, 0.01, 3)),
        "dry_run.gyro_drift_rad_s2": listed(random.uniform(-2e-4, 2e-4, 3)),
        "dry_run.backlash_rad": f"{random.uniform(0.0, 0.01):.5f}",
        "dry_run.vibration_torque_n_m": "0.02",
        "dry_run.rollers_per_ball_turn": f"{random.uniform(4.2, 6.3):.3f}",
        "dry_run.roller_ripple_rad": f"{random.uniform(0.0, 0.003):.5f}",
        "dry_run.rolling_resistance_n_m": f"{random.uniform(0.0, 0.002):.5f}",
        "dry_run.extra_delay_ticks": str(random.integers(0, 2)),
    }


def follow(job: tuple) -> dict:
    """{estimator or candidate: (mean squared error of the lean, of the ball rate)}, per axis, of job (draw, yaw rate Hz)."""
    index, rate_hz = job
    overrides = {**draw(index), "estimator.control": SHIPPED[0], "estimator.shadows": f"[{', '.join((OURS, *SHIPPED[1:]))}]"}
    record = mbbr_runs.fly(rate_hz, SPEED_M_S, overrides, DURATION_S, index + 1)
    if record.fell:
        return {}
    config = configuration.load(configuration.default_path("mbbr"), {})
    found = {name: record.rows["estimates"][:, record.slot(name), :8] for name in record.names}
    found |= {name: candidate(record.rows, config) for name, candidate in CANDIDATES.items()}
    chosen = record.time_s >= mbbr_runs.SETTLE_S
    lean, rate = Judge.squared_errors(np.stack(list(found.values()), axis=1)[chosen], record.truth[chosen])
    return dict(zip(found, zip(lean.mean(axis=0).tolist(), rate.mean(axis=0).tolist())))


def alone(job: tuple) -> dict:
    """How the momentum observer holds a robot by itself, job (draw, (yaw rate Hz, drive m/s))."""
    index, (rate_hz, speed_m_s) = job
    record = mbbr_runs.fly(rate_hz, speed_m_s, {**draw(index), "estimator.control": OURS, "estimator.shadows": "[]"}, ALONE_S, index + 1)
    judge = Judge(configuration.load(configuration.default_path("mbbr"), {}))
    late = record.time_s >= mbbr_runs.SETTLE_S
    return {
        "fell": bool(record.fell or record.time_s[-1] < ALONE_S - 3.0),
        "lean_max_rad": float(judge.tilt(record.truth[late]).max()),
        "position_rms_m": rms(judge.position_error(record.rows, record.truth)[late]),
        "yaw_rate_hz": float(record.truth["yaw_rate_rad_s"][late].mean() / (2.0 * np.pi)),
    }


def run(quick: bool, cluster=None, workers=None) -> dict:
    """Everything: {"errors": {rate: {name: (lean rad, ball rate rad/s)}}, "margins": {rate: (lean, ball rate)}, "alone": ...}.

    A margin is the worst of all draws: our error as a share of the best shipped one's in the same run.
    """
    draws = range(3 if quick else DRAWS)
    jobs = [(index, rate) for index in draws for rate in RATES_HZ]
    followed = dict(zip(jobs, batch.results(follow, jobs, "runs", cluster, workers)))
    lone = [(index, condition) for index in draws for condition in ALONE]
    held = dict(zip(lone, batch.results(alone, lone, "runs", cluster, workers)))
    errors, margins = {}, {}
    for rate in RATES_HZ:
        runs = [followed[index, rate] for index in draws if followed[index, rate]]
        errors[rate] = {name: tuple(np.sqrt(np.mean([r[name] for r in runs], axis=0)).tolist()) for name in runs[0]}
        shares = [[np.sqrt(r[OURS][k] / min(r[name][k] for name in SHIPPED)) for k in (0, 1)] for r in runs]
        margins[rate] = tuple(np.max(shares, axis=0).tolist())
    found = {
        f"{rate:g} Hz, {speed:g} m/s": {
            "fell": sum(held[index, (rate, speed)]["fell"] for index in draws),
            **{
                key: max(held[index, (rate, speed)][key] for index in draws)
                for key in ("lean_max_rad", "position_rms_m", "yaw_rate_hz")
            },
        }
        for rate, speed in ALONE
    }
    return {"draws": len(draws), "fell": sum(not r for r in followed.values()), "errors": errors, "margins": margins, "alone": found}


def passed(found: dict) -> bool:
    """In every draw and at every rate our lean is the better one and our ball rate better by at least 30 %, and no robot falls."""
    better = all(lean < 1.0 and rate <= 0.7 for lean, rate in found["margins"].values())
    return better and not any(result["fell"] for result in found["alone"].values())


def render(found: dict) -> str:
    """Markdown: errors by estimator and yaw rate, mrad / rad/s, RMS per axis; then what the robot does alone."""
    names = list(next(iter(found["errors"].values())))
    lines = [f"{found['draws']} draws, squares at {SPEED_M_S:g} m/s; lean in mrad / ball rate in rad/s, RMS per axis", ""]
    lines += ["| | " + " | ".join(f"{rate:g} Hz" for rate in found["errors"]) + " |", "|---|" + "---|" * len(found["errors"])]
    for name in [OURS, *(n for n in names if n != OURS)]:
        cells = [f"{1e3 * row[name][0]:.2g} / {row[name][1]:.2g}" for row in found["errors"].values()]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    cells = [f"{100 * lean:.0f} % / {100 * rate:.0f} %" for lean, rate in found["margins"].values()]
    lines += [f"| `{OURS}` against the best of the five shipped, worst draw | " + " | ".join(cells) + " |", ""]
    for condition, result in found["alone"].items():
        lines.append(
            f"{OURS} in control, {condition}, {ALONE_S - 2.5:g} s: {result['fell']} of {found['draws']} fell, lean at most "
            f"{np.degrees(result['lean_max_rad']):.1f} degrees, position error at most {100 * result['position_rms_m']:.1f} cm RMS"
        )
    if found["fell"]:
        lines.append(f"{found['fell']} runs with {SHIPPED[0]} in control fell and are left out")
    return "\n".join(lines)
