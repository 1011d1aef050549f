"""The compiled step against plain C of the same arithmetic: equal results, and at most 1.3 times the cost."""

import ctypes
import time

import numpy as np
import pytest
from helpers import DryRun, make_config

import twin
from mip_rt import frame
from mip_rt.compiled import JIT_DISABLED, njit, numba
from mip_rt.estimators import mbbr_ekf
from mip_rt.robots import mbbr

COUNT = 2000


@njit
def many_ekf_steps(ep, es, u, y, n):
    for _ in range(n):
        mbbr_ekf.step(ep[0].ekf, es[0].filter, u, y, mbbr_ekf.ALL_VALID)


@njit
def many_robot_steps(p, s, ep, es, rows, count, n):
    for i in range(n):
        mbbr.step(p, s, ep, es, rows, i % count)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Engaged rows of a dry run with one EKF, and the arrays in the state before the first of them."""
    folder = tmp_path_factory.mktemp("twin")
    config = make_config(estimator__control="ekf", estimator__shadows="[]", log__ring_s="60")
    with DryRun(folder, config, "drive-spin-1.0") as dry:
        dry.run(25.0)
        rows = dry.session.ring.rows
        engaged = np.flatnonzero(rows["request"] & 1)[100:]
        kept = rows[engaged[: COUNT + 1]].copy()
        robot = dry.session.robot
        arrays = [array.copy() for array in robot._arguments]
    return folder, kept, arrays


def replayed(recorded):
    """Arrays after the first kept row (which resets the filter), and the other rows."""
    _, rows, arrays = recorded
    arrays = [array.copy() for array in arrays]
    arrays[1]["engaged"] = 0
    first = rows[:1].copy()
    mbbr.step(*arrays, first, 0)
    return arrays, rows[1:].copy()


def test_same_results(recorded):
    """The command in force is an input of both: without a plant that answers, filter and controller would blow rounding up."""
    folder = recorded[0]
    library = twin.build(folder, ("-O2", "-ffp-contract=off"))
    arrays, rows = replayed(recorded)
    others, other_rows = [array.copy() for array in arrays], rows.copy()
    recorded_commands = rows["command_applied"].copy()
    for i in range(500):
        if i:
            arrays[1]["applied"] = others[1]["applied"] = recorded_commands[i - 1]
        mbbr.step(*arrays, rows, i)
        library.robot_step(*(twin.pointer(array) for array in others), twin.pointer(other_rows[i : i + 1]))
    rows["limits"] &= ~frame.LIMIT_COAST_SATURATED  # the twin's inverse does not tell
    for name in ("state_estimate", "estimates", "command_feedback", "command_applied", "duty", "reference_lean_rad", "error", "innovation",
                 "limits", "alarms", "wheel_mismatch_rad", "drive_allowed"):  # fmt: skip
        a, b = rows[name][:500], other_rows[name][:500]
        if name == "estimates":
            a, b = a[:, 0], b[:, 0]
        assert np.abs(a - b).max() <= 1e-9 * max(1.0, np.abs(a).max()), name


def best(function, repeats=15):
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return min(times)


def filterpy_ns(n=300):
    """Predict and update of 13 states and 8 measurements in FilterPy's (Joseph) form; None where it is not installed."""
    try:
        from filterpy.kalman import ExtendedKalmanFilter
    except ImportError:
        return None
    reference, random = ExtendedKalmanFilter(dim_x=13, dim_z=8), np.random.default_rng(2)
    reference.F = np.eye(13) + 0.005 * random.normal(size=(13, 13))
    H, y = random.normal(size=(8, 13)), np.zeros((8, 1))

    def cycle():
        for _ in range(n):
            reference.P = np.eye(13)
            reference.predict()
            reference.update(y, lambda x: H, lambda x: H @ x)

    return best(cycle, 5) / n * 1e9


@pytest.mark.timing
@pytest.mark.skipif(JIT_DISABLED, reason="times compiled code")
def test_cost_is_that_of_c(recorded, tmp_path):
    """Against plain loops at -O3 -march=native (the budget: at most 1.3), and against rows written as gcc vectors (printed)."""
    arrays, rows = replayed(recorded)
    n = 10000
    u, y = np.array([0.1, -0.1, 0.2]), np.zeros(8)
    many_ekf_steps(arrays[2], arrays[3], u, y, 1)
    many_robot_steps(*arrays, rows, COUNT, 1)
    ratios = {}
    for label, flags in (("plain C", ()), ("C with gcc vectors", ("-DROWS_AS_VECTORS",))):
        folder = tmp_path / label.replace(" ", "-")
        folder.mkdir()
        library = twin.build(folder, ("-O3", "-march=native", *flags))
        theirs = [array.copy() for array in arrays]
        pointers = [twin.pointer(array) for array in theirs]
        ep = ctypes.c_void_p(pointers[2].value + mbbr.ESTIMATOR_PARAMETERS.fields["ekf"][1])
        es = ctypes.c_void_p(pointers[3].value + mbbr.ESTIMATOR_STATE.fields["filter"][1])
        cycles = {
            "ekf": (
                lambda: many_ekf_steps(arrays[2], arrays[3], u, y, n),
                lambda: library.many_ekf_steps(ep, es, twin.pointer(u), twin.pointer(y), ctypes.c_long(n)),
            ),
            "step": (
                lambda: many_robot_steps(*arrays, rows, COUNT, n),
                lambda: library.many_robot_steps(*pointers, twin.pointer(rows), ctypes.c_long(COUNT), ctypes.c_long(n)),
            ),
        }
        for name, (numba_runs, c_runs) in cycles.items():
            ours, c = best(numba_runs) / n * 1e9, best(c_runs) / n * 1e9
            ratios[label, name] = ours / c
            print(f"{name}: numba {numba.__version__} {ours:.0f} ns, {label} {c:.0f} ns, ratio {ours / c:.2f}")
    others = filterpy_ns()
    ours = best(cycles["ekf"][0]) / n * 1e9
    print("FilterPy is not installed here" if others is None else f"FilterPy {others:.0f} ns, {others / ours:.0f} times ours")
    assert max(ratio for (label, _), ratio in ratios.items() if label == "plain C") <= 1.3, ratios
