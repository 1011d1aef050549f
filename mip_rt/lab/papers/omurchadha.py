"""O'Murchadha, Figs 2 to 6: free motion, LQR, PID, the 2-state EKF on test data and in the loop.

The paper states neither parameters nor gains: the robot is the hand-sized one of models.planar, the LQR is designed from the model, the PID's gains
are placed. What can be compared is what its figures show.
"""

import numpy as np

from mip_rt.controllers import lqr
from mip_rt.estimators import mip_2state_ekf
from mip_rt.lab.papers.experiment import Claim, Experiment, Figure, Result, Row
from mip_rt.lab.papers.runs import rms
from mip_rt.models import planar

DT_S, SUBSTEPS = 0.005, 50  # a wheel of no mass makes the model stiff
TORQUE_LIMIT_N_M = 0.5
GYRO_NOISE_RAD_S, TILT_NOISE = 0.02, 0.05  # of the simulated sensors: rad/s, and g
PROCESS = (1e-6, 1e-2)  # Q of the EKF a step, "tuned to track the data"
# Of (10) on the lean: torque = kp lean + ki integral + kd lean rate, poles on the corrected model; see `pid_gains`.
POLES = np.array([-15.0 + 10.0j, -15.0 - 10.0j, -1.0])
P = planar.parameters()[0]
SETTINGS = {
    "robot": "m_b 0.25 kg, r 3.5 cm, l 10 cm, I_b 8e-4 kg m², g 9.81 (not stated in the paper; ours)",
    "step": "5 ms held torque, Runge-Kutta inside",
    "sensors": f"noise {GYRO_NOISE_RAD_S} rad/s and {TILT_NOISE} g a sample",
    "Q": f"{PROCESS} a step",
}


def pid_gains() -> np.ndarray:
    """(kp, kd, ki) of torque = kp phi + kd phi' + ki int phi that place the poles of the lean alone.

    Without drag the lean obeys phi'' = a phi + b torque whatever the wheel does.
    """
    A, B = planar.linear_matrices(P)
    a, b = A[3, 1], B[3, 0]
    s2, s1, s0 = np.real(np.poly(POLES))[1:]
    return np.array([-(s1 + a) / b, -s2 / b, -s0 / b])


def simulate(control, x0, duration_s: float, printed: bool = False):
    """(t, states (n, 4), torques): control(k, x) -> torque, held for a step; it ends where the robot lies flat."""
    x = np.array(x0, float)
    t = DT_S * np.arange(int(duration_s / DT_S))
    states, torques = np.full((len(t), 4), np.nan), np.zeros(len(t))
    for k in range(len(t)):
        states[k] = x
        torques[k] = np.clip(control(k, x), -TORQUE_LIMIT_N_M, TORQUE_LIMIT_N_M)
        planar.advance(x, torques[k], P, int(printed), DT_S, SUBSTEPS)
        if not abs(x[1]) < 1.4:
            break
    return t, states, torques


def make_filter():
    """(parameters, state) of the 2-state EKF."""
    p = np.zeros(1, mip_2state_ekf.PARAMETERS).view(np.recarray)[0]
    p.noise.Q[:2], p.noise.R[:3] = PROCESS, [TILT_NOISE**2, TILT_NOISE**2, GYRO_NOISE_RAD_S**2]
    p.noise.P_limit[:], p.noise.gate_squared, p.noise.dt_s = 100.0, 1e18, DT_S
    return p, mip_2state_ekf.init(p, np.zeros(2), np.full(2, 0.1))


def sense(x, random, body_acceleration: float = 0.0) -> np.ndarray:
    """(3,) [sin lean, cos lean, lean rate] as (11) has them, noisy; `body_acceleration` (m/s^2) is what the paper leaves out."""
    clean = np.array([np.sin(x[1]) - body_acceleration / P.gravity_m_s2 * np.cos(x[1]), np.cos(x[1]), x[3]])
    return clean + random.normal(size=3) * [TILT_NOISE, TILT_NOISE, GYRO_NOISE_RAD_S]


def draw_states(figure, t, states, label="actual", extra=()):
    """Panels of wheel angle and lean over time; extra: (panel, values, label)."""
    panels = figure.subplots(2, 1, sharex=True)
    for axes, column, title in zip(panels, (0, 1), ("θ (rad)", "φ (rad)")):
        axes.plot(t, states[:, column], "C0", label=label)
        axes.set_ylabel(title)
        axes.grid(alpha=0.3)
    for panel, values, label in extra:
        panels[panel].plot(t, values, "C1--", lw=1, label=label)
        panels[panel].legend(fontsize=8)
    panels[1].set_xlabel("Time (s)")
    figure.tight_layout()


