"""Dissertation 5.3: the ball's friction identified from a flywheel that the robot turns."""

import numpy as np

from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.models import friction, mbbr

COULOMB_N_M, VISCOUS_N_M_S = 0.05265, 0.001056
DT_S, DURATION_S, SUBSTEPS = 0.005, 20.0, 10
AMPLITUDE, LOW_HZ, HIGH_HZ = 3.0, 0.1, 2.0
# Not stated in the dissertation: a flywheel that the chirp turns back and forth at some ten turns a second.
FLYWHEEL_RADIUS_M, FLYWHEEL_KG_M2 = 0.06, 6e-3
STICTION, STICTION_RATE_RAD_S = 2.0, 2.0  # static friction beyond Coulomb's, and where it has died away
COUNTS = 1080 * 0.032 / 0.0125  # encoder counts a turn of the ball
TORQUE_NOISE = 0.05  # of a full command, standard deviation a sample: motors that are not alike
# Torque that comes and goes as the rollers hand over, passages a radian of the ball (Fig. 6.24); its size is calibrated to the published R^2.
RIPPLE_N_M, PASSAGES = 0.115, 4.35


def flywheel(seed: int, duration_s: float):
    """(t, command, measured flywheel angle rad): sine sweep up and down."""
    p = mbbr.parameters()[0]
    ratio = FLYWHEEL_RADIUS_M / p.ball_radius_m  # flywheel's torque over the ball's; the ball turns `ratio` times as fast
    t = DT_S * np.arange(int(duration_s / DT_S))
    hz = LOW_HZ + (HIGH_HZ - LOW_HZ) * (1.0 - np.abs(2.0 * t / duration_s - 1.0))
    u = AMPLITUDE * np.sin(2.0 * np.pi * np.cumsum(hz) * DT_S)
    random = np.random.default_rng([seed, 53])
    disturbed = u + TORQUE_NOISE * random.normal(size=len(u))
    angle = rate = 0.0
    seen = np.empty(len(t))
    h = DT_S / SUBSTEPS
    for k, command in enumerate(disturbed):
        seen[k] = np.floor(angle * ratio * COUNTS / (2 * np.pi)) * 2 * np.pi / COUNTS / ratio
        for _ in range(SUBSTEPS):
            ball = ratio * rate
            sticking = 1.0 + (STICTION - 1.0) * np.exp(-((ball / STICTION_RATE_RAD_S) ** 2))
            torque = (
                p.torque_per_command_n_m * command
                - p.damping_n_m_s_rad * ball
                + friction.torque(ball, COULOMB_N_M * sticking, VISCOUS_N_M_S)
                + RIPPLE_N_M * np.sin(PASSAGES * ratio * angle)
            )
            rate += h * ratio * torque / FLYWHEEL_KG_M2
            angle += h * rate
    return t, u, seen


def _slopes(angle):
    """(rate, acceleration) by a local parabola over 9 samples."""
    half = 4
    x = DT_S * np.arange(-half, half + 1)
    fit = np.linalg.pinv(np.stack([np.ones_like(x), x, 0.5 * x**2], axis=1))
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(angle, half, mode="edge"), 2 * half + 1)
    return windows @ fit[1], windows @ fit[2]


def regression(u, angle, printed: bool):
    """(J_f, mu_c, mu_v, R^2, measured side, fitted side) of (5.37); `printed` with its dimension error, otherwise the flywheel's torque throughout."""
    p = mbbr.parameters()[0]
    ratio = FLYWHEEL_RADIUS_M / p.ball_radius_m
    rate, acceleration = _slopes(angle)
    held = 0.5 * (u + np.concatenate([u[:1], u[:-1]]))  # around a sample one command ends and the next begins
    wanted = p.torque_per_command_n_m * held - p.damping_n_m_s_rad * ratio * rate
    if printed:
        regressors = np.stack([acceleration, np.sign(rate) * ratio, rate * ratio**2], axis=1)
    else:
        regressors = np.stack([acceleration / ratio, np.sign(rate), rate * ratio], axis=1)
    found, *_ = np.linalg.lstsq(regressors, wanted, rcond=None)
    fitted = regressors @ found
    return (*found, 1.0 - np.sum((wanted - fitted) ** 2) / np.sum((wanted - wanted.mean()) ** 2), wanted, fitted)


