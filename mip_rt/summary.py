"""The summary of a run: rates, latencies, and in a dry run the errors against the simulated truth.

Rows are taken from the ring in batches while the loop has slack, so a run may be longer than the ring. The keys of
`Summary.report` are a contract; the sentences of `render` are not.
"""

import math

import numpy as np

from mip_rt import frame
from mip_rt.faults import FAULT_BY_NUMBER
from mip_rt.supervisor import State

STAGES = ("wake", "read", "step", "write", "edge_to_write")
PERCENTILES = (("p50", 50.0), ("p99", 99.0), ("p999", 99.9), ("max", 100.0))


class Summary:
    """Accumulates over a run.

    Args:
        names: estimator names by slot; the first controls.
        dt_s: nominal tick.
        judge: the robot's comparison of rows with the truth, such as robots.mbbr_judge.Judge.
        settle_s: time after the robot starts balancing that the error figures leave out.
    """

    def __init__(self, names, dt_s: float, judge, settle_s: float = 2.0):
        self.judge = judge
        self.names, self.dt_s, self.settle_ticks = list(names), dt_s, round(settle_s / dt_s)
        self.ticks = self.missed = self.balancing_ticks = 0
        self.first_edge_ns = self.last_edge_ns = None
        self.latency_ns = {stage: [] for stage in (*STAGES, "fakes")}
        self.tilt_square = self.tilt_max = self.yaw_rate = self.speed = 0.0
        self.tilt_error = np.zeros(frame.ESTIMATORS)
        self.rate_error = np.zeros(frame.ESTIMATORS)
        self.position_error_max = 0.0
        self.counted = 0
        self.faults = []

    def absorb(self, rows, truth=None, fake_ns=None) -> None:
        """Takes in committed rows.

        Args:
            rows: (n,) frames in order.
            truth: (n,) fake.world.TRUTH records of the same ticks, or None on a robot.
            fake_ns: (n, 2) time that the fakes took before the wake-up and while reading, subtracted from the latencies.
        """
        if not len(rows):
            return
        self.ticks += len(rows)
        self.missed += int(rows["missed"].sum())
        if self.first_edge_ns is None:
            self.first_edge_ns = int(rows["edge_ns"][0])
            self.first_missed = self.missed
        self.last_edge_ns = int(rows["edge_ns"][-1])
        fakes = np.zeros((len(rows), 2), np.int64) if fake_ns is None else fake_ns
        both = fakes.sum(axis=1)
        edge, wake, read = rows["edge_ns"], rows["wake_ns"], rows["read_ns"]
        step, write = rows["step_ns"], rows["write_ns"]
        for stage, values in zip(
            (*STAGES, "fakes"), (wake - edge - fakes[:, 0], read - wake - fakes[:, 1], step - read, write - step, write - edge - both, both)
        ):
            self.latency_ns[stage].append(values.astype(np.int32))
        # Not np.unique: at its first call numpy imports its masked arrays, which makes a tick wait.
        for number in sorted(set(rows["fault"][rows["state"] == State.FAULT].tolist())):
            code = FAULT_BY_NUMBER[number].code
            if code not in self.faults:
                self.faults.append(code)
        balancing = (rows["state"] == State.BALANCING) & (rows["request"] & frame.REQUEST_ENGAGED != 0)
        ticks = int(balancing.sum())
        if ticks < len(rows):  # otherwise no copy is needed
            rows, truth = rows[balancing], None if truth is None else truth[balancing]
        if truth is not None:
            self._absorb_errors(rows, truth)
        else:
            self._absorb_tilt(self.judge.estimated_tilt(rows))
        self.balancing_ticks += ticks

    def _absorb_tilt(self, tilt) -> None:
        if len(tilt):
            self.tilt_square += float((tilt**2).sum())
            self.tilt_max = max(self.tilt_max, float(tilt.max()))

    def _absorb_errors(self, rows, truth) -> None:
        self._absorb_tilt(self.judge.tilt(truth))
        skip = max(0, self.settle_ticks - self.balancing_ticks)
        rows, truth = rows[skip:], truth[skip:]
        if not len(rows):
            return
        self.counted += len(rows)
        n = len(self.names)
        tilt, rate = self.judge.squared_errors(rows["estimates"][:, :n], truth)
        self.tilt_error[:n] += tilt.sum(axis=0)
        self.rate_error[:n] += rate.sum(axis=0)
        self.yaw_rate += float(truth["yaw_rate_rad_s"].sum())
        self.speed += float(np.hypot(truth["velocity_x_m_s"], truth["velocity_y_m_s"]).sum())
        self.position_error_max = max(self.position_error_max, float(self.judge.position_error(rows, truth).max()))

    def report(self, supervisor_state, scheduling, log_path, robot, controller, seed, tipped) -> dict:
        """The JSON object of the contract; error keys only where a truth was absorbed."""
        span_s = (self.last_edge_ns - self.first_edge_ns) * 1e-9 if self.ticks > 1 else 0.0
        latency = {}
        for stage, parts in self.latency_ns.items():
            values = np.concatenate(parts) / 1000.0 if parts else np.zeros(1)
            numbers = {name: round(float(np.percentile(values, q)), 1) for name, q in PERCENTILES}
            latency[stage] = numbers
        fakes = latency.pop("fakes")
        n = max(self.balancing_ticks, 1)
        report = {
            "robot": robot,
            "estimator": self.names[0],
            "controller": controller,
            "seed": seed,
            "duration_s": round(span_s + self.dt_s, 3),
            "ticks": self.ticks,
            "rate_hz": round((self.ticks + self.missed - self.first_missed - 1) / span_s, 4) if span_s else 0.0,
            "missed": self.missed,
            "latency_us": latency,
            "tilt_rms_rad": math.sqrt(self.tilt_square / n),
            "tilt_max_rad": self.tilt_max,
            "balanced_s": round(self.balancing_ticks * self.dt_s, 3),
            "state": supervisor_state.name,
            "fell": bool(tipped or "tipped" in self.faults),
            "faults": self.faults,
            "log": str(log_path),
            "scheduling": scheduling,
        }
        if self.counted:
            errors = {
                name: {
                    "tilt_rms_error_rad": math.sqrt(self.tilt_error[slot] / self.counted),
                    "ball_speed_rms_error_rad_s": math.sqrt(self.rate_error[slot] / self.counted),
                }
                for slot, name in enumerate(self.names)
            }
            report |= errors[self.names[0]]
            report |= {
                "position_error_max_m": self.position_error_max,
                "yaw_rate_mean_rad_s": self.yaw_rate / self.counted,
                "speed_mean_m_s": self.speed / self.counted,
                "estimators": errors,
                "fakes_us": fakes,
            }
        return report


