"""The supervisor: which state the robot is in, what moves it to another, and the only hands on the motors.

This page is the specification: states, conditions and transitions are data, and `Supervisor.apply` walks the rows of the present state once a
tick. A transition fires when all its conditions, and none of its blockers, have held for its time. The robot never arms by itself: the only
way out of DISARMED is a press of the arm button while no pre-arm check fails, then it must be held upright; the only way out of FAULT is the
button, and that leads to DISARMED. `mip-rt safety` prints these tables; `self_test.py` checks them at every start.
"""

from enum import IntEnum
from typing import NamedTuple

from mip_rt import frame
from mip_rt.faults import FAULTS, Fault
from mip_rt.guard_words import LOST, OK
from mip_rt.hardware import imu_status as imu
from mip_rt.prearm import BLOCKING


class State(IntEnum):
    """What the robot is doing; the number stands in the frame."""

    BOOT = 0
    CALIBRATING = 1
    DISARMED = 2
    ARMING = 3
    BALANCING = 4
    FAULT = 5


_BALANCING = State.BALANCING  # looked up in every tick, and an enumeration's members are found slowly

STATE_SENTENCES = {
    State.BOOT: "motors off, waiting for the first good packets of the IMU",
    State.CALIBRATING: "motors off, measuring the gyro's bias while still, waiting for the attitude to agree with gravity",
    State.DISARMED: "motors off, waiting for the arm button",
    State.ARMING: "motors off, button pressed, waiting to be held upright",
    State.BALANCING: "motors on",
    State.FAULT: "motors off, waiting for the button to acknowledge",
}

_ENGAGED = frame.REQUEST_ENGAGED
_REQUESTS_KEPT = ~frame.REQUEST_HEADING_RESET  # this one is for one tick

# Conditions are the bits of one number: the supervisor's own, then the frame's imu_status, limits and alarms as a step returns them.
_STATUS, _LIMITS, _ALARMS = frame.STATUS_AT, frame.LIMITS_AT, frame.ALARMS_AT


def _limit(name: str) -> int:
    return frame.LIMITS[name] << _LIMITS


class Condition:
    """Bits that are true or false in each tick."""

    CALIBRATED = 1 << 0
    BUTTON = 1 << 1
    READY = 1 << 2
    UPRIGHT = 1 << 3
    MOTOR_ERROR = 1 << 4
    IMU_BAD = 1 << 5
    GUARD_DROPPED = 1 << 6
    GUARD_LOST = 1 << 7
    IMU_GOOD = imu.IMU_OK << _STATUS
    IMU_NO_DATA = imu.IMU_NO_DATA << _STATUS
    IMU_MISALIGNED = imu.IMU_MISALIGNED << _STATUS
    IMU_BAD_NORM = imu.IMU_BAD_NORM << _STATUS
    IMU_IS_FROZEN = imu.IMU_FROZEN << _STATUS
    I2C_ERROR = imu.IMU_BUS_ERROR << _STATUS
    I2C_TIMEOUT = imu.IMU_BUS_TIMEOUT << _STATUS
    TIPPED = _limit("tipped")
    NOT_FINITE = _limit("not_finite")
    ESTIMATOR_SICK = _limit("estimator_reset")
    ALARMS = {name: bit << _ALARMS for name, bit in frame.ALARMS.items()}


CONDITION_SENTENCES = {
    Condition.CALIBRATED: "gyro bias known, attitude and accelerometer agree",
    Condition.BUTTON: "arm button pressed",
    Condition.READY: "no pre-arm check fails",
    Condition.UPRIGHT: "lean within limits.engage_tilt_rad",
    Condition.MOTOR_ERROR: "the motors refused a write",
    Condition.IMU_BAD: "no usable IMU packet",
    Condition.GUARD_DROPPED: "the guard took the enable line away: the loop's heartbeat was too old",
    Condition.GUARD_LOST: "the guard's own heartbeat is too old, or it refuses",
    Condition.IMU_GOOD: "a usable IMU packet",
    Condition.IMU_NO_DATA: "the FIFO was empty",
    Condition.IMU_MISALIGNED: "the FIFO was out of step",
    Condition.IMU_BAD_NORM: "the quaternion is not of length 1",
    Condition.IMU_IS_FROZEN: "the tenth equal packet",
    Condition.I2C_ERROR: "the I2C bus refused twice",
    Condition.I2C_TIMEOUT: "the I2C bus hung",
    Condition.TIPPED: frame.LIMIT_SENTENCES["tipped"],
    Condition.NOT_FINITE: frame.LIMIT_SENTENCES["not_finite"],
    Condition.ESTIMATOR_SICK: frame.LIMIT_SENTENCES["estimator_reset"],
    **{Condition.ALARMS[name]: sentence for name, sentence in frame.ALARM_SENTENCES.items()},
}


