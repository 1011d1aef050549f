"""What happened in a log, as lists of plain dictionaries: states, faults, limits, latencies, missing rows."""

import numpy as np

from mip_rt.frame import LIMITS
from mip_rt.hardware import imu_status
from mip_rt.supervisor import FAULT_BY_NUMBER, State

STAGES = ("wake", "read", "step", "write", "edge_to_write")
IMU_BITS = {name[4:].lower(): bit for name, bit in vars(imu_status).items() if name.startswith("IMU_") and bit != imu_status.IMU_OK}
BEFORE_S = 1.0  # what "before a fault" means


def state_name(number: int) -> str:
    """Name of a supervisor state; its number where this program does not know it."""
    try:
        return State(number).name
    except ValueError:
        return f"state {number}"


def stage_ns(frames) -> dict[str, np.ndarray]:
    """(n,) nanoseconds by stage of a tick; a dry run's include what its fakes took."""
    edge, wake, read, step, write = (frames[f"{name}_ns"] for name in ("edge", "wake", "read", "step", "write"))
    return dict(zip(STAGES, (wake - edge, read - wake, step - read, write - step, write - edge), strict=True))


def moment(frames, times_s, row: int) -> dict:
    """Time and tick of a row."""
    return {"time_s": round(float(times_s[row]), 6), "tick": int(frames["tick"][row])}


def transitions(frames, times_s) -> list[dict]:
    """Changes of the supervisor's state; the first entry is the state at the log's beginning (`before` is then None)."""
    states = frames["state"]
    rows = [0, *(np.flatnonzero(states[1:] != states[:-1]) + 1).tolist()]
    return [
        {**moment(frames, times_s, row), "before": state_name(states[row - 1]) if row else None, "state": state_name(states[row])}
        for row in rows
    ]


def fault_rows(frames) -> list[int]:
    """Rows in which a fault was in force for the first time.

    A fault's number is in the row that caused it, or, where no interrupt came any more, in the next one; the number remains after the
    fault was acknowledged, so that the same fault a second time shows in the state only.
    """
    number, state = frames["fault"], frames["state"]
    entered = (state[1:] == State.FAULT) & (state[:-1] != State.FAULT)
    rows = []
    for row in (np.flatnonzero(entered) + 1).tolist():
        caused = row - 1
        rows.append(caused if number[caused] == number[row] and (caused == 0 or number[caused - 1] != number[row]) else row)
    if state[0] == State.FAULT:
        rows.insert(0, 0)
    if number[-1] and state[-1] != State.FAULT and len(frames) > 1 and number[-2] != number[-1]:
        rows.append(len(frames) - 1)  # the log ends with the tick that caused the fault
    return rows


def faults(frames, times_s) -> list[dict]:
    """Faults with code, sentence and cure, and what was limited in the second before each."""
    found = []
    for row in fault_rows(frames):
        number = int(frames["fault"][row])
        fault = FAULT_BY_NUMBER.get(number)
        words = {"code": fault.code, "sentence": fault.sentence, "cure": fault.cure} if fault else {
            "code": f"fault {number}", "sentence": "this program does not know the number", "cure": ""}  # fmt: skip
        before = frames[(times_s > times_s[row] - BEFORE_S) & (times_s <= times_s[row])]
        found.append({**moment(frames, times_s, row), **words, "limits_before": {n: v["ticks"] for n, v in limits(before).items()}})
    return found


def in_words(ticks: dict) -> str:
    """Counts of ticks by name, as part of a sentence."""
    return ", ".join(f"{name} in {count} tick{'s' * (count != 1)}" for name, count in ticks.items())


def limits(frames, times_s=None) -> dict[str, dict]:
    """By name of each limit that was applied: number of ticks, and first and last time where times are given."""
    return _bits(frames, times_s, frames["limits"], LIMITS)


def imu_troubles(frames, times_s=None) -> dict[str, dict]:
    """Likewise for what the IMU's reading returned beside a good packet."""
    return _bits(frames, times_s, frames["imu_status"], IMU_BITS)


def _bits(frames, times_s, words, names: dict) -> dict[str, dict]:
    known = dict(names)
    extra = int(np.bitwise_or.reduce(words)) & ~sum(names.values()) if len(words) and names is LIMITS else 0
    known |= {f"bit {bit}": 1 << bit for bit in range(63) if extra >> bit & 1}
    found = {}
    for name, bit in known.items():
        rows = np.flatnonzero(words & bit)
        if len(rows):
            found[name] = {"bit": bit, "ticks": len(rows)}
            if times_s is not None:
                found[name] |= {"first_s": round(float(times_s[rows[0]]), 6), "last_s": round(float(times_s[rows[-1]]), 6)}
    return found


def gaps(frames, times_s) -> list[dict]:
    """Where rows are missing in the log although the loop ran: ticks that were dropped by the recorder or damaged."""
    ticks = frames["tick"]
    lost = ticks[1:] - ticks[:-1] - 1
    return [{**moment(frames, times_s, row + 1), "lost": int(lost[row])} for row in np.flatnonzero(lost > 0).tolist()]


def missed(frames, times_s) -> list[dict]:
    """Rows before which interrupts went by without a tick."""
    return [{**moment(frames, times_s, row), "missed": int(frames["missed"][row])} for row in np.flatnonzero(frames["missed"] > 0).tolist()]
