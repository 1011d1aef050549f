"""O'Murchadha, Figs 7 and 8: an x-controller cascaded into a lean controller, on the EKF, with animations."""

import numpy as np

from mip_rt import optional
from mip_rt.estimators import mip_2state_ekf
from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.lab.papers.omurchadha import DT_S, SETTINGS, P, make_filter, pid_gains, sense, simulate
from mip_rt.lab.papers.runs import rms

# Lean reference from the x-errors: lean = X_GAIN (x_des - x) + V_GAIN (x_des' - x').
X_GAIN, V_GAIN, LEAN_LIMIT_RAD = 0.40, 0.23, 0.3
FRAME_EVERY, FRAMES_S = 20, 8.0


def follow(path, seed: int, duration_s: float):
    """(t, states, wanted place (n,)): path(t) -> (place, speed); lean by the EKF, place by the encoder."""
    random = np.random.default_rng([seed, 7])
    p, state = make_filter()
    kp, kd, _ = pid_gains()
    wanted = np.array([path(DT_S * k)[0] for k in range(int(duration_s / DT_S))])

    def control(k, x):
        y = sense(x, random)
        mip_2state_ekf.step(p, state, y, y, mip_2state_ekf.ALL_VALID)
        place, speed = path(DT_S * k)
        lean, rate = float(state.x[0]), float(state.x[1])
        x_error = place - P.wheel_radius_m * (x[0] + lean)
        v_error = speed - P.wheel_radius_m * (x[2] + rate)
        goal = np.clip(X_GAIN * x_error + V_GAIN * v_error, -LEAN_LIMIT_RAD, LEAN_LIMIT_RAD)
        return kp * (lean - goal) + kd * rate

    start = path(0.0)[0] / P.wheel_radius_m
    t, states, _ = simulate(control, [start, 0.0, 0.0, 0.0], duration_s)
    return t, states, wanted


def place_of(states):
    """(n,) x in m."""
    return P.wheel_radius_m * (states[:, 0] + states[:, 1])


def _draw(figure, t, states, wanted):
    panels = figure.subplots(3, 1, sharex=True)
    for axes, values, name in zip(panels, (states[:, 0], states[:, 1], place_of(states)), ("θ (rad)", "φ (rad)", "x (m)")):
        axes.plot(t, values)
        axes.set_ylabel(name)
        axes.grid(alpha=0.3)
    panels[2].plot(t, wanted, "k:", label="desired")
    panels[2].legend(fontsize=8)
    panels[2].set_xlabel("Time (s)")
    figure.tight_layout()


def animate(output, t, states, wanted) -> None:
    """Writes a GIF of the robot on its way (pillow)."""
    from mip_rt.log.picture import figure

    page = figure(7.0, 2.2)
    image = optional.load("PIL.Image", "lab", "an animation")
    canvas = optional.load("matplotlib.backends.backend_agg", "lab", "an animation").FigureCanvasAgg(page)
    page.set_dpi(80)
    axes = page.add_subplot()
    r, length = P.wheel_radius_m, 2.0 * P.com_height_m
    x, frames = place_of(states), []
    for k in range(0, min(len(t), int(FRAMES_S / DT_S)), FRAME_EVERY):
        axes.clear()
        axes.plot([-2, 2], [0, 0], "0.4", lw=1)
        axes.plot(wanted[k], 0, "C3^", ms=8, clip_on=False)
        lean, turn = states[k, 1], states[k, 0] + states[k, 1]
        axes.plot([x[k], x[k] + length * np.sin(lean)], [r, r + length * np.cos(lean)], "C0", lw=5, solid_capstyle="round")
        around = np.linspace(0, 2 * np.pi, 40)
        axes.fill(x[k] + r * np.sin(around), r + r * np.cos(around), "0.2")
        axes.plot([x[k], x[k] + r * np.sin(turn)], [r, r + r * np.cos(turn)], "w", lw=1)
        axes.set(xlim=(-1.5, 1.5), ylim=(-0.05, 0.35), aspect="equal", xlabel="x (m)", yticks=[], title=f"t = {t[k]:.1f} s")
        canvas.draw()
        frames.append(image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3].copy()))
    frames[0].save(
        output, format="GIF", save_all=True, append_images=frames[1:], duration=round(1000 * FRAME_EVERY * DT_S), loop=0
    )


def _result(number: int, name: str, path, seed: int, duration_s: float, judge) -> Result:
    t, states, wanted = follow(path, seed, duration_s)
    error = place_of(states) - wanted
    rows, claims = judge(t, error)
    return Result(
        rows=rows,
        claims=claims,
        settings={**SETTINGS, "cascade": f"lean reference {X_GAIN} rad/m and {V_GAIN} rad s/m (ours), PD on the lean"},
        figures=[
            Figure(
                f"omurchadha-fig-{number}",
                f"Fig. {number}: {name} trajectory on the EKF",
                lambda f: _draw(f, t, states, wanted),
                (8, 7),
            ),
            Figure(
                f"omurchadha-fig-{number}-animation",
                f"Animation of the {name} trajectory",
                lambda output: animate(output, t, states, wanted),
                kind="gif",
            ),
        ],
    )


def step(seed: int, quick: bool, progress) -> Result:
    """Fig. 7: from x = 1 to x = -1."""

    def judge(t, error):
        rows = [
            Row("distance from the goal at the end (m)", abs(error[-200:]).mean()),
            Row("largest overshoot (m)", float(max(0.0, -np.nanmin(error)))),
        ]
        return rows, [
            Claim("the robot goes from x = 1 to x = -1 and stands there within 10 cm", bool(abs(error[-200:]).mean() < 0.1))
        ]

    return _result(7, "step", lambda t: (1.0, 0.0) if t < 1.0 else (-1.0, 0.0), seed, 12.0, judge)


def sine(seed: int, quick: bool, progress) -> Result:
    """Fig. 8."""
    omega = 2.0 * np.pi / 10.0

    def judge(t, error):
        following = rms(error[t > 5.0])
        return [Row("RMS distance from the sine after 5 s (m; amplitude 1)", following)], [
            Claim("the robot follows the sine (RMS below a quarter of the amplitude)", following < 0.25)
        ]

    return _result(
        8, "sinusoidal", lambda t: (np.sin(omega * t), omega * np.cos(omega * t)), seed, 12.0 if quick else 20.0, judge
    )


EXPERIMENTS = [
    Experiment("omurchadha-fig-7", "omurchadha", ("Fig. 7",), "cascaded position control, step", step),
    Experiment("omurchadha-fig-8", "omurchadha", ("Fig. 8",), "cascaded position control, sine", sine),
]
