"""The report on Lee and Jung, Fig. 6: complementary filter against Kalman filter, at rest and in motion.

The report says that the Kalman filter is steadier and more accurate, prints no numbers, and gives neither gains nor noise: those here are an MPU6050's.
"""

import numpy as np

from mip_rt.estimators import complementary, complementary_kf
from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.lab.papers.runs import rms

DT_S = 0.01
ALPHAS = (0.98, 0.99)  # (58): "typically 0.98 to 0.99"
GYRO_NOISE_RAD_S, ACCEL_NOISE_M_S2 = 0.0009, 0.04  # MPU6050 datasheet: 0.005 deg/s/rtHz, 400 ug/rtHz, over 100 Hz
GYRO_BIAS_RAD_S = 0.02  # of the datasheet's +-20 deg/s, what a start-up calibration leaves after warming up
VIBRATION_M_S2 = 0.5  # TT motors with plastic gears, in motion; standard deviation
GRAVITY_M_S2 = 9.81
KALMAN = (1e-6, 1e-10)  # Q of angle and bias a step


def scene(moving: bool, seed: int, duration_s: float):
    """(t, true angle, gyro, accelerometer tilt): at rest at 5 deg, or swaying by 10 deg while the robot accelerates to and fro."""
    random = np.random.default_rng([seed, int(moving)])
    t = DT_S * np.arange(int(duration_s / DT_S))
    angle, rate, push = np.full_like(t, np.radians(5.0)), np.zeros_like(t), np.zeros_like(t)
    if moving:
        angle, rate = np.radians(10.0) * np.sin(1.5 * t), np.radians(15.0) * np.cos(1.5 * t)
        push = 0.5 * np.sin(4.0 * t) + VIBRATION_M_S2 * random.normal(size=len(t))
    gyro = rate + GYRO_BIAS_RAD_S + GYRO_NOISE_RAD_S * random.normal(size=len(t))
    noise = ACCEL_NOISE_M_S2 * random.normal(size=(2, len(t)))
    tilt = np.arctan2(
        GRAVITY_M_S2 * np.sin(angle) + push * np.cos(angle) + noise[0],
        GRAVITY_M_S2 * np.cos(angle) - push * np.sin(angle) + noise[1],
    )
    return t, angle, gyro, tilt


def complementary_angle(alpha, gyro, tilt) -> np.ndarray:
    """(n,) (58) with alpha (angle + rate dt) + (1 - alpha) tilt."""
    p = np.zeros(1, complementary.PARAMETERS).view(np.recarray)[0]
    p.pole, p.dt_s = alpha, DT_S
    state, out = complementary.init(p, [tilt[0]]), np.empty(len(gyro))
    for k in range(len(gyro)):
        complementary.step(p, state, gyro[k : k + 1], tilt[k : k + 1], complementary.ALL_VALID)
        out[k] = state.x[0]
    return out


def kalman_angle(gyro, tilt, measurement: float, bias: bool = True) -> np.ndarray:
    """(n,) angle by the Kalman filter; without `bias` it is the report's: angle alone, the gyro as its rate."""
    p = np.zeros(1, complementary_kf.PARAMETERS).view(np.recarray)[0]
    p.noise.Q[:2], p.noise.R[:1] = (KALMAN[0], KALMAN[1] if bias else 0.0), [measurement]
    p.noise.P_limit[:], p.noise.gate_squared, p.noise.dt_s = 10.0, 1e18, DT_S
    state, out = complementary_kf.init(p, [tilt[0], 0.0], [1e-2, 1e-4 if bias else 1e-30]), np.empty(len(gyro))
    for k in range(len(gyro)):
        complementary_kf.step(p, state, gyro[k : k + 1], tilt[k : k + 1], complementary_kf.ALL_VALID)
        out[k] = state.x[0]
    return out


