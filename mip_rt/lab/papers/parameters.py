"""The parameter tables of both robots and of the motors: what ships, beside what the papers print, and what their printed equations make of it."""

import numpy as np

from mip_rt import config as configuration
from mip_rt.lab.papers.dissertation_motor import MOTORS
from mip_rt.lab.papers.experiment import Claim, Experiment, Result, Row
from mip_rt.models import mbbr, mbbr_yaw, mip, mip_yaw

EXACT, DIGITS = 1e-4, 0.03  # a parameter; a coefficient printed with two or three digits
# Table II (3.2), in the order of the paper: name, place in the configuration, value.
EDUMIP = (
    ("m_b (kg)", "body_mass_kg", 0.218),
    ("m_w (kg)", "wheel_mass_kg", 0.024),
    ("r (m)", "wheel_radius_m", 0.035),
    ("d (m)", "track_m", 0.070),
    ("l (m)", "com_height_m", 0.046),
    ("k1 (N m)", "torque_per_command_n_m", 0.12),
    ("k2 (N m s/rad)", "damping_n_m_s_rad", 0.003),
    ("I_b1, I_b2, I_b3 (kg m²)", "body_inertia_kg_m2", (5.91e-4, 2.99e-4, 2.91e-4)),
    ("I_w1, I_w2, I_w3 (kg m²)", "wheel_inertia_kg_m2", (6.42e-5, 7.48e-6, 7.48e-6)),
    ("g (m/s²)", "gravity_m_s2", 9.8),
)
MBBR = (
    ("m_t (kg)", "body_mass_kg", 0.55),
    ("m_b (kg)", "ball_mass_kg", 0.15),
    ("r (m)", "ball_radius_m", 0.032),
    ("r_w (m)", "wheel_radius_m", 0.0125),
    ("l (m)", "com_height_m", 0.1),
    ("I_t1, I_t2, I_t3 (kg m²)", "body_inertia_kg_m2", (2.42e-3, 2.42e-3, 0.79e-3)),
    ("I_b (kg m²)", "ball_inertia_kg_m2", 8.46e-5),
    ("I_w (kg m²)", "wheel_inertia_kg_m2", 1.2e-5),
    ("k1 (N m)", "torque_per_command_n_m", 0.176),
    ("k2 (r/r_w)² (N m s/rad)", "damping_n_m_s_rad", 0.011),
    ("g (m/s²)", "gravity_m_s2", 9.8),
)
MOTOR_TABLE = {1: (6.49, 0.362, 0.133), 2: (15.4, 0.0494, 0.161), 3: (9.06, 2.36, 0.127)}  # ohm, mH, N m/A


def _shipped(robot: str, table, title: str) -> list:
    model = configuration.load(configuration.default_path(robot), {}).model
    rows = []
    for name, key, published in table:
        values, papers = np.atleast_1d(getattr(model, key)), np.atleast_1d(published)
        symbols, _, unit = name.partition(" (")
        names = [f"{symbol} ({unit}" for symbol in symbols.split(", ")]
        for one, value, paper in zip(names, values, papers):
            rows.append(Row(f"{title}: {one}", float(value), float(paper), EXACT, 4))
    return rows


def _coefficients() -> list:
    """Rows of the printed linear models beside what the shipped equations make of the printed parameters."""
    dt = mip_yaw.PRINTED_DT_S
    exact, printed = (mip_yaw.coefficients(mip.parameters()[0], variant, lever_arm=False)[0] for variant in ("exact", "printed"))
    rows = []
    terms = ("θ", "φ̇", "θψ̇²", "u_x")
    for equation, field, scale in (
        ("ACC (46), a step", "tilt", dt),
        ("ACC (47), a step", "wheel", dt),
        ("ACC (52)", "accel", 1.0),
    ):
        for k, term in enumerate(terms):
            cell = ("Printed coefficients of the eduMIP's model", equation, term)
            rows.append(
                Row(
                    f"{equation}, {term}",
                    float(getattr(exact, field)[k]) * scale,
                    float(f"{getattr(printed, field)[k] * scale:.3g}"),
                    DIGITS,
                    cell=cell,
                )
            )
    exact, printed = (mbbr_yaw.coefficients(mbbr.parameters()[0], variant)[0] for variant in ("exact", "printed"))
    other = mbbr_yaw.coefficients(mbbr.printed_parameters()[0], "inertial-lagrange")[0]
    names = ("θ", "θ̇ − φ̇*", "u", "θ_other ż", "θ_other u_z", "θ̇_other ż", "φ̇*_other ż", "θ ż²")
    for equation, field in (("(5.32) f6", "tilt_x"), ("(5.32) f9", "ball_x")):
        for k, term in enumerate(names):
            paper = float(f"{getattr(printed, field)[k]:.3g}")
            for label, found, within in (("its own constants", other, DIGITS), ("Table 5.2", exact, None)):
                cell = ("Printed coefficients of the MBBR's model", f"{equation}, by {label}", term)
                value = float(getattr(found, field)[k])
                rows.append(Row(f"{equation}, {term}, by {label}", value, paper if within else None, within, cell=cell))
    return rows


def run(seed: int, quick: bool, progress) -> Result:
    """Tables II (3.2), 4.3 and 5.2."""
    shipped = _shipped("edumip", EDUMIP, "Table II, 3.2") + _shipped("mbbr", MBBR, "Table 5.2")
    for number, (resistance, inductance, k) in MOTOR_TABLE.items():
        ours = MOTORS[number]
        for name, value, paper in (
            ("R (Ω)", ours[0], resistance),
            ("L (mH)", 1e3 * ours[1], inductance),
            ("k (N m/A)", ours[2], k),
        ):
            shipped.append(Row(f"Table 4.3: motor {number}, {name}", value, paper, EXACT, 4))
    coefficients = _coefficients()
    wrong = [row.what for row in shipped if not row.agrees]
    return Result(
        rows=shipped + coefficients,
        claims=[
            Claim(
                "every shipped parameter of the robots is the published one",
                not any(not w.startswith("Table 4.3") for w in wrong),
            ),
            Claim(
                "the printed coefficients are those of the printed parameters (within 3 %)",
                all(row.agrees for row in coefficients if row.agrees is not None),
            ),
        ],
        notes=[
            "Motor 2's inductance is ten times the printed one: see dissertation-tables-4.4-4.5.",
            "The papers' θψ̇² and 410 are not what their equations give: the former miss the centripetal part of the wheel's acceleration or have it wrongly, the "
            "latter is 502 by the constants that all other digits of (5.32) fit (J_w of the wheel and not of the ball, K2 with friction), 404 by Table 5.2.",
            "f9's term of φ̇*_other ż, printed as almost nothing, is the rotation of the ball's velocity: what Table 6.1 suffers from.",
        ],
        settings={"shipped": "config/edumip.yaml, config/mbbr.yaml", "coefficients": "mip_rt/models/mip_yaw.py, mbbr_yaw.py"},
    )


EXPERIMENTS = [
    Experiment(
        "parameters",
        "dissertation",
        ("Table 3.2", "Table 4.3", "Table 5.2"),
        "what ships beside the printed parameters, and the printed coefficients",
        run,
        (("acc2018", "Table II"),),
    ),
]
