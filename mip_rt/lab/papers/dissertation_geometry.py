"""Dissertation chapter 2: omniwheel angles and the motor's torque against its speed."""

import math

import numpy as np

from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.models import omniwheels

PUBLISHED = {45: 35.237, 60: 48.186, 70: 52.082, 80: 54.145}
# The motor of (6.16) at its 12:1 gear, at the 7.4 V of Fig. 2.10.
RESISTANCE_OHM, CONSTANT_12, VOLTS = 3.385, 0.0742, 7.4
BALL_MM, WHEEL_MM = 32.0, 12.5
GEARS = (8, 12, 16, 24)
WANTED_N_M, WANTED_RPM = 0.06, 600.0


def table(seed: int, quick: bool, progress) -> Result:
    """Table 2.1: beta of orthogonal wheel axes in closed form."""
    result = Result(settings={"equation": "cos beta = 1 / (sqrt 3 sin alpha), from (2.3) to (2.5)"})
    worst = 0.0
    for alpha, published in PUBLISHED.items():
        beta = omniwheels.orthogonal_tilt(math.radians(alpha))
        result.rows.append(Row(f"β at α = {alpha}° (deg)", math.degrees(beta), published, 1e-3, 6))
        axes = omniwheels.wheel_axes(math.radians(alpha), beta)
        worst = max(worst, float(np.abs(axes.T @ axes - np.eye(3)).max()))
        printed = omniwheels.wheel_axes(math.radians(alpha), math.radians(published))
        result.rows.append(
            Row(
                f"largest cosine between axes with the printed β, α = {alpha}°",
                float(np.abs(printed.T @ printed - np.eye(3)).max()),
                digits=2,
            )
        )
    result.figures = [
        Figure(
            "dissertation-fig-2.9",
            "Fig. 2.9: placement of the wheels at α = 60°, β = 48.19°, to scale",
            lambda f: _draw_wheels(f, math.radians(60.0)),
            (10, 5),
        )
    ]
    result.claims = [Claim(f"the axes are orthogonal (largest cosine {worst:.1e})", worst < 1e-12)]
    result.notes = ["The printed angles, found by iteration, are off by up to 0.04 degrees from the closed form."]
    return result


def _line(gear):
    """(no-load speed in rpm, stall torque in N m) at the wheel."""
    k = CONSTANT_12 * gear / 12.0
    return VOLTS / k * 30.0 / math.pi, k * VOLTS / RESISTANCE_OHM


def motor(seed: int, quick: bool, progress) -> Result:
    """Fig. 2.10: torque against speed for gear ratios."""

    def torque_at(gear, rpm):
        free, stall = _line(gear)
        return stall * (1.0 - rpm / free)

    def draw(figure):
        axes = figure.add_subplot()
        for gear in GEARS:
            free, stall = _line(gear)
            axes.plot([0, free], [stall, 0], label=f"{gear}:1")
        axes.fill([0, WANTED_RPM, WANTED_RPM, 0], [0, 0, WANTED_N_M, WANTED_N_M], color="0.85", label="operating region")
        axes.set(xlabel="Motor speed (rpm)", ylabel="Motor torque (N·m)", xlim=(0, None), ylim=(0, None))
        axes.legend(title="Gear ratio")
        axes.grid(alpha=0.3)

    spare = {gear: torque_at(gear, WANTED_RPM) for gear in GEARS}
    return Result(
        rows=[
            Row("torque at 600 rpm, 12:1 (N m)", spare[12]),
            Row("stall torque at 12:1, 8 V (N m)", CONSTANT_12 * 8.0 / RESISTANCE_OHM, 0.176, 0.02),
        ],
        claims=[Claim("12:1 gives the 0.06 N m at 600 rpm that the text asks for", spare[12] >= WANTED_N_M)],
        figures=[Figure("dissertation-fig-2.10", "Fig. 2.10: torque against speed at 7.4 V", draw, (7, 5))],
        settings={
            "motor": "R 3.385 ohm, 0.0742 N m/A at 12:1 (6.16); constant scales with the gear; losses in the gear not modelled",
            "gear ratios": "12:1 is the text's; 8, 16 and 24 are ours, the figure's others are not in the text",
        },
    )


def _draw_wheels(figure, alpha_rad):
    """Ball, wheels and their axes: seen from the side and from above."""
    beta = omniwheels.orthogonal_tilt(alpha_rad)
    axes_of = omniwheels.wheel_axes(alpha_rad, beta).T
    turns = 2.0 * np.pi / 3.0 * np.arange(3)
    normals = np.stack(
        [np.sin(alpha_rad) * np.cos(turns), np.sin(alpha_rad) * np.sin(turns), np.full(3, np.cos(alpha_rad))], axis=1
    )
    around = np.linspace(0.0, 2.0 * np.pi, 80)
    for place, (first, second, title) in enumerate(((0, 2, "from the side"), (0, 1, "from above"))):
        panel = figure.add_subplot(1, 2, place + 1)
        panel.add_artist(_circle(BALL_MM))
        for number, (normal, axis) in enumerate(zip(normals, axes_of)):
            centre = (BALL_MM + WHEEL_MM) * normal
            rim = centre + WHEEL_MM * (np.cos(around)[:, None] * normal + np.sin(around)[:, None] * np.cross(axis, normal))
            panel.plot(rim[:, first], rim[:, second], f"C{number}", lw=2, label=f"wheel {number + 1}")
            tip = centre + 20.0 * axis
            panel.annotate(
                "",
                (tip[first], tip[second]),
                (centre[first], centre[second]),
                arrowprops={"arrowstyle": "->", "color": f"C{number}"},
            )
            panel.text(tip[first], tip[second], f"ŵ{number + 1}", color=f"C{number}")
        panel.set(
            aspect="equal", xlim=(-70, 70), ylim=(-70, 70), title=title, xlabel="x (mm)", ylabel=("z (mm)", "y (mm)")[place]
        )
        panel.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8, loc="lower left")
    figure.tight_layout()


def _circle(radius):
    from mip_rt import optional

    return optional.load("matplotlib.patches", "lab", "pictures").Circle((0, 0), radius, color="0.9")


EXPERIMENTS = [
    Experiment("dissertation-table-2.1", "dissertation", ("Table 2.1", "Fig. 2.9"), "orthogonal omniwheel orientations", table),
    Experiment("dissertation-fig-2.10", "dissertation", ("Fig. 2.10",), "motor torque against speed by gear ratio", motor),
]