def free(seed: int, quick: bool, progress) -> Result:
    """Fig. 2: tau = 0, phi_0 = 1."""
    x = np.array([0.0, 1.0, 0.0, 0.0])
    t = DT_S * np.arange(int((2.0 if quick else 5.0) / DT_S))
    states = np.empty((len(t), 4))
    for k in range(len(t)):
        states[k] = x
        planar.advance(x, 0.0, P, 0, DT_S, SUBSTEPS)
    change = abs(planar.energy(x, P) / planar.energy(states[0], P) - 1.0)
    lows = np.flatnonzero((states[1:-1, 1] < states[:-2, 1]) & (states[1:-1, 1] <= states[2:, 1])) + 1
    return Result(
        rows=[
            Row("period of the motion (s)", float(np.mean(np.diff(t[lows])))),
            Row("relative change of the energy", change, digits=2),
            Row("largest lean (rad; 2π − 1 = 5.28 by energy)", states[:, 1].max()),
        ],
        claims=[
            Claim(
                "both angles move periodically and stay bounded: the lean swings between 1 and 2π − 1 and comes back",
                bool(abs(states[lows, 1].min() - 1.0) < 0.01 and states[:, 1].max() < 2 * np.pi - 0.98),
            ),
            Claim("energy is conserved to 1e-6", change < 1e-6),
        ],
        figures=[
            Figure("omurchadha-fig-2", "Fig. 2: motion without torque from φ = 1", lambda f: draw_states(f, t, states), (8, 5))
        ],
        settings=SETTINGS,
    )


def stabilise(seed: int, quick: bool, progress) -> Result:
    """Figs 3 and 4: LQR and PID about upright; the printed equations and signs beside them."""
    duration_s, x0 = 4.0, [0.0, 0.2, 0.0, 0.0]
    tolerated = [2.0, 0.2, 20.0, 2.0], [0.1]
    K = lqr.gains(*planar.linear_matrices(P), *tolerated, DT_S)[0]
    wrong = lqr.gains(*planar.linear_matrices(P, True), *tolerated, DT_S)[0]
    kp, kd, ki = pid_gains()
    memory = {"sum": 0.0}

    def pid(k, x):
        memory["sum"] += DT_S * x[1]
        return kp * x[1] + kd * x[3] + ki * memory["sum"]

    t, by_lqr, _ = simulate(lambda k, x: -K @ x, x0, duration_s)
    _, by_pid, _ = simulate(pid, x0, duration_s)
    _, as_printed, _ = simulate(lambda k, x: K @ x, x0, duration_s)
    _, by_printed_model, _ = simulate(lambda k, x: -wrong @ x, x0, duration_s)
    fell = {"τ = Kx with K of a textbook lqr": as_printed, "LQR designed on the printed (6)": by_printed_model}
    return Result(
        rows=[
            Row("LQR: lean after 4 s (rad)", abs(by_lqr[-1, 1])),
            Row("LQR: wheel angle after 4 s (rad)", abs(by_lqr[-1, 0])),
            Row("PID: lean after 4 s (rad)", abs(by_pid[-1, 1])),
            Row("PID: wheel rate after 4 s (rad/s)", abs(by_pid[-1, 2])),
        ],
        claims=[
            Claim("Fig. 3: LQR brings lean and wheel angle to zero", np.abs(by_lqr[-1]).max() < 0.1),
            Claim("Fig. 4: PID brings the lean to zero", abs(by_pid[-1, 1]) < 5e-3),
            Claim(
                "Fig. 4: θ is not controlled by the PID: it ends more than a radian from where it began", abs(by_pid[-1, 0]) > 1.0
            ),
            *(
                Claim(f"{name} does not stabilise the corrected robot", not np.abs(path[-1, 1]) < 0.5)
                for name, path in fell.items()
            ),
        ],
        figures=[
            Figure("omurchadha-fig-3", "Fig. 3: LQR", lambda f: draw_states(f, t, by_lqr), (8, 5)),
            Figure(
                "omurchadha-fig-4", "Fig. 4: PID on the lean; θ is not controlled", lambda f: draw_states(f, t, by_pid), (8, 5)
            ),
            Figure(
                "omurchadha-fig-3-printed",
                "Not in the paper: what (9) and (6) do as printed; both fall",
                lambda f: draw_states(
                    f,
                    t,
                    as_printed,
                    "τ = Kx, the printed sign of (9)",
                    extra=(
                        (0, by_printed_model[:, 0], "designed on the printed (6)"),
                        (1, by_printed_model[:, 1], "designed on the printed (6)"),
                    ),
                ),
                (8, 5),
            ),
        ],
        settings={
            **SETTINGS,
            "LQR": f"tolerated {tolerated[0]} and 0.1 N m: K = {np.round(K, 4).tolist()}",
            "PID": f"kp {kp:.3f}, kd {kd:.4f}, ki {ki:.3f}",
        },
    )


