"""Dissertation 6.2 and 6.3.2: non-minimum phase, simulated driving while spinning."""

import numpy as np

from mip_rt.config import published
from mip_rt.config.scenario import Event
from mip_rt.lab.papers import mbbr_runs
from mip_rt.lab.papers.drive_plot import draw_drive
from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.lab.papers.runs import drive
from mip_rt.models import mbbr, mbbr_linear

DT_S = 0.005
BALANCES_S = 2.25  # a dry run is in its operator's hands before; times of Fig. 6.6 count from here


def _step_response(sign: float):
    """(t, ball place m, lean rad, lean reference rad) after a step of the velocity reference of 0.2 m/s at 0.2 s: linear plant, gains (6.22) corrected.

    Args:
        sign: of the outer loop (6.13).
    """
    from mip_rt.controllers.lqr import discretise

    A, B, _, _ = mbbr_linear.linear_matrices(mbbr.parameters()[0])
    A, B = discretise(A, B, DT_S)
    g = published.GAIN_SETS["simulation"]
    wanted_rate, t = 0.2 / mbbr_runs.RADIUS_M, DT_S * np.arange(600)
    x, lean, place_reference = np.zeros(8), 0.0, 0.0
    path, leans, references = np.zeros((3, len(t)))
    for k, now in enumerate(t):
        reference = -wanted_rate if now >= 0.2 else 0.0  # about x: rolls to the left, +y
        path[k], leans[k], references[k] = -mbbr_runs.RADIUS_M * x[2], x[0], lean
        error = reference - x[6]
        following = g["slc_pole"] * lean + sign * g["slc_gain"] * 0.000985 * error
        u = -(
            g["c1"] * (lean - x[0])
            + g["c2"] * (place_reference - x[2])
            + g["c3"] * (following - lean) / DT_S
            + g["c4"] * error
            - g["c3"] * x[4]
        )
        x = A @ x + B @ np.array([np.clip(u, -3.0, 3.0), 0.0])
        lean, place_reference = following, place_reference + DT_S * reference
    return t, path, leans, references


def non_minimum_phase(seed: int, quick: bool, progress) -> Result:
    """Fig. 6.3."""
    found = {"+ (corrected)": _step_response(1.0), "- (printed)": _step_response(-1.0)}
    t, path, lean, _ = found["+ (corrected)"]

    def draw(figure):
        upper, lower = figure.subplots(2, 1, sharex=True)
        for (name, (time_s, way, tilt, reference)), color in zip(found.items(), ("C0", "C3")):
            upper.plot(time_s, 100 * way, color, label=f"outer loop {name}")
            lower.plot(time_s, tilt, color, label=f"θ, outer loop {name}")
            lower.plot(time_s, reference, color, ls="--", lw=0.8, label="its reference")
        upper.plot(t, np.maximum(0.0, t - 0.2) * 20.0, "k:", label="reference")
        upper.set(ylabel="Ball position (cm)")
        lower.set(xlabel="Time (s)", ylabel="θ (rad)")
        for axes in (upper, lower):
            axes.legend(fontsize=8, loc="upper left")
            axes.grid(alpha=0.3)
        figure.tight_layout()

    back = -100.0 * path.min()
    return Result(
        rows=[
            Row("largest movement against the command (cm)", back),
            Row("place 2.8 s after the step (cm; reference 56)", 100 * path[-1]),
        ],
        claims=[
            Claim(
                "the ball first moves against the command, while the body leans into it",
                0.02 < back < 5.0 and abs(lean[np.argmin(path)]) > 1e-3,
            ),
            Claim("then it follows the velocity reference", abs(path[-1] - 0.56) < 0.15),
        ],
        figures=[Figure("dissertation-fig-6.3", "Fig. 6.3: non-minimum phase response to a velocity step", draw, (8, 6))],
        settings={
            "plant": "linear, Table 5.2, exact coefficients",
            "gains": "(6.22) with c2 = 0.2 and c4 = 0.12",
            "step": "0.2 m/s",
        },
        notes=["With the printed minus sign of (6.13) the lean reference points the wrong way."],
    )


def driving(seed: int, quick: bool, progress) -> Result:
    """Fig. 6.6: 1 Hz and 20 cm/s from 10 to 20 s on the EKF."""
    schedule = "[{{yaw_rate_hz: 0.0, set: {0}}}, {{yaw_rate_hz: 0.5, set: {0}}}, {{yaw_rate_hz: 0.75, set: {0}}}, {{yaw_rate_hz: 1.0, set: {0}}}, {{yaw_rate_hz: 1.5, set: {0}}}]"
    base = {
        "estimator.control": "ekf",
        "estimator.shadows": "[]",
        "estimator.noise_set": "simulation",
        "estimator.odometry": "filter",
        "motor.drive": "brake",
        "dry_run.vibration_torque_n_m": 0.0,
        "dry_run.vibration_accel_m_s2": 0.0,
    }
    begin, end, duration_s = (5.0, 10.0, 12.0) if quick else (10.0, 20.0, 25.0)
    events = [
        Event(BALANCES_S + begin, yaw_rate_hz=1.0, speed_m_s=[0.0, 0.2]),
        Event(BALANCES_S + end, yaw_rate_hz=0.0, speed_m_s=[0.0, 0.0]),
    ]
    sets, records = ("simulation", "rec", "simulation_printed"), {}
    for number, name in enumerate(sets):
        progress(number, len(sets))
        records[name] = drive("mbbr", {**base, "control.schedule": schedule.format(name)}, events, BALANCES_S + duration_s, seed)
    result = Result(
        settings={
            **base,
            "reference": f"1 Hz and 20 cm/s to the left (y) from {begin:g} to {end:g} s",
            "Q": "(6.21) for the filter; the plant has the sensors' noise, not Q (which would be violent)",
        }
    )
    r = mbbr_runs.RADIUS_M
    for name, record in records.items():
        result.rows.append(Row(f"gains {name}: balanced for (s)", float(record.time_s[-1]) if len(record.time_s) else 0.0))
    rows, truth, _ = records["simulation"].after(0.5)
    drift = np.hypot(r * rows["estimates"][:, 0, 9] - truth["x_m"], -r * rows["estimates"][:, 0, 8] - truth["y_m"])
    way = float(np.hypot(truth["x_m"][-1] - truth["x_m"][0], truth["y_m"][-1] - truth["y_m"][0]))
    result.rows += [
        Row("drift of the estimated position at the end (m)", float(drift[-1])),
        Row("way driven (m)", way, 0.2 * (end - begin), 0.3),
    ]
    result.claims = [
        Claim(
            "with c2 = 0.2 and c4 = 0.12 the robot spins at 1 Hz and drives at 20 cm/s on the EKF", not records["simulation"].fell
        ),
        Claim("the estimated position drifts away slowly (published: visible over 10 s)", 0.005 < drift[-1] < 1.0),
        Claim("with the printed gains (6.22) the robot falls at once", records["simulation_printed"].fell),
    ]
    result.figures = [
        Figure(
            "dissertation-fig-6.6",
            "Fig. 6.6: simulated, 1 Hz and 20 cm/s",
            lambda f: draw_drive(f, records["simulation"], seed, "EKF", mocap=False),
            (11, 9),
        )
    ]
    return result


EXPERIMENTS = [
    Experiment("dissertation-fig-6.3", "dissertation", ("Fig. 6.3",), "non-minimum phase response", non_minimum_phase),
    Experiment("dissertation-fig-6.6", "dissertation", ("Fig. 6.6",), "simulated spinning and driving on the EKF", driving),
]
