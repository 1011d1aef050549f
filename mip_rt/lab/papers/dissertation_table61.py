"""Dissertation 6.4.3: Table 6.1, the EKF's errors against motion capture while the robot drives and spins, with Figs 6.9 to 6.13."""

from mip_rt.lab.papers import mbbr_runs
from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.lab.papers.mbbr_runs import fly, see, spectrum

WITHIN = 0.3
# (drive m/s, yaw rate Hz): RMSE of theta in rad, of the ball speed in cm/s
TABLE_6_1 = {
    (0.0, 0.0): (0.017, 8.3),
    (0.2, 0.0): (0.031, 9.6),
    (0.0, 0.5): (0.056, 13.0),
    (0.0, 1.0): (0.065, 19.0),
    (0.1, 0.25): (0.036, 9.9),
    (0.1, 0.5): (0.057, 14.0),
    (0.05, 1.0): (0.077, 21.0),
}
FIGURES = {(0.2, 0.0): "6.9", (0.1, 0.25): "6.10", (0.1, 0.5): "6.11", (0.05, 1.0): "6.12"}
SHADOWS = {"estimator.control": "dmp_ekf", "estimator.shadows": "[ekf_flown, ekf_printed, ekf, momentum]"}
# How fast the paper's robot moved about while it was to spin in its place: with (6.29) it "struggles to balance and often can't maintain
# position". One value for both rows, between those that would give either exactly (dissertation-table-6.1-causes).
SWAY_M_S = 0.085
SHOWN = {
    "ekf_flown": "EKF as flown",
    "ekf_printed": "EKF, printed digits",
    "ekf": "EKF, corrected",
    "momentum": "momentum observer (ours)",
}


def condition_name(speed, rate) -> str:
    """In the words of the table."""
    moves = [f"translate {100 * speed:g} cm/s"] * (speed > 0) + [f"spin {rate:g} Hz"] * (rate > 0)
    return " & ".join(moves) or "idle"


def moved(speed, rate, sway_m_s: float = SWAY_M_S) -> float:
    """Drive rate of a row, m/s: a robot that spins in its place moves about."""
    return speed or (sway_m_s if rate else 0.0)


def _draw_against(figure, seen):
    panels = figure.subplots(2, 2, sharex=True)
    for axis, letter in enumerate("xy"):
        upper, lower = panels[:, axis]
        upper.plot(seen.time_s, seen.tilt_rad[:, axis], "k", lw=1, label="mocap (simulated)")
        lower.plot(seen.time_s, seen.rate_rad_s[:, axis], "0.6", lw=0.6, label="mocap (simulated)")
        for name, color in (("ekf_printed", "C3"), ("ekf_flown", "C0"), ("ekf", "C2")):
            tilt, rate = seen.estimates[name]
            upper.plot(seen.time_s, tilt[:, axis], color, lw=0.8, label=SHOWN[name])
            lower.plot(seen.time_s, rate[:, axis], color, lw=0.8)
        upper.set(ylabel=f"θ{letter} (rad)", ylim=(-0.3, 0.3))
        lower.set(ylabel=f"φ̇{letter} (rad/s)", xlabel="Time (s)", ylim=(-20, 20))
        for axes in (upper, lower):
            axes.grid(alpha=0.3)
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="lower center", ncol=4, fontsize=8, frameon=False)