class Transition(NamedTuple):
    """From a state, when all `conditions` hold and no `blockers` do for `hold_s`, to another state."""

    conditions: int
    blockers: int
    hold: str | float  # seconds, or the name of a limit in the configuration
    to: State
    fault: str = "none"


C = Condition
_IMU_GOOD, _BUTTON = C.IMU_GOOD, C.BUTTON  # looked at in every tick, and a class's attributes are found slowly
THREE_TICKS = 0.015
# The first row that fires wins, so a fault with a cause comes before the one that only says "bad".
_FAILURES = (
    Transition(C.GUARD_LOST, 0, 0.0, State.FAULT, "guard_lost"),
    Transition(C.GUARD_DROPPED, 0, 0.0, State.FAULT, "guard_dropped"),  # whatever else is seen after a standstill follows from it
    Transition(C.I2C_TIMEOUT, 0, 0.0, State.FAULT, "i2c_timeout"),
    Transition(C.IMU_IS_FROZEN, 0, 0.0, State.FAULT, "imu_frozen"),
    Transition(C.I2C_ERROR, 0, THREE_TICKS, State.FAULT, "i2c_error"),
    Transition(C.IMU_MISALIGNED, 0, THREE_TICKS, State.FAULT, "fifo_misaligned"),
    Transition(C.IMU_BAD_NORM, 0, THREE_TICKS, State.FAULT, "quaternion_invalid"),
    Transition(C.IMU_NO_DATA, 0, THREE_TICKS, State.FAULT, "imu_no_data"),
    Transition(C.IMU_BAD, 0, THREE_TICKS, State.FAULT, "imu_bad"),
)
TRANSITIONS = {
    State.BOOT: (Transition(C.IMU_GOOD, 0, 0.05, State.CALIBRATING),),
    State.CALIBRATING: (*_FAILURES, Transition(C.CALIBRATED, 0, 0.0, State.DISARMED)),
    State.DISARMED: (*_FAILURES, Transition(C.BUTTON | C.READY, 0, 0.0, State.ARMING)),
    State.ARMING: (
        *_FAILURES,
        Transition(C.BUTTON, 0, 0.0, State.DISARMED),
        Transition(0, C.READY, 0.0, State.DISARMED),
        Transition(C.UPRIGHT, 0, "engage_hold_s", State.BALANCING),
        Transition(0, 0, "arming_timeout_s", State.DISARMED),
    ),
    State.BALANCING: (
        *_FAILURES,
        Transition(C.TIPPED, 0, 0.0, State.FAULT, "tipped"),
        Transition(C.MOTOR_ERROR, 0, 0.0, State.FAULT, "motor_write"),
        Transition(C.NOT_FINITE, 0, THREE_TICKS, State.FAULT, "not_finite"),
        Transition(C.ESTIMATOR_SICK, 0, THREE_TICKS, State.FAULT, "estimator"),
        *(Transition(bit, 0, 0.0, State.FAULT, name) for name, bit in C.ALARMS.items()),
        Transition(C.BUTTON, 0, 0.0, State.DISARMED),
    ),
    State.FAULT: (Transition(C.BUTTON, C.TIPPED | C.IMU_BAD | C.GUARD_LOST, 0.0, State.DISARMED),),
}


