"""Dissertation 6.4.3 and 6.4.4: estimation errors against motion capture, driving and spinning in place."""

from mip_rt.lab.papers import mbbr_runs
from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.lab.papers.mbbr_runs import fly, see, spectrum

WITHIN = 0.3
# (drive m/s, yaw rate Hz): RMSE of theta in rad, of the ball speed in cm/s (Table 6.1)
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
SPINS = {
    0.0: "6.15",
    -1.5: "6.16",
    -1.0: "6.17",
    -0.75: "6.18",
    -0.5: "6.19",
    0.5: "6.20",
    0.75: "6.21",
    1.0: "6.22",
    1.5: "6.23",
}
SHADOWS = {"estimator.control": "dmp_ekf", "estimator.shadows": "[ekf, ekf_printed, kf, dmp_kf, momentum]"}


def _condition(speed, rate) -> str:
    moves = [f"translate {100 * speed:g} cm/s"] * (speed > 0) + [f"spin {rate:g} Hz"] * (rate > 0)
    return " & ".join(moves) or "idle"


def _draw_against(figure, seen, name, label):
    panels = figure.subplots(2, 2)
    tilt, rate = seen.estimates[name]
    for axis, letter in enumerate("xy"):
        for axes, ours, theirs, unit in (
            (panels[0, axis], tilt, seen.tilt_rad, f"θ{letter} (rad)"),
            (panels[1, axis], rate, seen.rate_rad_s, f"φ̇{letter} (rad/s)"),
        ):
            axes.plot(seen.time_s, theirs[:, axis], "0.6" if axes in panels[1] else "k", lw=0.8, label="mocap (simulated)")
            axes.plot(seen.time_s, ours[:, axis], "C0", lw=0.8, label=label)
            axes.set_ylabel(unit)
            axes.grid(alpha=0.3)
    for axes in panels[1]:
        axes.set_xlabel("Time (s)")
    panels[0, 0].legend(fontsize=8)
    figure.tight_layout()


def _draw_spectrum(figure, seen):
    axes = figure.add_subplot()
    for rate, label in ((seen.rate_rad_s, "mocap (simulated)"), (seen.estimates["ekf_printed"][1], "EKF (printed digits)")):
        axes.plot(*spectrum(rate[:, 0]), lw=1, label=label)
    axes.set(xlim=(0, 50), xlabel="Frequency (rad/s)", ylabel="FFT power of φ̇x (rad/s)²", yscale="log", ylim=(1e-2, None))
    axes.legend()
    axes.grid(alpha=0.3)


