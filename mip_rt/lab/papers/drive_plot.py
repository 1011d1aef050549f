"""The eight panels of Figs 6.6 and 6.25 to 6.32: lean, heading, place and speed of a driving MBBR, estimated, true and wanted."""

import numpy as np

from mip_rt.lab.papers import mbbr_runs
from mip_rt.lab.papers.mbbr_runs import cameras, see, smooth

BEGIN_S = 2.0
LEAN_LIMITS, SPEED_LIMITS = (-0.2, 0.2), (-0.5, 0.5)


def wrapped(angle):
    """Within -pi and pi, with a gap where it jumps so that no line crosses the panel."""
    turned = np.mod(np.asarray(angle, float) + np.pi, 2.0 * np.pi) - np.pi
    turned[1:][np.abs(np.diff(turned)) > np.pi] = np.nan
    return turned


def draw_drive(figure, record, seed: int, label: str, beside: str = "", mocap: bool = True) -> None:
    """Fills the figure.

    Args:
        label: of the estimator in control.
        beside: of the first shadow, whose lean is shown as well; "" for none.
        mocap: against what simulated cameras see, as in an experiment, and with the speed smoothed as there; or against the truth of a simulation.
    """
    rows, truth, time_s = record.after(BEGIN_S)
    if len(rows) < 10:
        figure.text(0.5, 0.5, "it fell at once", ha="center")
        return
    r = mbbr_runs.RADIUS_M
    if mocap:
        (tilt, rate), name, even = cameras(truth, seed), "mocap (simulated)", smooth
    else:
        tilt, name, even = np.stack([truth["roll_rad"], truth["pitch_rad"]], axis=1), "actual", np.asarray
        rate = np.stack([truth["ball_rate_x_rad_s"], truth["ball_rate_y_rad_s"]], axis=1)
    ours = rows["estimates"][:, 0]
    turned = see(record, seed, BEGIN_S).estimates[record.names[0]][1]
    angle, velocity, yaw = rows["reference_angle_rad"], rows["reference_velocity_rad_s"], rows["reference_yaw_rad"]
    start = truth["x_m"][0] - r * angle[0, 1], truth["y_m"][0] + r * angle[0, 0]
    series = (
        ("θx (rad)", ours[:, 0], tilt[:, 0], None, LEAN_LIMITS),
        ("θy (rad)", ours[:, 1], tilt[:, 1], None, LEAN_LIMITS),
        ("ball position x (m)", start[0] + r * ours[:, 9], truth["x_m"], start[0] + r * angle[:, 1], (-0.5, 0.5)),
        ("ball position y (m)", start[1] - r * ours[:, 8], truth["y_m"], start[1] - r * angle[:, 0], (-0.5, 0.5)),
        ("ball velocity x (m/s)", even(r * turned[:, 1]), even(r * rate[:, 1]), r * velocity[:, 1], SPEED_LIMITS),
        ("ball velocity y (m/s)", even(-r * turned[:, 0]), even(-r * rate[:, 0]), -r * velocity[:, 0], SPEED_LIMITS),
        ("θz (rad)", wrapped(ours[:, 2]), wrapped(truth["yaw_rad"]), wrapped(yaw[:, 0]), (-5.0, 5.0)),
        ("dθz/dt (rad/s)", ours[:, 5], truth["yaw_rate_rad_s"], yaw[:, 1], (0.0, 8.0)),
    )
    panels = figure.subplots(4, 2, sharex=True)
    for axes, (unit, estimate, actual, wanted, limits) in zip(panels.flat, series):
        axes.plot(time_s, actual, "k", lw=1, label=name)
        axes.plot(time_s, estimate, "C0", lw=0.8, label=label)
        if wanted is not None:
            axes.plot(time_s, wanted, "C3--", lw=0.8, label="reference")
        low, high = axes.get_ylim()
        axes.set(ylabel=unit, ylim=(min(low, limits[0]), max(high, limits[1])))
        axes.grid(alpha=0.3)
    if beside:
        for axis in (0, 1):
            panels[0, axis].plot(time_s, rows["estimates"][:, 1, axis], "C2", lw=0.7, label=beside)
    for axes in panels[3]:
        axes.set_xlabel("Time (s)")
    lines, labels = panels[0, 0].get_legend_handles_labels()
    last = panels[1, 0].get_legend_handles_labels()
    figure.tight_layout(rect=(0, 0.04, 1, 1))
    figure.legend([*lines, last[0][-1]], [*labels, last[1][-1]], loc="lower center", ncol=4, fontsize=8, frameon=False)