def _draw_spectrum(figure, seen):
    axes = figure.add_subplot()
    for rate, label in ((seen.rate_rad_s, "mocap (simulated)"), (seen.estimates["ekf_flown"][1], "EKF as flown")):
        axes.plot(*spectrum(rate[:, 0], 8.0), lw=1, label=label)
    axes.axvspan(17, 22, color="0.9", label="published: strong response of the mocap")
    axes.set(xlim=(0, 50), xlabel="Frequency (rad/s)", ylabel="FFT power of φ̇x (rad/s)²", yscale="log", ylim=(1e-1, None))
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def table(seed: int, quick: bool, progress) -> Result:
    """Table 6.1 with Figs 6.9 to 6.13."""
    duration_s = 15.0 if quick else 40.0
    overrides = {**SHADOWS, "estimator.noise_set": "friction"}
    seen, fell = {}, False
    conditions = [(0.0, 0.0), (0.2, 0.0), (0.0, 0.5), (0.0, 1.0)] if quick else list(TABLE_6_1)
    for number, (speed, rate) in enumerate(conditions):
        progress(number, len(conditions))
        record = fly(rate, moved(speed, rate), overrides, duration_s, seed)
        fell |= record.fell
        seen[speed, rate] = see(record, seed)
    result = Result(
        settings={
            **overrides,
            **mbbr_runs.IMPERFECTIONS,
            **mbbr_runs.EXPLAINED,
            "Q": "(6.28)",
            "estimators": mbbr_runs.VARIANTS,
            "motion while it spins in its place": f"{100 * SWAY_M_S:g} cm/s around a square: calibrated between the rows of 0.5 and of 1 Hz (one value)",
            "gains": "shipped (set rec), on DMP+EKF: with (6.29) the model falls within seconds",
        }
    )
    errors = {name: {condition: found.errors(name) for condition, found in seen.items()} for name in SHOWN}
    for place, (title, unit) in enumerate((("Table 6.1: RMSE θ (rad)", "rad"), ("Table 6.1: RMSE φ̇ (cm/s)", "cm/s"))):
        for name, label in SHOWN.items():
            for condition in conditions:
                line = condition_name(*condition)
                published = TABLE_6_1[condition][place] if name == "ekf_flown" else None
                what = f"{line}: RMSE of {'the ball speed' if place else 'θ'}, {label} ({unit})"
                ours = errors[name][condition][place]
                result.rows.append(Row(what, ours, published, WITHIN if published else None, cell=(title, line, label)))
    flown = errors["ekf_flown"]
    result.claims = [
        Claim("the robot balances in all conditions", not fell),
        Claim(
            "tilt and speed errors grow with the yaw rate",
            all(flown[0.0, 0.0][k] < flown[0.0, 0.5][k] < flown[0.0, 1.0][k] for k in (0, 1)),
        ),
    ]
    result.notes = [
        f"Driving straight, the printed 410 (for 502 by the paper's own constants) bends the tilt by {errors['ekf_printed'][0.2, 0.0][0]:.2f} rad; with the "
        f"502 of the robot author's program the EKF errs by {flown[0.2, 0.0][0]:.3f} rad (published 0.031): the robot did not fly the printed digit.",
        "At every yaw rate the error comes from the rotation of the ball's velocity, which the paper's model lacks: it is as large as yaw rate times ball "
        "speed, and a robot that stands still while it spins has none. The published row of 0.5 Hz is nearly that of 0.5 Hz while it drives at 10 cm/s: "
        f"the robot moved as much when it was to spin in its place. {100 * SWAY_M_S:g} cm/s give both rows of spinning in place; other explanations, and "
        "why they fail: dissertation-table-6.1-causes.",
        f"Fig. 6.13: the published response at 17 to 22 rad/s is that of rollers, 4.4 passages a radian, under a ball that rolls at {100 * 17 / 4.4 * mbbr_runs.RADIUS_M:.0f} to "
        f"{100 * 22 / 4.4 * mbbr_runs.RADIUS_M:.0f} cm/s; at 20 cm/s it lies higher (dissertation-fig-6.24).",
        f"With the rotation in its model (EKF, corrected) the error at 1 Hz is {errors['ekf'][0.0, 1.0][0]:.3f} rad, of which "
        f"{mbbr_runs.ALIGNMENT_RAD} are the cameras' alignment.",
    ]
    result.figures = [
        Figure(
            f"dissertation-fig-{number}",
            f"Fig. {number}: EKF against mocap, {condition_name(*condition)}",
            lambda f, s=seen[condition]: _draw_against(f, s),
            (10, 6.5),
        )
        for condition, number in FIGURES.items()
        if condition in seen
    ] + [
        Figure(
            "dissertation-fig-6.13",
            "Fig. 6.13: spectrum of φ̇x, driving around a square at 20 cm/s (the paper does not say which run it shows)",
            lambda f: _draw_spectrum(f, seen[0.2, 0.0]),
            (8, 4.5),
        )
    ]
    return result


EXPERIMENTS = [
    Experiment(
        "dissertation-table-6.1",
        "dissertation",
        ("Table 6.1", *(f"Fig. {n}" for n in (*FIGURES.values(), "6.13"))),
        "EKF errors while driving and spinning",
        table,
    ),
]
