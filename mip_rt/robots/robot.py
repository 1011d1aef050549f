"""A robot as the loop sees it: the arrays of its compiled step, bound to the rows of a ring."""

from functools import partial

import numpy as np

from mip_rt import frame
from mip_rt.compiled import JIT_DISABLED, direct, plain, span
from mip_rt.robots.persistence import Persistence

BATTERY_SMOOTHING_RAD_S = 2.0  # of the voltage that commands are scaled with
BATTERY_HOLD_S = 2.0  # so long the last plausible reading counts


class Robot:
    """The arrays of one robot and its step on them.

    Args:
        layout: frame.Layout of its rows.
        names: estimator names by slot; the first controls.
        controller: name of the controller.
        step: compiled function of (parameters, state, estimator parameters, estimator states, rows, index).
        arrays: its first four arguments as (record array, dtype).
        state_kept: bytes of the robot's state that persist.
        kept, estimate: of an estimator's state: bytes that persist, and the range of them that is the estimate (see robots.persistence).

    Attributes:
        gyro_bias_rad_s: (3,), the gyro's rates at rest, body axes; an input of every tick.
        parameters, state, estimator_parameters, estimator_states: the step's arrays.
        step: step(index) runs the compiled step on that row; there once rows are attached.
        rows: the ring's rows, as the compiled functions want them.
        command_in_force: command that the estimators are told at the next tick; a view into the state.
        persistence: what the next tick reads of this one: see robots.persistence.
    """

    def __init__(self, layout, names, controller: str, step, arrays, state_kept: int, kept: int, estimate: slice):
        self.layout, self.names, self.controller = layout, names, controller
        self._step = direct(step, *(dtype for _, dtype in arrays), layout.dtype, "int64")
        self.parameters, self.state, self.estimator_parameters, self.estimator_states = (array for array, _ in arrays)
        self._arguments = tuple(plain(array, dtype) for array, dtype in arrays)
        self.command_in_force = np.asarray(self.state["applied"])[0]
        self.persistence = Persistence(self.state, self.estimator_states, state_kept, kept, estimate)
        self.gyro_bias_rad_s = np.zeros(3)
        self.rows = None

    def attach(self, rows) -> None:
        """Uses this ring's rows."""
        self.rows = rows.view(np.recarray) if JIT_DISABLED else rows  # plain Python needs fields as attributes
        self.step = partial(self._step, *(number for array in (*self._arguments, self.rows) for number in span(array)))

    def rehearse(self) -> None:
        """Runs the step once in each of its ways and forgets it: the first real tick then meets no cold page and no cold dispatcher."""
        saved = self.state.copy(), self.estimator_states.copy(), self.rows[:1].copy()
        for request in (0, frame.REQUEST_ENGAGED, frame.REQUEST_ENGAGED):
            self.rows[0]["request"] = request
            self.step(0)
        self.state[:], self.estimator_states[:], self.rows[:1] = saved


def orthonormal(matrix) -> np.ndarray:
    """The orthonormal matrix nearest to a (3, 3) that is nearly so (polar decomposition by Newton's iteration)."""
    m = np.array(matrix, float)
    for _ in range(20):
        m = 0.5 * (m + np.linalg.inv(m).T)
    return m


def noise(record, config, process, measurement, initial, states: int, dt_s: float) -> None:
    """Fills a record of estimators.ekf.NOISE; variances per step, limits and gate from the configuration's estimator section."""
    record.Q[:states] = process
    record.R[: len(measurement)] = measurement
    record.P0[:states] = initial
    record.P_limit[:] = config.estimator.covariance_limit
    record.gate_squared = config.estimator.gate_sigma**2
    record.dt_s = dt_s
