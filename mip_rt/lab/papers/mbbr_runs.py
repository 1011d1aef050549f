"""The MBBR's dry runs for dissertation chapter 6, with one set of imperfections, and the motion capture that judges them.

Everything that the dissertation does not state is here, once, for every table and figure.
"""

from dataclasses import dataclass

import numpy as np

from mip_rt.config.scenario import Event
from mip_rt.lab.papers.runs import DT_S, Record, drive, rms

RADIUS_M = 0.032
SETTLE_S = 3.0
SPUN_UP_S = 6.0

# Calibrated once, at the rows of Table 6.1 that EXPLAINED names, and used for every other number.
IMPERFECTIONS = {"dry_run.vibration_torque_n_m": 0.02}
# The floor of the later experiments (6.4.4 to 6.4.6): calibrated so that at 1.5 Hz the EKF loses its balance when the paper's did, after 8 s.
FLOOR = {"dry_run.rolling_resistance_n_m": 0.007}
ALIGNMENT_RAD, POSITION_NOISE_M, CENTROID_M, CAMERA_HZ = 0.016, 0.97e-3, 0.037, 120.0
EXPLAINED = {
    "roller vibration": "0.02 N m a wheel, 6.26 roller passages a radian of each wheel's share of the ball's turn (Fig. 6.24)",
    "camera alignment": f"{ALIGNMENT_RAD} rad a tilt axis: calibrated so that the idle tilt error comes near the published 0.017 rad",
    "camera noise": f"{1e3 * POSITION_NOISE_M:.3g} mm a sample at 120 Hz, differentiated by (6.25) with the missing 2: calibrated so "
    "that the idle speed error is the published 8.3 cm/s",
    "marker centroid": f"{100 * CENTROID_M:g} cm beside the ball's axis, which (6.24) takes for zero; its speed error grows with the "
    "yaw rate; calibrated so that the 1 Hz speed error comes near the published 19 cm/s",
    "everything else": "shipped MBBR (config/mbbr.yaml): sensor noise (6.23), friction (5.3), drive/coast bridges, battery, DMP lag and noise",
}
FLOOR_EXPLAINED = {
    "rolling resistance": f"{1e3 * FLOOR['dry_run.rolling_resistance_n_m']:g} mN m of the floor (and of the balls that support the ball), which damps: calibrated so that at 1.5 Hz and "
    "5 cm/s the EKF loses its balance when the paper's did (8 s; one value for sections 6.4.4 to 6.4.6). The earlier Table 6.1 comes out without it "
    "(dissertation-table-6.1-causes)",
}
ESTIMATORS = {
    "ekf_flown": "EKF as flown",
    "ekf_printed": "EKF, printed digits",
    "ekf": "EKF, corrected",
    "kf_printed": "KF",
    "kf": "KF, rotating",
    "dmp_kf": "DMP",
    "momentum": "momentum (ours)",
}
VARIANTS = (
    "EKF as flown: the digits of (5.32), (5.33) as the robot author's program has them, 502 for 410 and roll for pitch in h2; the rotation of the "
    "ball's velocity is missing in both. KF: the paper's linear model, which knows no spin."
)
# Tables 6.2 and 6.3 as printed; their rates are Hz.
TABLE_6_2 = {0.0: "table_6.2_0.00", 0.5: "table_6.2_0.50", 0.75: "table_6.2_0.75", 1.0: "table_6.2_1.00", 1.5: "table_6.2_1.50"}
TABLE_6_3 = {**TABLE_6_2, 1.0: "table_6.3_1.00"}


def gains(table: dict, frame: str = "inertial") -> dict:
    """Settings that fly a gain table: low-pass and outer loop in axes that stand still (corrected), or in "yaw" axes that turn with the robot (printed)."""
    slots = ", ".join(f"{{yaw_rate_hz: {rate}, set: {name}}}" for rate, name in table.items())
    return {"control.schedule": f"[{slots}]", "control.filter_frame": frame}


def _levels(rates_hz) -> str:
    buttons = ("none", "square", "triangle", "circle", "cross")
    rates = [0.0, *sorted({rate for rate in rates_hz if rate}, key=abs)]
    rates += [rate for rate in (3.1, 3.2, 3.3, 3.4)][: 5 - len(rates)]
    return "[" + ", ".join(f"{{button: {b}, yaw_rate_hz: {r}, drive_limit_m_s: 0.35}}" for b, r in zip(buttons, rates)) + "]"


def square(speed_m_s: float, begin_s: float, end_s: float, side_s: float = 4.0) -> list:
    """Events that drive a square."""
    sides = ((1, 0), (0, 1), (-1, 0), (0, -1))
    count = int((end_s - begin_s) / side_s)
    return [
        Event(begin_s + side_s * k, speed_m_s=[speed_m_s * sides[k % 4][0], speed_m_s * sides[k % 4][1]]) for k in range(count)
    ]