def run(seed: int, quick: bool, progress) -> Result:
    """Fig. 6, static and dynamic."""
    duration_s = 60.0 if quick else 120.0
    result = Result(
        settings={
            "sensors": f"MPU6050: {GYRO_NOISE_RAD_S} rad/s and {ACCEL_NOISE_M_S2} m/s² a sample (datasheet), bias {GYRO_BIAS_RAD_S} "
            "rad/s (datasheet, after calibration)",
            "motion": f"10 deg at 1.5 rad/s, 0.5 m/s² at 4 rad/s, vibration {VIBRATION_M_S2} m/s² (ours)",
            "rate": "100 Hz",
            "Kalman": f"Q {KALMAN}, R 1e-2 rad² (vibration included); the same in both scenes",
        }
    )
    curves, error = {}, {}
    for moving in (False, True):
        t, angle, gyro, tilt = scene(moving, seed, duration_s)
        found = {f"complementary, α = {alpha:g}": complementary_angle(alpha, gyro, tilt) for alpha in ALPHAS}
        found["Kalman, angle and bias"] = kalman_angle(gyro, tilt, 1e-2)
        found["Kalman, angle alone"] = kalman_angle(gyro, tilt, 1e-2, False)
        found["gyro integrated"] = tilt[0] + np.cumsum(gyro) * DT_S
        curves[moving] = t, angle, tilt, found
        late = t > duration_s / 2.0
        for name, value in found.items():
            difference = np.degrees(value - angle)[late]
            error[moving, name] = rms(difference), float(np.std(difference))
            where = "in motion" if moving else "at rest"
            for place, kind in enumerate(("RMS error", "shakiness, standard deviation of the error")):
                cell = (f"{kind[0].upper()}{kind[1:]} (deg)", name, where)
                result.rows.append(Row(f"{where}, {name}: {kind} (deg)", error[moving, name][place], digits=3, cell=cell))
    kalman, plain = "Kalman, angle and bias", [f"complementary, α = {a:g}" for a in ALPHAS]
    result.claims = [
        Claim(
            "at rest the Kalman filter is more accurate than the complementary filter at either α",
            all(error[False, kalman][0] < error[False, p][0] for p in plain),
        ),
        Claim("in motion the Kalman filter is more accurate", all(error[True, kalman][0] < error[True, p][0] for p in plain)),
        Claim("in motion the Kalman filter is less shaky", all(error[True, kalman][1] < error[True, p][1] for p in plain)),
        Claim("the integrated gyro drifts by more than 30 deg", error[False, "gyro integrated"][0] > 30.0),
    ]
    alone = error[False, "Kalman, angle alone"][0]
    result.notes = [
        "What makes the Kalman filter better is the estimated bias: with the angle as its only state (as the report "
        f"describes it) it errs by {alone:.1f} deg at rest, "
        f"{'more' if alone > error[False, plain[0]][0] else 'less'} than the complementary filter ({error[False, plain[0]][0]:.2f} "
        "deg): it then is one, with a gain that settles.",
        "In motion every filter shakes with the acceleration, which the accelerometer takes for a lean; how much is a matter of how long it "
        f"averages. The Kalman filter shakes less than the complementary filter at α = 0.98 ({error[True, kalman][1]:.2f} against "
        f"{error[True, plain[0]][1]:.2f} deg), and as much as at α = 0.99 ({error[True, plain[1]][1]:.2f} deg), which averages as long.",
    ]

    def draw(figure):
        panels = figure.subplots(2, 2)
        for line, moving in enumerate((False, True)):
            t, angle, tilt, found = curves[moving]
            left, right = panels[line]
            part = t > duration_s - 10.0
            left.plot(t[part], np.degrees(tilt[part]), "0.8", lw=0.6, label="accelerometer")
            for name, color in ((plain[0], "C1"), ("Kalman, angle alone", "C4"), (kalman, "C0")):
                left.plot(t[part], np.degrees(found[name][part]), color, lw=1, label=name)
                right.plot(t, np.degrees(found[name] - angle), color, lw=0.8, label=name)
            left.plot(t[part], np.degrees(angle[part]), "k", lw=1, label="actual")
            left.set(ylabel="Angle (deg)", title="in motion" if moving else "at rest")
            right.set(ylabel="Error (deg)", ylim=(-6, 6), title=("in motion" if moving else "at rest") + ", error")
            for axes in (left, right):
                axes.grid(alpha=0.3)
                axes.set_xlabel("Time (s)")
        figure.tight_layout(rect=(0, 0.04, 1, 1))
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="lower center", ncol=5, fontsize=8, frameon=False)

    result.figures = [Figure("lee-jung-fig-6", "Fig. 6: complementary against Kalman filter", draw, (11, 7))]
    return result


EXPERIMENTS = [
    Experiment("lee-jung-fig-6", "lee-jung", ("Fig. 6",), "complementary against Kalman filter, static and dynamic", run)
]