def render(report: dict) -> str:
    """The same for people."""
    latency = report["latency_us"]
    lines = [
        f"{report['ticks']} ticks, {report['duration_s']:.1f} s at {report['rate_hz']:.2f} Hz, {report['missed']} missed; "
        f"balanced for {report['balanced_s']:.1f} s, now {report['state']}",
        "latency in microseconds      p50      p99    p99.9      max",
    ]
    for stage in STAGES:
        v = latency[stage]
        lines.append(f"  {stage:<20} {v['p50']:>9} {v['p99']:>8} {v['p999']:>8} {v['max']:>8}")
    if "fakes_us" in report:
        v = report["fakes_us"]
        lines.append(f"  {'(fakes, left out)':<20} {v['p50']:>9} {v['p99']:>8} {v['p999']:>8} {v['max']:>8}")
    lines.append(f"tilt {report['tilt_rms_rad'] * 1000:.1f} mrad rms, {report['tilt_max_rad'] * 1000:.1f} mrad at most")
    if "estimators" in report:
        lines.append(f"position at most {report['position_error_max_m'] * 100:.1f} cm from its reference")
        lines.append("estimator            tilt error (mrad rms)   ball speed error (rad/s rms)")
        for name, error in report["estimators"].items():
            tilt, rate = error["tilt_rms_error_rad"], error["ball_speed_rms_error_rad_s"]
            lines.append(f"  {name:<20} {tilt * 1000:>18.2f} {rate:>26.3f}")
    if report["faults"]:
        lines.append("faults: " + ", ".join(report["faults"]))
    lines.append(f"log: {report['log']}")
    lines += render_recorder(report.get("recorder"))
    return "\n".join(lines)


def render_recorder(recorder: dict | None) -> list[str]:
    """What was recorded, and everything that went wrong with it."""
    if recorder is None:
        return []
    line = f"recorder {recorder['state']}: {recorder['recorded']} rows, {recorder['bytes'] / 1e6:.1f} MB in {recorder['folder']}"
    counts = (
        ("dropped", "rows lost"), ("torn", "rows torn"), ("backlog", "rows not yet written"), ("errors", "writes refused"),
        ("files_removed", "oldest files removed"), ("faults_kept", "fault files kept"), ("faults_refused", "fault files refused, remove some"),
        ("faults_lost", "fault files lost"),
    )  # fmt: skip
    told = [f"{recorder[name]} {words}" for name, words in counts if recorder[name]]
    if recorder["last_error"]:
        told.append(f"last error: {recorder['last_error']}")
    return [line] + ([f"  {', '.join(told)}"] if told else [])