def test_data(seed: int, quick: bool, progress) -> Result:
    """Fig. 5: the EKF on noisy test data."""
    random = np.random.default_rng([seed, 5])
    t = DT_S * np.arange(2000)
    lean = 0.5 * np.sin(2.0 * t) + 0.2 * np.sin(5.0 * t)
    rate = np.cos(2.0 * t) + np.cos(5.0 * t)
    p, state = make_filter()
    measured, out = np.zeros((len(t), 3)), np.zeros((len(t), 2))
    for k in range(len(t)):
        measured[k] = sense([0.0, lean[k], 0.0, rate[k]], random)
        mip_2state_ekf.step(p, state, measured[k], measured[k], mip_2state_ekf.ALL_VALID)
        out[k] = state.x[:2]
    raw = np.arctan2(measured[:, 0], measured[:, 1]) - lean
    error, rate_error = rms(out[100:, 0] - lean[100:]), rms(out[100:, 1] - rate[100:])

    def draw(figure):
        panels = figure.subplots(4, 1, sharex=True)
        noisy = (np.arctan2(measured[:, 0], measured[:, 1]), measured[:, 2], measured[:, 0], measured[:, 1])
        fits = (out[:, 0], out[:, 1], np.sin(out[:, 0]), np.cos(out[:, 0]))
        for axes, data, fit, name in zip(panels, noisy, fits, ("φ (rad)", "dφ/dt (rad/s)", "a_y (g)", "a_z (g)")):
            axes.plot(t, data, "0.7", lw=0.6, label="test data")
            axes.plot(t, fit, "C0", lw=1, label="EKF")
            axes.set_ylabel(name)
            axes.grid(alpha=0.3)
        panels[0].legend(fontsize=8)
        panels[3].set_xlabel("Time (s)")
        figure.tight_layout()

    return Result(
        rows=[
            Row("EKF: RMS error of φ (rad)", error),
            Row("accelerometer alone: RMS error of φ (rad)", rms(raw)),
            Row("EKF: RMS error of the rate (rad/s)", rate_error),
        ],
        claims=[Claim("the EKF tracks the data with less than a third of the accelerometer's noise", error < rms(raw) / 3.0)],
        figures=[Figure("omurchadha-fig-5", "Fig. 5: EKF on noisy test data", draw, (8, 8))],
        settings=SETTINGS,
    )


def in_the_loop(seed: int, quick: bool, progress) -> Result:
    """Fig. 6: balancing on the EKF; beside it with the robot's own acceleration in the accelerometer."""
    kp, kd, ki = pid_gains()
    duration_s = 3.0 if quick else 6.0

    def balanced(honest: bool):
        random = np.random.default_rng([seed, 6])
        p, state = make_filter()
        memory = {"sum": 0.0, "torque": 0.0}
        estimates = np.zeros((int(duration_s / DT_S), 2))

        def control(k, x):
            acceleration = P.wheel_radius_m * planar.derivative(x, memory["torque"], P)[2:].sum() if honest else 0.0
            y = sense(x, random, acceleration)
            mip_2state_ekf.step(p, state, y, y, mip_2state_ekf.ALL_VALID)
            estimates[k] = state.x[:2]
            memory["sum"] += DT_S * state.x[0]
            memory["torque"] = float(
                np.clip(kp * state.x[0] + kd * state.x[1] + ki * memory["sum"], -TORQUE_LIMIT_N_M, TORQUE_LIMIT_N_M)
            )
            return memory["torque"]

        return *simulate(control, [0.0, 0.1, 0.0, 0.0], duration_s), estimates

    t, states, _, estimates = balanced(False)
    _, with_acceleration, _, _ = balanced(True)
    return Result(
        rows=[
            Row("lean after the first second, RMS (rad)", rms(states[t > 1.0, 1])),
            Row("EKF error of the lean, RMS (rad)", rms(states[t > 1.0, 1] - estimates[t > 1.0, 0])),
        ],
        claims=[
            Claim(
                "the EKF in the loop keeps the lean near zero while θ is not controlled",
                bool(np.abs(states[t > 1.0, 1]).max() < 0.1),
            )
        ],
        notes=[
            "(11) has no acceleration of the robot in the accelerometer. With it at the axle, the same loop "
            + (
                "still balances."
                if np.abs(with_acceleration[-1, 1]) < 0.5
                else "falls: the filter takes the push of its own torque for a lean."
            )
        ],
        figures=[
            Figure(
                "omurchadha-fig-6",
                "Fig. 6: balancing on the EKF",
                lambda f: draw_states(f, t, states, extra=((1, estimates[:, 0], "EKF"),)),
                (8, 5),
            )
        ],
        settings=SETTINGS,
    )


EXPERIMENTS = [
    Experiment("omurchadha-fig-2", "omurchadha", ("Fig. 2",), "free motion without torque", free),
    Experiment("omurchadha-figs-3-4", "omurchadha", ("Fig. 3", "Fig. 4"), "LQR and PID stabilisation", stabilise),
    Experiment("omurchadha-fig-5", "omurchadha", ("Fig. 5",), "2-state EKF on noisy test data", test_data),
    Experiment("omurchadha-fig-6", "omurchadha", ("Fig. 6",), "EKF in the loop", in_the_loop),
]