def fly(rate_hz: float, speed_m_s: float, overrides: dict, duration_s: float, seed: int) -> Record:
    """Spins and drives; the robot balances from 2.5 s, spins from 4 s and drives from 6 s."""
    events = [Event(4.0, yaw_rate_hz=rate_hz)] if rate_hz else []
    events += square(speed_m_s, 6.0, duration_s) if speed_m_s else []
    return drive("mbbr", {**IMPERFECTIONS, "remote.levels": _levels([rate_hz]), **overrides}, events, duration_s, seed)


def held_s(record: Record, rate_hz: float) -> float:
    """How long the robot did what it was to do: until it fell, or gave up its spin (the supervisor's spin-down), or the run ended."""
    if not len(record.time_s):
        return 0.0
    wanted = 2.0 * np.pi * rate_hz
    lost = (record.time_s > SPUN_UP_S) & (np.abs(record.truth["yaw_rate_rad_s"] - wanted) > 0.25 * abs(wanted) + 0.5)
    return float(record.time_s[np.argmax(lost)] if lost.any() else record.time_s[-1])


@dataclass
class Seen:
    """What the cameras saw and what the estimators said, inertial axes; (n, 2) each.

    Attributes:
        tilt_rad, rate_rad_s: by the cameras.
        estimates: {estimator: (tilt, rate)}.
    """

    time_s: np.ndarray
    tilt_rad: np.ndarray
    rate_rad_s: np.ndarray
    estimates: dict

    def errors(self, name: str) -> tuple:
        """(RMS tilt error in rad, RMS ball speed error in cm/s), per axis."""
        tilt, rate = self.estimates[name]
        return rms(tilt - self.tilt_rad), 100.0 * RADIUS_M * rms(rate - self.rate_rad_s)


def cameras(truth, seed: int):
    """(tilt (n, 2), ball rates (n, 2)) as motion capture gives them."""
    random = np.random.default_rng([seed, 6])
    tilt = np.stack([truth["roll_rad"], truth["pitch_rad"]], axis=1) + ALIGNMENT_RAD
    yaw, spin = truth["yaw_rad"], truth["yaw_rate_rad_s"]
    velocity = np.stack([truth["velocity_x_m_s"], truth["velocity_y_m_s"]], axis=1)
    velocity = velocity + CENTROID_M * spin[:, None] * np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
    place = POSITION_NOISE_M * random.normal(size=(int(len(truth) * DT_S * CAMERA_HZ) + 4, 2))
    noise = (place[2:] - place[:-2]) * CAMERA_HZ / 2.0
    sample = (np.arange(len(truth)) * DT_S * CAMERA_HZ).astype(int)
    velocity = velocity + noise[sample]
    return tilt, np.stack([-velocity[:, 1], velocity[:, 0]], axis=1) / RADIUS_M


def see(record: Record, seed: int, begin_s: float = SETTLE_S, end_s: float = np.inf) -> Seen:
    """Cameras and estimators side by side, after the robot has settled."""
    rows, truth, time_s = record.after(begin_s, end_s)
    tilt, rate = cameras(truth, seed)
    cosine, sine = np.cos(truth["yaw_rad"]), np.sin(truth["yaw_rad"])
    estimates = {}
    for slot, name in enumerate(record.names):
        e = rows["estimates"][:, slot]
        turned = np.stack([cosine * e[:, 6] - sine * e[:, 7], sine * e[:, 6] + cosine * e[:, 7]], axis=1)
        estimates[name] = e[:, :2], turned
    return Seen(time_s, tilt, rate, estimates)


def smooth(values, corner_rad_s: float = 10.0):
    """Zero-phase first-order low-pass: forward and backward in time, averaged (section 6.4.5)."""
    keep = np.exp(-corner_rad_s * DT_S)

    def once(x):
        y = np.empty_like(x)
        last = x[0]
        for k, value in enumerate(x):
            last = keep * last + (1.0 - keep) * value
            y[k] = last
        return y

    values = np.asarray(values, float)
    return 0.5 * (once(values) + once(values[::-1])[::-1])


def spectrum(values, segment_s: float | None = None):
    """(frequencies rad/s, power) of a signal, Hann window; with `segment_s` the mean over half-overlapping segments (Welch)."""
    n = min(len(values), round(segment_s / DT_S)) if segment_s else len(values)
    window = np.hanning(n)
    parts = [values[k : k + n] for k in range(0, len(values) - n + 1, max(1, n // 2))]
    power = np.mean([np.abs(np.fft.rfft((part - np.mean(part)) * window)) ** 2 for part in parts], axis=0) / np.sum(window**2)
    return 2.0 * np.pi * np.fft.rfftfreq(n, DT_S), power
