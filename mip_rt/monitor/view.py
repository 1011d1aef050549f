"""What is shown of a run: the newest row and the last ten seconds, in the words of the tables that name states, faults, checks and limits.

A robot's own fields are used where the header's table has them. Nothing here knows where rows come from or how they are drawn.
"""

import numpy as np

from mip_rt.frame import LIMIT_SENTENCES
from mip_rt.log.codes import Codes
from mip_rt.log.configuration import as_dict
from mip_rt.log.events import stage_ns
from mip_rt.monitor import pose
from mip_rt.monitor.pose import number
from mip_rt.prearm import failing
from mip_rt.summary import STAGES

HISTORY_S = 10.0  # what "recent" means: tilt, latencies, limits
HINTS = {
    "BOOT": "waiting for the IMU's first good packets",
    "CALIBRATING": "keep the robot still: its gyro is being measured",
    "DISARMED": "ready: press the arm button",
    "ARMING": "hold the robot upright",
    "FAULT": "press the arm button to acknowledge",
}
# Edges of the latency histogram, microseconds: ten a decade, from 1 microsecond to 100 ms.
HISTOGRAM_US = np.concatenate(([0.0], 10.0 ** np.linspace(0.0, 5.0, 51), [np.inf]))


class View:
    """One run as seen so far.

    Args:
        header: what the ring says of itself (`log.ring.header`).
        dtype: record type of its rows.

    Attributes:
        config: the run's configuration as plain dictionaries.
        row: newest row, None before the first.
    """

    def __init__(self, header: dict, dtype: np.dtype):
        self.header, self.names = header, dtype.names
        self.config = as_dict(header["config"])
        self.rate_hz = float(self.config.get("realtime", {}).get("rate_hz", 200.0))
        self.kept = round(HISTORY_S * self.rate_hz)
        self.row = None
        self._codes, self._pose = Codes(header), pose.of_robot(header, self.config)
        self._origin_ns = 0
        self._tilt_rad = np.zeros(0)
        self._latency_us = np.zeros((0, len(STAGES)))
        self._timing = np.zeros((0, 2), np.int64)  # edge time, missed ticks
        self._limit_seen_ns, self._limit_bit = {}, {}
        self._state_since_ns = self._fault_since_ns = None

    def take(self, rows) -> None:
        """Takes in rows that follow those taken before."""
        if not len(rows):
            return
        if self.row is None:
            self._origin_ns = int(rows["edge_ns"][0]) - round(int(rows["tick"][0]) * 1e9 / self.rate_hz)
        self._note_changes(rows)
        self.row = rows[-1]
        self._pose.follow(rows)
        self._tilt_rad = np.concatenate((self._tilt_rad, self._pose.tilt_rad(rows)))[-self.kept :]
        stages_us = np.stack(list(stage_ns(rows).values()), axis=1) / 1000.0
        self._latency_us = np.concatenate((self._latency_us, stages_us))[-self.kept :]
        self._timing = np.concatenate((self._timing, np.stack((rows["edge_ns"], rows["missed"]), axis=1)))[-self.kept :]

    def time_s(self, rows):
        """Seconds since the loop's first tick, for rows or one row."""
        return (rows["edge_ns"] - self._origin_ns) * 1e-9

    def _note_changes(self, rows) -> None:
        edges, states = rows["edge_ns"], rows["state"]
        seen = int(np.bitwise_or.reduce(rows["limits"]))
        for name, bit in self._codes.limits_in(rows["limits"]).items():
            if seen & bit:
                self._limit_bit[name] = bit
                self._limit_seen_ns[name] = int(edges[np.flatnonzero(rows["limits"] & bit)[-1]])
        changed = np.flatnonzero(np.diff(states, prepend=states[0] if self.row is None else self.row["state"]))
        if len(changed):
            self._state_since_ns = int(edges[changed[-1]])
        # Not where the number changes: the same fault may come again, and the number stays after it was acknowledged.
        faults = changed[states[changed] == self._codes.fault_state]
        if len(faults):
            self._fault_since_ns = int(edges[faults[-1]])

    # -- what is shown ---------------------------------------------------------------------------------------------------
    def show(self) -> dict:
        """The newest row and what is recent but latencies, ready for JSON; names carry the units. Empty before the first row."""
        row = self.row
        if row is None:
            return {}
        state = self._codes.state(row["state"])
        return {
            "tick": int(row["tick"]),
            "time_s": number(self.time_s(row), 3),
            "state": state,
            "state_s": self._ago_s(self._state_since_ns),
            "hint": self._hint(state),
            "why_not_armed": self.why_not_armed(),
            "rate_hz": self._rate_hz(),
            "missed": int(self._timing[:, 1].sum()),
            **self._pose.show(row),
            "tilt_rad": number(self._tilt_rad[-1]),
            "tilt_max_rad": number(self._tilt_rad.max()),
            "velocity_command_m_s": [number(v) for v in row["remote_velocity_m_s"]],
            "yaw_rate_command_rad_s": number(row["remote_yaw_rate_rad_s"]),
            "yaw_rate_rad_s": number(row["gyro_rad_s"][2]),
            "duty": [number(v) for v in row["duty"]],
            "motors_on": bool(np.any(row["applied_ns"])),
            "battery_v": number(row["battery_v"], 3),
            "remote_age_s": number(row["remote_age_s"], 3),
            "limits": self._limits(),
            "fault": self._fault(),
        }

    def tilt_history_rad(self):
        """Tilt of the last ten seconds, oldest first."""
        return self._tilt_rad

    def why_not_armed(self) -> list[dict]:
        """The pre-arm checks that fail while the motors are off; those that only warn say so."""
        if "refusals" not in self.names or self.row["state"] == self._codes.balancing_state:
            return []
        return [
            {"code": check.code, "sentence": check.sentence, "cure": check.cure, "blocks": check.blocks}
            for check in failing(int(self.row["refusals"]))
        ]

    def latency_us(self) -> dict:
        """Median, 99th percentile and maximum of each stage over the last ten seconds."""
        median, high = np.percentile(self._latency_us, (50.0, 99.0), axis=0)
        most = self._latency_us.max(axis=0)
        return {
            stage: {"p50": number(median[i], 1), "p99": number(high[i], 1), "max": number(most[i], 1)}
            for i, stage in enumerate(STAGES)
        }

    def histograms(self) -> dict:
        """Counts of each stage's latencies of the last ten seconds, by the bins of HISTOGRAM_US."""
        return {stage: np.histogram(self._latency_us[:, i], HISTOGRAM_US)[0].tolist() for i, stage in enumerate(STAGES)}

    def _hint(self, state: str) -> str:
        blocked = [check for check in self.why_not_armed() if check["blocks"]]
        if blocked and state != "FAULT":
            return f"{blocked[0]['sentence']} {blocked[0]['cure']}"
        return HINTS.get(state, "")

    def _ago_s(self, since_ns):
        return None if since_ns is None else number((int(self.row["edge_ns"]) - since_ns) * 1e-9, 1)

    def _rate_hz(self):
        edges, missed = self._timing[:, 0], self._timing[1:, 1]
        span_ns = int(edges[-1] - edges[0])
        return number((len(missed) + int(missed.sum())) * 1e9 / span_ns, 2) if span_ns > 0 else None

    def _limits(self) -> list[dict]:
        """Limits in force (ago_s 0) and those of the last ten seconds, newest first."""
        ages = {name: self._ago_s(seen) for name, seen in self._limit_seen_ns.items()}
        recent = sorted((age, name) for name, age in ages.items() if age <= HISTORY_S)
        now = int(self.row["limits"])
        return [
            {"name": name, "sentence": LIMIT_SENTENCES.get(name, ""), "now": bool(now & self._limit_bit[name]), "ago_s": age}
            for age, name in recent
        ]

    def _fault(self):
        """The last fault, None where there was none."""
        if not self.row["fault"]:
            return None
        active = bool(self.row["state"] == self._codes.fault_state)
        return {**self._codes.fault_words(self.row["fault"]), "active": active, "ago_s": self._ago_s(self._fault_since_ns)}
