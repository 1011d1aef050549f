"""Dissertation 4.6: an eduMIP that balances with a braking bridge, with a coasting one, and with a coasting one that is compensated."""

import numpy as np

from mip_rt.config.scenario import Event
from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.lab.papers.runs import drive
from mip_rt.models import motor, switched_bridge

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
    result = Result(
        settings={
            "robot": "shipped eduMIP: LQR, DMP+EKF, L 2.36 mH, friction and backlash",
            "duration": f"{duration_s:g} s of position hold",
            "bridge": "averaged drive/coast equations (dissertation-tables-4.4-4.5 compares them with the switched circuit)",
        }
    )
    for (mode, frequency), value in found.items():
        what = f"{mode}, {frequency} Hz: variance of θ (mrad²)"
        result.rows.append(Row(what, 1e6 * value, cell=("Variance of θ (mrad²)", mode, f"{frequency} Hz")))
    braking, compensated, plain = MODES
    high = [f for f in frequencies if f >= 5000]
    result.claims = [
        Claim(
            "compensated, a coasting bridge balances about as well as a braking one (variance within a factor of 2) at every frequency",
            all(0.5 < found[compensated, f] / found[braking, f] < 2.0 for f in frequencies),
        ),
        Claim(
            "without compensation it is less stable at 5 kHz and above (at least 1.5 times the variance)",
            all(found[plain, f] > 1.5 * found[compensated, f] for f in high),
        ),
        Claim(
            "without compensation it gets worse with the PWM frequency",
            found[plain, frequencies[-1]] > found[plain, frequencies[0]],
        ),
    ]

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
        axes.set(
            xticks=places, xticklabels=[str(f) for f in frequencies], xlabel="PWM frequency (Hz)", ylabel="Variance of θ (mrad²)"
        )
        axes.legend()
        axes.grid(alpha=0.3, axis="y")

    result.figures = [Figure("dissertation-fig-4.6", "Fig. 4.6: variance of the lean by bridge and PWM frequency", draw, (8, 5))]
    result.notes = [
        "Published: compensation equals the brake everywhere but at 1000 Hz, where the authors suppose a limit cycle. No numbers are printed."
    ]
    return result


CASES = {
    "the current flows on, i(t0) ≠ 0": (0.75, 0.2),
    "the current dies, i(t0) = 0": (0.35, 0.2),
}  # duty, speed over no-load speed
PERIOD_T_R = 0.5


def waveform(u: float, omega_r: float, t_r: float, samples: int = 400):
    """(share of the period, current / i_s) of a periodic drive/coast pulse, sampled from the event-exact phases."""
    start = 0.0
    for _ in range(200):
        _, start = switched_bridge.period(start, u, omega_r, t_r, 0.0, 0)
    share, out = np.linspace(0.0, 1.0, samples), np.empty(samples)
    target = 1.0 - omega_r
    top = target + (start - target) * np.exp(-u * t_r)
    for k, part in enumerate(share):
        if part <= u:
            out[k] = target + (start - target) * np.exp(-part * t_r)
        else:
            out[k] = switched_bridge.coast_phase(top, omega_r, (part - u) * t_r, 0.0)[1]
    return share, out


def pulse(seed: int, quick: bool, progress) -> Result:
    """Fig. 4.2: current and PWM over one period."""
    result = Result(
        settings={"period": f"{PERIOD_T_R} electrical time constants", "speed": "0.2 of the no-load speed", "diodes": "no drop"}
    )
    curves, closed = {}, {}
    for name, (u, omega) in CASES.items():
        curves[name] = share, current = waveform(u, omega, PERIOD_T_R)
        mean = float(np.sum(0.5 * (current[1:] + current[:-1]) * np.diff(share)))
        closed[name] = mean, motor.coast_current(u, omega, PERIOD_T_R)
        result.rows.append(Row(f"{name}: mean of the sampled current (i/i_s)", mean, digits=5))
        result.rows.append(Row(f"{name}: mean by the closed form (4.29), (4.30)", closed[name][1], digits=5))
    on, dead = (curves[name][1] for name in CASES)
    result.claims = [
        Claim(
            "in the first case the current never dies, in the second it does before the period ends",
            bool(on.min() > 0.0 and dead[-1] == 0.0),
        ),
        Claim(
            "the closed form of the mean current agrees with the curve to 1e-3",
            all(abs(a / b - 1.0) < 1e-3 for a, b in closed.values()),
        ),
    ]

    def draw(figure):
        for place, (name, (share, current)) in enumerate(curves.items()):
            axes = figure.add_subplot(1, 2, place + 1)
            axes.plot(share, current, label="i / i_s")
            axes.plot(share, 0.1 * (share < CASES[name][0]) - 0.2, "0.4", drawstyle="steps-post", label="PWM (offset)")
            axes.set(xlabel="t / T", ylabel="i / i_s", title=name)
            axes.grid(alpha=0.3)
            axes.legend(fontsize=8)
        figure.tight_layout()

    result.figures = [Figure("dissertation-fig-4.2", "Fig. 4.2: current and PWM during one period", draw, (9, 4))]
    return result


EXPERIMENTS = [
    Experiment("dissertation-fig-4.2", "dissertation", ("Fig. 4.2",), "current during one PWM period", pulse),
    Experiment("dissertation-fig-4.6", "dissertation", ("Fig. 4.6",), "balancing variance: brake, coast, coast compensated", run),
]
