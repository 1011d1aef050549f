"""The verb `mip-rt safety`: the safety section of the README, from the tables that the program runs on."""

from mip_rt import frame, prearm
from mip_rt.faults import FAULTS
from mip_rt.supervisor import CONDITION_SENTENCES, STATE_SENTENCES, TRANSITIONS, State

BEGIN, END = "<!-- safety:begin -->", "<!-- safety:end -->"


def _conditions(bits: int) -> str:
    named = {sentence: bit for bit, sentence in CONDITION_SENTENCES.items() if bits & bit}
    return " and ".join(named) or "any tick"


def _hold(hold) -> str:
    if isinstance(hold, str):
        return f"`limits.{hold}`"
    return f"{hold * 1000:g} ms" if hold else "one tick"


def _table(head: tuple, rows) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in rows])


def _transitions():
    """One row a transition; what every state does about a failing IMU stands once, and so do the alarms."""
    shared = [row for row in TRANSITIONS[State.BALANCING] if row in TRANSITIONS[State.DISARMED]]
    for row in shared:
        yield "CALIBRATING, DISARMED, ARMING, BALANCING", _conditions(row.conditions), _hold(row.hold), f"FAULT `{row.fault}`"
    for state, rows in TRANSITIONS.items():
        for row in rows:
            if row in shared:
                continue
            what = _conditions(row.conditions) if row.conditions else ""
            unless = _conditions(row.blockers) if row.blockers else ""
            words = what + (f", unless {unless.replace(' and ', ' or ')}" if what and unless else f"unless {unless}" if unless else "")
            yield state.name, words or "any tick", _hold(row.hold), row.to.name + (f" `{row.fault}`" if row.fault != "none" else "")


def _time(seconds: float) -> str:
    return f"{seconds * 1000:.0f} ms" if seconds < 1.0 else f"{seconds:g} s"


def markdown() -> str:
    """States, transitions, faults with their bounds, limits, pre-arm checks."""
    faults = [fault for fault in FAULTS.values() if fault.number]
    silent = ("any but BOOT, FAULT", "no interrupt of the IMU", "`limits.imu_silence_s`", "FAULT `imu_silent`")
    parts = [
        "The robot never arms by itself: a process start, a crash, a restart by the watchdog, a reconnected remote all leave it DISARMED or in FAULT.",
        _table(("state", "meaning"), ((state.name, sentence) for state, sentence in STATE_SENTENCES.items())),
        "A row fires when its conditions have held for its time; the first one wins.",
        _table(("from", "when", "for", "to"), [silent, *_transitions()]),
        "Faults: motors off within the bound, counted from the cause; the button acknowledges.",
        _table(("fault", "what happened", "cure", "bound", "reaction"),
               ((f"`{f.code}`", f.sentence, f.cure, _time(f.bound_s), f.reaction) for f in faults)),
        "Limits: what a tick limited, replaced or refused without stopping (`limits` in the log).",
        _table(("limit", "meaning"), ((f"`{name}`", sentence) for name, sentence in frame.LIMIT_SENTENCES.items())),
        "Pre-arm checks: while one that refuses fails, the button does nothing; the status line names it each second (`refusals` in the log).",
        _table(("check", "what is wrong", "cure", "effect"),
               ((f"`{c.code}`", c.sentence, c.cure, "refuses" if c.blocks else "warns") for c in prearm.CHECKS.values())),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def add_arguments(parser) -> None:
    """The verb has no arguments."""


def run(arguments) -> int:
    """Prints the section."""
    print(markdown(), end="")
    return 0