def table(seed: int, quick: bool, progress) -> Result:
    """Table 6.1 with Figs 6.9 to 6.13."""
    duration_s = 15.0 if quick else 40.0
    overrides = {**SHADOWS, "estimator.noise_set": "friction"}
    seen, fell = {}, False
    conditions = [(0.0, 0.0), (0.2, 0.0), (0.0, 0.5), (0.0, 1.0)] if quick else list(TABLE_6_1)
    for number, (speed, rate) in enumerate(conditions):
        progress(number, len(conditions))
        record = fly(rate, speed, overrides, duration_s, seed)
        fell |= record.fell
        seen[speed, rate] = see(record, seed)
    result = Result(settings={**overrides, **mbbr_runs.IMPERFECTIONS, **mbbr_runs.EXPLAINED, "Q": "(6.28)"})
    errors = {condition: found.errors("ekf_printed") for condition, found in seen.items()}
    for condition in conditions:
        tilt, speed = TABLE_6_1[condition]
        name = _condition(*condition)
        result.rows.append(Row(f"{name}: RMSE of θ, EKF as printed (rad)", errors[condition][0], tilt, WITHIN))
        result.rows.append(Row(f"{name}: RMSE of the ball speed, EKF as printed (cm/s)", errors[condition][1], speed, WITHIN))
        corrected = seen[condition].errors("ekf")
        result.rows.append(Row(f"{name}: RMSE of θ, corrected EKF (rad)", corrected[0]))
        result.rows.append(Row(f"{name}: RMSE of the ball speed, corrected EKF (cm/s)", corrected[1]))
        ours = seen[condition].errors("momentum")
        result.rows.append(Row(f"{name}: RMSE of θ, momentum observer (rad)", ours[0]))
        result.rows.append(Row(f"{name}: RMSE of the ball speed, momentum observer (cm/s)", ours[1]))
    result.claims = [
        Claim("the robot balances in all conditions", not fell),
        Claim(
            "tilt and speed errors grow with the yaw rate",
            all(errors[0.0, 0.0][k] < errors[0.0, 0.5][k] < errors[0.0, 1.0][k] for k in (0, 1)),
        ),
    ]
    result.notes = [
        "The robot here is controlled by DMP+EKF with the shipped gains: with the gains (6.29) of the preliminary "
        "experiment the corrected model diverges slowly "
        "(errata, section E). The EKF in question runs in shadow on the same samples.",
        f"Driving straight, the printed 410 (for 502 by the paper's own constants) bends the tilt by {errors[0.2, 0.0][0]:.2f} "
        "rad; with it corrected the EKF errs by "
        f"{seen[0.2, 0.0].errors('ekf')[0]:.3f} rad (published 0.031): the robot of the paper cannot have flown the printed digit.",
        "The imperfections are one set, calibrated at idle and at 1 Hz. In between the paper's tilt error is at 0.5 Hz already nearly what "
        "it is at 1 Hz, here it grows all the way, and no other direction or size of the crooked IMU that we tried gives both rows: "
        "what its robot had at 0.5 Hz the paper does not say.",
    ]
    if (0.1, 0.25) in seen:
        result.notes.append(
            f"At 10 cm/s and 0.25 Hz it is again the 410: {errors[0.1, 0.25][0]:.3f} rad, corrected {seen[0.1, 0.25].errors('ekf')[0]:.3f} (published 0.036)."
        )
    result.figures = [
        Figure(
            f"dissertation-fig-{number}",
            f"Fig. {number}: EKF (printed digits) against mocap, {_condition(*condition)}",
            lambda f, s=seen[condition]: _draw_against(f, s, "ekf_printed", "EKF (printed digits)"),
        )
        for condition, number in FIGURES.items()
        if condition in seen
    ] + [
        Figure(
            "dissertation-fig-6.13",
            "Fig. 6.13: spectrum of φ̇x, driving at 20 cm/s",
            lambda f: _draw_spectrum(f, seen[0.2, 0.0]),
            (8, 4.5),
        )
    ]
    return result


def _draw_rms(figure, errors):
    panels = figure.subplots(1, 2)
    rates = sorted(errors)
    for place, (axes, title) in enumerate(zip(panels, ("RMS error of θ (rad)", "RMS error of φ̇ (rad/s)"))):
        for name, label in mbbr_runs.ESTIMATORS.items():
            if place and name == "dmp_kf":
                continue
            scale = 0.01 / mbbr_runs.RADIUS_M if place else 1.0
            axes.plot(rates, [scale * errors[rate][name][place] for rate in rates], "o-", label=label)
        axes.set(xlabel="Yaw rate (Hz)", ylabel=title, ylim=(0, None))
        axes.grid(alpha=0.3)
    panels[0].legend()
    figure.tight_layout()


def _draw_spin(figure, seen):
    panels = figure.subplots(4, 2, sharex=True)
    window = (seen.time_s > seen.time_s[0] + 1.0) & (seen.time_s < seen.time_s[0] + 3.0)
    t = seen.time_s[window]
    for axis, letter in enumerate("xy"):
        names = (("ekf_printed", "EKF (printed)", "C0"), ("kf", "KF", "C1"), ("dmp_kf", "DMP", "C2"))
        panels[0, axis].plot(t, seen.tilt_rad[window, axis], "k", lw=1.2, label="mocap (simulated)")
        panels[1, axis].plot(t, seen.rate_rad_s[window, axis], "0.6", lw=0.8)
        for name, label, color in names:
            tilt, rate = seen.estimates[name]
            panels[0, axis].plot(t, tilt[window, axis], color, lw=1, label=label)
            panels[2, axis].plot(t, (tilt - seen.tilt_rad)[window, axis], color, lw=1)
            if name != "dmp_kf":
                panels[1, axis].plot(t, rate[window, axis], color, lw=1)
                panels[3, axis].plot(t, (rate - seen.rate_rad_s)[window, axis], color, lw=0.8)
        for axes, label in zip(
            panels[:, axis], (f"θ{letter} (rad)", f"φ̇{letter} (rad/s)", f"error θ{letter}", f"error φ̇{letter}")
        ):
            axes.set_ylabel(label)
            axes.grid(alpha=0.3)
        panels[3, axis].set_xlabel("Time (s)")
    panels[0, 0].legend(fontsize=7, ncol=2)
    figure.tight_layout()