class Supervisor:
    """Runs the table and writes the motors.

    Args:
        motors: the only handle to the motors; nobody else may use it from now on.
        limits: the configuration's limits section.

    Attributes:
        state: the state in force.
        fault: the last Fault; FAULTS["none"] before the first.
        events: list of (tick, State, fault code) since the start, bounded.
        refusals: bits of the pre-arm checks that fail at present (prearm.CHECKS).
        request: bits for frame.request in the next tick.
        drive_scale: soft start, 0 to 1.
        calibrated: the gyro's bias is known.
    """

    EVENTS = 256

    def __init__(self, motors, limits, dt_s: float, soft_start_s: float):
        self._motors = motors
        self._scale_step = dt_s / max(soft_start_s, dt_s)
        self._table = {
            state: tuple(
                (t.conditions, t.blockers, self.ticks(t.hold, limits, dt_s), t.to, FAULTS[t.fault]) for t in rows
            )
            for state, rows in TRANSITIONS.items()
        }
        # Without any of these bits no row of the state can hold: most ticks end there.
        self._triggers = {
            state: -1 if any(t.conditions == 0 for t in rows) else sum({1 << bit for t in rows for bit in range(64) if t.conditions >> bit & 1})
            for state, rows in TRANSITIONS.items()
        }
        self.state = State.BOOT
        self.fault = FAULTS["none"]
        self.events = []
        self._standing = 0  # conditions that hold until told otherwise
        self.refusals = 0
        self.calibrated = False
        self.request = 0
        self.drive_scale = 0.0
        self._counting = False
        self._counts = [0] * max(len(rows) for rows in self._table.values())
        self._motors.off()

    @staticmethod
    def ticks(hold, limits, dt_s: float) -> int:
        """Ticks of a transition's hold time, at least one."""
        seconds = getattr(limits, hold) if isinstance(hold, str) else hold
        return max(1, round(seconds / dt_s))

    def attach(self, rows) -> None:
        """The pulses to apply stand in these rows of frames."""
        self._motors.attach(rows)

    @property
    def refusals(self) -> int:
        """See the class."""
        return self._refusals

    @refusals.setter
    def refusals(self, bits: int) -> None:
        """They decide whether READY holds."""
        self._refusals = bits
        self._stands(C.READY, not bits & BLOCKING)

    @property
    def calibrated(self) -> bool:
        """See the class."""
        return bool(self._standing & C.CALIBRATED)

    @calibrated.setter
    def calibrated(self, known: bool) -> None:
        """Told once the bias is known."""
        self._stands(C.CALIBRATED, known)

    def press(self) -> None:
        """The arm button was pressed."""
        self._standing |= _BUTTON

    def request_heading_reset(self) -> None:
        """The present heading becomes forward, at the next tick."""
        self.request |= frame.REQUEST_HEADING_RESET

    def imu_silent(self, tick: int) -> None:
        """No interrupt came in time: motors off now, whatever the state."""
        self._motors.off()
        if self.state not in (State.BOOT, State.FAULT):
            self._enter(State.FAULT, FAULTS["imu_silent"], tick)

    def apply(self, tick: int, conditions: int, upright: bool, index: int, guard: int = OK) -> bool:
        """Evaluates the table for this tick and writes the motors accordingly.

        Args:
            conditions: what the tick's step has returned: see frame.STATUS_AT.
            upright: lean within limits.engage_tilt_rad; looked at only while arming.
            index: row of the frame whose pulses are meant.
            guard: what the guard answers to this tick's heartbeat: guard_words.OK, LINE_DROPPED or LOST.

        Returns:
            True where the pulses were let through to the motors.
        """
        conditions |= self._standing
        if not conditions & _IMU_GOOD:
            conditions |= C.IMU_BAD
        if conditions & _BUTTON:
            self._standing &= ~_BUTTON
        if upright:
            conditions |= C.UPRIGHT
        if guard:
            conditions |= C.GUARD_LOST if guard == LOST else C.GUARD_DROPPED
            if guard == LOST:
                self._motors.give_up()

        self.request &= _REQUESTS_KEPT
        if self._counting or conditions & self._triggers[self.state]:
            self._walk(conditions, tick)
        if self.state is not _BALANCING:
            return False
        if not self.request & _ENGAGED:  # the step has not run engaged yet: enable, start at zero
            self.request |= _ENGAGED
            self._stands(C.MOTOR_ERROR, not self._motors.enable())
            return False
        obeyed = self._motors.write(index)
        if not obeyed:
            self._standing |= C.MOTOR_ERROR
        if self.drive_scale < 1.0:
            self.drive_scale = min(1.0, self.drive_scale + self._scale_step)
        return obeyed

    def _stands(self, condition: int, true: bool) -> None:
        """What holds in every tick until told otherwise."""
        self._standing = self._standing | condition if true else self._standing & ~condition

    def _walk(self, conditions: int, tick: int) -> None:
        counts = self._counts
        self._counting = False
        row = 0
        for required, blocking, ticks, to, fault in self._table[self.state]:
            if conditions & required == required and not conditions & blocking:
                counts[row] += 1
                self._counting = True
                if counts[row] >= ticks:
                    self._enter(to, fault, tick)
                    return
            else:
                counts[row] = 0
            row += 1

    def _enter(self, to: State, fault: Fault, tick: int) -> None:
        if self.state is State.BALANCING:
            self._motors.off()
        self.state = to
        self.request = 0
        self.drive_scale = 0.0
        self._stands(C.MOTOR_ERROR, False)
        self._counting = False
        for i in range(len(self._counts)):
            self._counts[i] = 0
        if to is State.FAULT:
            self.fault = fault
        if len(self.events) < self.EVENTS:
            self.events.append((tick, to, fault.code))

    def shut_down(self) -> None:
        """Motors off for good; called on every way out."""
        self._motors.off()
        self.request = 0
