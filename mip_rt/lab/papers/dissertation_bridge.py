"""Dissertation 4.6: an eduMIP that balances with a braking bridge, with a coasting one, and with a coasting one that is compensated."""

import numpy as np

from mip_rt.config.scenario import Event
from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.lab.papers.runs import drive

FREQUENCIES_HZ = (500, 1000, 5000, 10000, 20000)
MODES = {"drive/brake": "brake", "drive/coast, compensated": "coast", "drive/coast, not compensated": "brake"}
COLORS = ("C0", "C2", "C3")


def variance(mode: str, frequency_hz: float, seed: int, duration_s: float) -> float:
    """Variance of the lean while the robot holds its place, rad^2; infinite where it fell."""
    overrides = {"motor.drive": MODES[mode], "motor.pwm_frequency_hz": frequency_hz, "estimator.shadows": "[]"}
    # The controller believes in a brake, the simulated bridge coasts.
    events = [Event(0.1, set={"brake": 0})] if mode.endswith("not compensated") else []
    record = drive("edumip", overrides, events, duration_s, seed)
    if record.fell:
        return np.inf
    return float(np.var(record.after(4.0)[1]["pitch_rad"]))


def run(seed: int, quick: bool, progress) -> Result:
    """Fig. 4.6."""
    duration_s, frequencies = (11.0, (1000, 20000)) if quick else (40.0, FREQUENCIES_HZ)
    found = {}
    for mode in MODES:
        for frequency in frequencies:
            progress(len(found), len(MODES) * len(frequencies))
            found[mode, frequency] = variance(mode, frequency, seed, duration_s)
    result = Result(settings={"robot": "shipped eduMIP: LQR, DMP+EKF, L 2.36 mH, friction and backlash", "duration": f"{duration_s:g} s of position hold",
                              "bridge": "averaged drive/coast equations (dissertation-tables-4.4-4.5 compares them with the switched circuit)"})  # fmt: skip
    for (mode, frequency), value in found.items():
        result.rows.append(Row(f"{mode}, {frequency} Hz: variance of θ (mrad²)", 1e6 * value))
    braking, compensated, plain = MODES
    high = [f for f in frequencies if f >= 5000]
    result.claims = [
        Claim("compensated, a coasting bridge balances about as well as a braking one (variance within a factor of 2) at every frequency",
              all(0.5 < found[compensated, f] / found[braking, f] < 2.0 for f in frequencies)),
        Claim("without compensation it is less stable at 5 kHz and above (at least 1.5 times the variance)", all(found[plain, f] > 1.5 * found[compensated, f] for f in high)),
        Claim("without compensation it gets worse with the PWM frequency", found[plain, frequencies[-1]] > found[plain, frequencies[0]]),
    ]  # fmt: skip

    def draw(figure):
        axes = figure.add_subplot()
        places = np.arange(len(frequencies))
        top = 1.3 * max(1e6 * v for v in found.values() if np.isfinite(v))
        for number, (mode, color) in enumerate(zip(MODES, COLORS)):
            values = [1e6 * found[mode, f] for f in frequencies]
            axes.bar(places + 0.26 * (number - 1), [v if np.isfinite(v) else top for v in values], 0.25, color=color, label=mode)
            for place, value in zip(places, values):
                if not np.isfinite(value):
                    axes.text(place + 0.26 * (number - 1), top, "fell", ha="center", va="bottom")
        axes.set(xticks=places, xticklabels=[str(f) for f in frequencies], xlabel="PWM frequency (Hz)", ylabel="Variance of θ (mrad²)")
        axes.legend()
        axes.grid(alpha=0.3, axis="y")

    result.figures = [Figure("dissertation-fig-4.6", "Fig. 4.6: variance of the lean by bridge and PWM frequency", draw, (8, 5))]
    result.notes = ["Published: compensation equals the brake everywhere but at 1000 Hz, where the authors suppose a limit cycle. No numbers are printed."]
    return result


EXPERIMENTS = [Experiment("dissertation-fig-4.6", "dissertation", ("Fig. 4.6",), "balancing variance: brake, coast, coast compensated", run)]
