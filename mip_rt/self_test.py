"""The supervisor's own test, run at every start: is the table what it promises, and does every failure really lead to motors off?

Only where it finds nothing may the robot arm.
"""

from mip_rt import frame
from mip_rt.faults import FAULTS
from mip_rt.guard_words import LINE_DROPPED, LOST, OK
from mip_rt.supervisor import CONDITION_SENTENCES, TRANSITIONS, Condition, State, Supervisor

OWN = (1 << frame.STATUS_AT) - 1  # conditions that the supervisor finds itself
IMU = (1 << frame.LIMITS_AT) - 1 & ~OWN  # those that come from the IMU's status


class _Motors:
    """Remembers whether they are on."""

    def __init__(self):
        self.on = False

    def give_up(self) -> None:
        pass

    def enable(self) -> bool:
        self.on = True
        return True

    def write(self, index: int) -> bool:
        return True

    def off(self) -> None:
        self.on = False


def check_table(transitions=TRANSITIONS):
    """Yields a sentence for everything that is wrong with the table."""
    if set(transitions) != set(State):
        yield "a state has no transitions"
    for state, rows in transitions.items():
        for row in rows:
            if row.fault not in FAULTS:
                yield f"{state.name} names the unknown fault {row.fault!r}"
            elif (row.to is State.FAULT) != (row.fault != "none"):
                yield f"{state.name} to {row.to.name}: a fault needs its reason, and only a fault has one"
            if row.to is State.BALANCING and (state is not State.ARMING or not row.conditions & Condition.UPRIGHT):
                yield f"{state.name} leads to BALANCING without arming or without being upright"
            if row.to is State.ARMING and (
                state is not State.DISARMED or row.conditions & (Condition.BUTTON | Condition.READY) != Condition.BUTTON | Condition.READY
            ):
                yield f"{state.name} leads to ARMING without a press of the button or without the pre-arm checks"
            if state is State.FAULT and (row.to is not State.DISARMED or not row.conditions & Condition.BUTTON):
                yield "FAULT is left without a press of the button"
    reached = {row.to for rows in transitions.values() for row in rows} | {State.BOOT}
    if reached != set(State):
        yield "a state cannot be reached"
    raised = {row.fault for row in transitions.get(State.BALANCING, ())}
    for name in frame.ALARMS:
        if name not in raised:
            yield f"the alarm {name} is not acted upon while balancing"


def _balancing(limits, dt_s: float):
    """A supervisor in BALANCING with its motors on."""
    supervisor = Supervisor(_Motors(), limits, dt_s, 0.0)
    supervisor._enter(State.BALANCING, FAULTS["none"], 0)
    for tick in range(2):
        supervisor.apply(tick, Condition.IMU_GOOD, True, 0)
    return supervisor


def check_reactions(limits, dt_s: float, transitions=TRANSITIONS):
    """Yields a sentence for every failure that does not switch the motors off within its time."""
    for row in transitions[State.BALANCING]:
        if row.to is not State.FAULT:
            continue
        supervisor = _balancing(limits, dt_s)
        if not supervisor._motors.on:
            yield "the motors do not go on while balancing"
            return
        found = row.conditions & ~OWN
        if row.conditions & (Condition.MOTOR_ERROR | Condition.IMU_BAD) == 0 and not found & IMU:
            found |= Condition.IMU_GOOD
        guard = LOST if row.conditions & Condition.GUARD_LOST else LINE_DROPPED if row.conditions & Condition.GUARD_DROPPED else OK
        for tick in range(Supervisor.ticks(row.hold, limits, dt_s)):
            if row.conditions & Condition.MOTOR_ERROR:
                supervisor._standing |= Condition.MOTOR_ERROR
            supervisor.apply(tick, found, True, 0, guard)
        if supervisor._motors.on or supervisor.state is not State.FAULT:
            yield f"{row.fault} does not switch the motors off: {CONDITION_SENTENCES.get(row.conditions, hex(row.conditions))}"
    supervisor = _balancing(limits, dt_s)
    supervisor.imu_silent(0)
    if supervisor._motors.on or supervisor.state is not State.FAULT:
        yield "a silent IMU does not switch the motors off"
    for state in State:
        supervisor = Supervisor(_Motors(), limits, dt_s, 0.0)
        supervisor.state = state
        if state is not State.BALANCING and (supervisor.apply(0, Condition.IMU_GOOD, True, 0) or supervisor._motors.on):
            yield f"motors are on in {state.name}"


def run(limits, dt_s: float) -> list[str]:
    """Everything that is wrong; empty where the supervisor does what it promises."""
    return [*check_table(), *check_reactions(limits, dt_s)]