def run(seed: int, quick: bool, progress) -> Result:
    """Fig. 5.3 and the identified coefficients."""
    found = [regression(*flywheel(seed + k, 10.0 if quick else DURATION_S)[1:], False) for k in range(2)]
    t, u, angle = flywheel(seed, 10.0 if quick else DURATION_S)
    printed = regression(u, angle, True)
    ratio = FLYWHEEL_RADIUS_M / mbbr.parameters()[0].ball_radius_m
    wanted, fitted = found[0][4:]

    def draw(figure):
        upper, lower = figure.subplots(2, 1, sharex=True)
        upper.plot(t, wanted, "k", lw=0.9, label="k1 u − K2 φ̇ (measured)")
        upper.plot(t, fitted, "C0", lw=0.9, label=f"fit, R² = {found[0][3]:.3f}")
        lower.plot(t, wanted - fitted, "C3", lw=0.7)
        upper.set(
            ylabel="Torque (N·m)",
            title=f"a = J_f = {found[0][0]:.2e}, c = μc = {found[0][1]:.4f}, b = μv = {found[0][2]:.5f}, m = r_f/r = {ratio:.3f}",
        )
        lower.set(ylabel="Residual (N·m)", xlabel="Time (s)")
        upper.legend(fontsize=8)
        for axes in (upper, lower):
            axes.grid(alpha=0.3)
        figure.tight_layout()

    coulomb, fit = np.mean([f[1] for f in found]), np.mean([f[3] for f in found])
    return Result(
        rows=[
            Row("μc, mean of both axes (N m)", coulomb, COULOMB_N_M, 0.15),
            Row("μv, mean of both axes (N m s/rad)", np.mean([f[2] for f in found]), VISCOUS_N_M_S),
            Row(f"J_f (kg m²; simulated {FLYWHEEL_KG_M2:g})", np.mean([f[0] for f in found])),
            Row("R² of the fit, mean of both axes", fit, 0.93, by=0.02),
            Row("μc by the printed regressor (5.37) (N m)", printed[1]),
            Row("printed μc times r_f/r (N m)", printed[1] * ratio),
        ],
        claims=[
            Claim(
                "the regression finds the Coulomb friction that was simulated within 15 % (static friction, rollers, torque "
                "noise and the quantised encoder bend it)",
                abs(coulomb - COULOMB_N_M) < 0.15 * COULOMB_N_M,
            ),
            Claim(
                "the printed regressor (5.37) gives μc too small by r/r_f: its dimensions do not agree",
                abs(printed[1] * ratio / found[0][1] - 1.0) < 0.02,
            ),
        ],
        figures=[Figure("dissertation-fig-5.3", "Fig. 5.3: regression fit of the friction model", draw, (9, 6))],
        settings={
            "chirp": "amplitude 3, 0.1 to 2 Hz and back, 20 s",
            "truth": "published μc and μv",
            "flywheel": f"{FLYWHEEL_KG_M2} kg m², {FLYWHEEL_RADIUS_M} m (not stated; ours)",
            "static friction": f"{STICTION} times Coulomb's below {STICTION_RATE_RAD_S} rad/s (the text suspects it)",
            "torque noise": f"{TORQUE_NOISE} of a command",
            "roller torque": f"{RIPPLE_N_M} N m, {PASSAGES} passages a radian of the ball: calibrated so that R² is the published one",
            "encoder": f"{COUNTS:.0f} counts a turn of the ball; rate and acceleration by parabolas over 45 ms",
        },
        notes=[
            "The fit's rest here is what the model has no term for: static friction, which the paper suspects, and the rollers, which show where the ball turns slowly: at the beginning and the end.",
            "μv is a tenth of the back EMF's K2 and a small remainder of the fit: its relative error is large.",
        ],
    )


EXPERIMENTS = [Experiment("dissertation-fig-5.3", "dissertation", ("Fig. 5.3",), "friction identified with a flywheel", run)]