def spin(seed: int, quick: bool, progress) -> Result:
    """Fig. 6.14 with Figs 6.15 to 6.23."""
    duration_s = 14.0 if quick else 40.0
    overrides = {**SHADOWS, "estimator.noise_set": "accuracy"}
    rates = (0.0, 1.0, 1.5) if quick else sorted(SPINS)
    seen, fell = {}, False
    for number, rate in enumerate(rates):
        progress(number, len(rates))
        record = fly(rate, 0.0, overrides, duration_s, seed)
        fell |= record.fell
        seen[rate] = see(record, seed)
    errors = {rate: {name: found.errors(name) for name in mbbr_runs.ESTIMATORS} for rate, found in seen.items()}
    result = Result(settings={**overrides, **mbbr_runs.IMPERFECTIONS, **mbbr_runs.EXPLAINED, "Q": "(6.30), KF (6.32)"})
    for rate, found in errors.items():
        for name, label in mbbr_runs.ESTIMATORS.items():
            result.rows.append(Row(f"{rate:g} Hz, {label}: RMS of θ (rad)", found[name][0]))
    fast = [rate for rate in errors if abs(rate) >= 1.0]
    result.claims = [
        Claim("the robot holds its place at every rate", not fell),
        Claim(
            "at 1 Hz and more the DMP is more accurate in θ than EKF and KF",
            all(errors[r]["dmp_kf"][0] < min(errors[r]["ekf_printed"][0], errors[r]["kf"][0]) for r in fast),
        ),
        Claim(
            "at 1 Hz and more the EKF as printed is more accurate in θ than the KF (published: significantly)",
            all(errors[r]["ekf_printed"][0] < errors[r]["kf"][0] for r in fast),
        ),
        Claim(
            "at 1 Hz and more the corrected EKF is more accurate in θ than the KF",
            all(errors[r]["ekf"][0] < errors[r]["kf"][0] for r in fast),
        ),
        Claim(
            "EKF and KF have almost the same error of φ̇ (within 20 %) at every rate",
            all(abs(f["ekf_printed"][1] - f["kf"][1]) < 0.2 * f["kf"][1] for f in errors.values()),
        ),
    ]
    best = all(f["momentum"][k] <= min(e[k] for n, e in f.items() if n != "momentum") for f in errors.values() for k in (0, 1))
    result.notes = [
        "Fig. 6.14 prints no numbers that could be read from the text; the claims are those of section 6.4.4.",
        f"Beyond the paper: the momentum observer {'is' if best else 'is not'} the most accurate in θ and φ̇ at every rate. What is left of its "
        "error is the cameras': alignment, noise and the marker centroid; against the truth see mip-rt bench beyond.",
    ]
    if result.claims[3].holds and not result.claims[2].holds:
        result.notes.append(
            "The printed digits lack the rotation of the ball's velocity and have 410 for 502, which matters the more the faster the robot turns: "
            "with them the EKF is worse than the KF. With both corrected the paper's sentence holds, so its EKF had other digits."
        )
    result.figures = [
        Figure("dissertation-fig-6.14", "Fig. 6.14: RMS estimation errors by yaw rate", lambda f: _draw_rms(f, errors), (10, 4.5))
    ] + [
        Figure(
            f"dissertation-fig-{SPINS[rate]}",
            f"Fig. {SPINS[rate]}: estimates against mocap and their errors at {rate:g} Hz",
            lambda f, s=seen[rate]: _draw_spin(f, s),
            (10, 8),
        )
        for rate in rates
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
    Experiment(
        "dissertation-fig-6.14",
        "dissertation",
        ("Fig. 6.14", *(f"Fig. {n}" for n in SPINS.values())),
        "EKF, KF and DMP against motion capture by yaw rate",
        spin,
    ),
]
