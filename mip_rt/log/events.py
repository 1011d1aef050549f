"""What happened in a log, as lists of plain dictionaries: states, faults, limits, latencies, missing rows."""

import numpy as np

from mip_rt.summary import STAGES

BEFORE_S = 1.0  # what "before a fault" means


def stage_ns(frames) -> dict[str, np.ndarray]:
    """(n,) nanoseconds by stage of a tick; a dry run's include what its fakes took."""
    edge, wake, read, step, write = (frames[f"{name}_ns"] for name in ("edge", "wake", "read", "step", "write"))
    return dict(zip(STAGES, (wake - edge, read - wake, step - read, write - step, write - edge), strict=True))


def moment(frames, times_s, row: int) -> dict:
    """Time and tick of a row."""
    return {"time_s": round(float(times_s[row]), 6), "tick": int(frames["tick"][row])}


def transitions(frames, times_s, codes) -> list[dict]:
    """Changes of the supervisor's state; the first entry is the state at the log's beginning (`before` is then None)."""
    states = frames["state"]
    rows = [0, *(np.flatnonzero(states[1:] != states[:-1]) + 1).tolist()]
    return [
        {**moment(frames, times_s, row), "before": codes.state(states[row - 1]) if row else None, "state": codes.state(states[row])}
        for row in rows
    ]


def fault_rows(frames, codes) -> list[int]:
    """Rows in which a fault was in force for the first time.

    A fault's number is in the row that caused it, or, where no interrupt came any more, in the next one; the number remains after the
    fault was acknowledged, so that the same fault a second time shows in the state only.
    """
    number, state = frames["fault"], frames["state"]
    entered = (state[1:] == codes.fault_state) & (state[:-1] != codes.fault_state)
    rows = []
    for row in (np.flatnonzero(entered) + 1).tolist():
        caused = row - 1
        rows.append(caused if number[caused] == number[row] and (caused == 0 or number[caused - 1] != number[row]) else row)
    if state[0] == codes.fault_state:
        rows.insert(0, 0)
    if number[-1] and state[-1] != codes.fault_state and len(frames) > 1 and number[-2] != number[-1]:
        rows.append(len(frames) - 1)  # the log ends with the tick that caused the fault
    return rows


def faults(frames, times_s, codes) -> list[dict]:
    """Faults with code, sentence and cure, and what was limited or found by the detectors in the second before each."""
    found = []
    for row in fault_rows(frames, codes):
        before = frames[(times_s > times_s[row] - BEFORE_S) & (times_s <= times_s[row])]
        words = {f"{field}_before": {name: entry["ticks"] for name, entry in bits(before, field, codes).items()} for field in ("limits", "alarms")}
        found.append({**moment(frames, times_s, row), **codes.fault_words(frames["fault"][row]), **words})
    return found


def before_in_words(fault: dict) -> str:
    """What came in the second before a fault, as a sentence, without what the fault itself says; "" where nothing did."""
    parts = [
        title + ", ".join(f"{name} in {count} tick{'s' * (count != 1)}" for name, count in fault[key].items() if name != fault["code"])
        for title, key in (("", "limits_before"), ("alarms: ", "alarms_before")) if set(fault[key]) - {fault["code"]}
    ]  # fmt: skip
    return "in the second before: " + "; ".join(parts) if parts else ""


def bits(frames, field: str, codes, times_s=None) -> dict[str, dict]:
    """By name of each bit of a field (codes.BITS) that was set: the bit, number of ticks, and first and last time where times are given.

    Empty where the log has no such field.
    """
    found = {}
    if field not in frames.dtype.names:
        return found
    words = frames[field]
    for name, bit in codes.bits_in(field, words).items():
        rows = np.flatnonzero(words & bit)
        if len(rows):
            found[name] = {"bit": bit, "ticks": len(rows)}
            if times_s is not None:
                found[name] |= {"first_s": round(float(times_s[rows[0]]), 6), "last_s": round(float(times_s[rows[-1]]), 6)}
    return found


def limits(frames, codes, times_s=None) -> dict[str, dict]:
    """`bits` of what was limited, replaced or refused."""
    return bits(frames, "limits", codes, times_s)


def gaps(frames, times_s) -> list[dict]:
    """Where rows are missing in the log although the loop ran: ticks that were dropped by the recorder or damaged."""
    ticks = frames["tick"]
    lost = ticks[1:] - ticks[:-1] - 1
    return [{**moment(frames, times_s, row + 1), "lost": int(lost[row])} for row in np.flatnonzero(lost > 0).tolist()]


def missed(frames, times_s) -> list[dict]:
    """Rows before which interrupts went by without a tick."""
    return [{**moment(frames, times_s, row), "missed": int(frames["missed"][row])} for row in np.flatnonzero(frames["missed"] > 0).tolist()]
