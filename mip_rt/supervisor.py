"""The supervisor: which state the robot is in, what moves it to another, and the only hands on the motors.

States, conditions and transitions are data; `Supervisor.apply` walks one row after the other of the present state, once a tick.
A transition fires when all its conditions have held for its time. The robot never arms by itself: the only way out of
DISARMED is a press of the arm button, then it must be held upright.
"""

from enum import IntEnum
from typing import NamedTuple

from mip_rt import frame, prearm
from mip_rt.guard import LOST, OK
from mip_rt.hardware.imu_status import IMU_BUS_ERROR, IMU_FROZEN, IMU_OK


class State(IntEnum):
    """What the robot is doing; the number stands in the frame."""

    BOOT = 0  # waiting for the first good packets of the IMU
    CALIBRATING = 1  # measuring the gyro's bias while still, waiting for the DMP to agree with gravity
    DISARMED = 2  # motors off, waiting for the arm button
    ARMING = 3  # button pressed, waiting to be held upright
    BALANCING = 4
    FAULT = 5  # motors off; the button acknowledges


class Condition:
    """Bits that are true or false in each tick."""

    IMU_GOOD = 1 << 0
    CALIBRATED = 1 << 1
    BUTTON = 1 << 2  # pressed since the last tick
    READY = 1 << 3  # no pre-arm check fails
    UPRIGHT = 1 << 4
    TIPPED = 1 << 5
    IMU_BAD = 1 << 6
    IMU_IS_FROZEN = 1 << 7
    NOT_FINITE = 1 << 8
    MOTOR_ERROR = 1 << 9
    ESTIMATOR_SICK = 1 << 10
    GUARD_DROPPED = 1 << 11  # the guard took the enable line away: the loop's heartbeat was too old
    GUARD_LOST = 1 << 12  # the guard's own heartbeat is too old, or it refuses


class Fault(NamedTuple):
    """A reason for being in FAULT: number in the frame, code, sentence, cure."""

    number: int
    code: str
    sentence: str
    cure: str


FAULTS = {
    f.code: f
    for f in (
        Fault(0, "none", "", ""),
        Fault(1, "imu_silent", "the IMU's interrupt stopped", "check the IMU's wiring and the I2C bus; run mip-rt doctor"),
        Fault(2, "imu_bad", "three ticks in a row brought no usable IMU packet", "check the I2C bus for noise and cable length"),
        Fault(3, "imu_frozen", "the IMU repeated the same packet", "power-cycle the robot"),
        Fault(4, "tipped", "the robot leaned too far", "stand it up and press the button twice"),
        Fault(5, "not_finite", "commands were not finite for three ticks", "send the log to the developers"),
        Fault(6, "motor_write", "the motors refused a write", "check the motor driver's PWM and GPIO overlays"),
        Fault(7, "estimator", "the estimator failed three ticks in a row", "send the log to the developers"),
        Fault(8, "guard_dropped", "the loop stood still for longer than limits.guard_timeout_s, so the guard dropped the enable line",
              "look for scheduling warnings at the start and for a blocked I2C bus; press the button twice to arm again"),
        Fault(9, "guard_lost", "the guard process is gone or hangs; it cannot come back", "restart mip-rt; its journal says why the guard ended"),
    )
}
FAULT_BY_NUMBER = {f.number: f for f in FAULTS.values()}


class Transition(NamedTuple):
    """From a state, when all `conditions` hold and no `blockers` do for `hold_s`, to another state."""

    conditions: int
    blockers: int
    hold: str | float  # seconds, or the name of a limit in the configuration
    to: State
    fault: str = "none"


C = Condition
_FAILURES = (
    Transition(C.GUARD_LOST, 0, 0.0, State.FAULT, "guard_lost"),
    Transition(C.GUARD_DROPPED, 0, 0.0, State.FAULT, "guard_dropped"),  # whatever else is seen after a standstill follows from it
    Transition(C.IMU_IS_FROZEN, 0, 0.0, State.FAULT, "imu_frozen"),
    Transition(C.IMU_BAD, 0, 0.015, State.FAULT, "imu_bad"),
)
TRANSITIONS = {
    State.BOOT: (Transition(C.IMU_GOOD, 0, 0.05, State.CALIBRATING),),
    State.CALIBRATING: (Transition(C.CALIBRATED, 0, 0.0, State.DISARMED), *_FAILURES),
    State.DISARMED: (*_FAILURES, Transition(C.BUTTON | C.READY, 0, 0.0, State.ARMING)),
    State.ARMING: (
        *_FAILURES,
        Transition(C.BUTTON, 0, 0.0, State.DISARMED),
        Transition(0, C.READY, 0.0, State.DISARMED),
        Transition(C.UPRIGHT, 0, "engage_hold_s", State.BALANCING),
    ),
    State.BALANCING: (
        *_FAILURES,
        Transition(C.TIPPED, 0, 0.0, State.FAULT, "tipped"),
        Transition(C.NOT_FINITE, 0, 0.015, State.FAULT, "not_finite"),
        Transition(C.ESTIMATOR_SICK, 0, 0.015, State.FAULT, "estimator"),
        Transition(C.MOTOR_ERROR, 0, 0.0, State.FAULT, "motor_write"),
        Transition(C.BUTTON, 0, 0.0, State.DISARMED),
    ),
    State.FAULT: (Transition(C.BUTTON, C.TIPPED | C.IMU_BAD | C.IMU_IS_FROZEN | C.GUARD_LOST, 0.0, State.DISARMED),),
}


class Supervisor:
    """Runs the table and writes the motors.

    Attributes:
        state: the state in force.
        fault: the last Fault; FAULTS["none"] before the first.
        events: list of (tick, State, fault code) since the start, bounded.
        refusals: bits of the pre-arm checks that fail at present (prearm.CHECKS).
        request: bits for frame.request in the next tick.
        drive_scale: soft start, 0 to 1.
    """

    EVENTS = 256

    def __init__(self, motors, limits, dt_s: float, soft_start_s: float):
        self._motors = motors
        self._scale_step = dt_s / max(soft_start_s, dt_s)
        self._table = {
            state: tuple(
                (t.conditions, t.blockers, self._ticks(t.hold, limits, dt_s), t.to, FAULTS[t.fault]) for t in rows
            )
            for state, rows in TRANSITIONS.items()
        }
        self.state = State.BOOT
        self.fault = FAULTS["none"]
        self.events = []
        self.refusals = 0
        self.request = 0
        self.drive_scale = 0.0
        self.calibrated = False
        self._button = False
        self._motor_error = False
        self._guard = OK
        self._counts = [0] * max(len(rows) for rows in self._table.values())
        self._motors.off()

    @staticmethod
    def _ticks(hold, limits, dt_s: float) -> int:
        seconds = getattr(limits, hold) if isinstance(hold, str) else hold
        return max(1, round(seconds / dt_s))

    def press(self) -> None:
        """The arm button was pressed."""
        self._button = True

    def request_heading_reset(self) -> None:
        """The present heading becomes forward, at the next tick."""
        self.request |= frame.REQUEST_HEADING_RESET

    def imu_silent(self, tick: int) -> None:
        """No interrupt came in time: motors off now, whatever the state."""
        self._motors.off()
        if self.state not in (State.BOOT, State.FAULT):
            self._enter(State.FAULT, FAULTS["imu_silent"], tick)

    def alive(self, now_ns: int) -> None:
        """The heartbeat, once a tick before `apply`: the loop has come round to this time; and what has become of the guard meanwhile."""
        self._guard = self._motors.beat(now_ns)

    def apply(self, tick: int, imu_status: int, limits: int, upright: bool, duty_ns) -> bool:
        """Evaluates the table for this tick and writes the motors accordingly.

        Args:
            imu_status: bits IMU_* of the tick.
            limits: frame.limits of the tick.
            upright: lean within limits.engage_tilt_rad.
            duty_ns: three signed pulses.

        Returns:
            True where the pulses were let through to the motors.
        """
        conditions = C.IMU_GOOD if imu_status & IMU_OK else C.IMU_BAD
        if imu_status & IMU_FROZEN:
            conditions |= C.IMU_IS_FROZEN
        if limits & frame.LIMIT_TIPPED:
            conditions |= C.TIPPED
        if limits & frame.LIMIT_DUTY_REFUSED:
            conditions |= C.NOT_FINITE
        if limits & frame.LIMIT_ESTIMATOR_RESET:
            conditions |= C.ESTIMATOR_SICK
        if upright:
            conditions |= C.UPRIGHT
        if self._button:
            conditions |= C.BUTTON
            self._button = False
        if self.calibrated:
            conditions |= C.CALIBRATED
        if not self.refusals & prearm.BLOCKING:
            conditions |= C.READY
        if self._motor_error:
            conditions |= C.MOTOR_ERROR
        if self._guard:
            conditions |= C.GUARD_LOST if self._guard == LOST else C.GUARD_DROPPED

        self.request &= ~frame.REQUEST_HEADING_RESET
        counts = self._counts
        row = 0
        for required, blocking, ticks, to, fault in self._table[self.state]:
            if conditions & required == required and not conditions & blocking:
                counts[row] += 1
                if counts[row] >= ticks:
                    self._enter(to, fault, tick)
                    break
            else:
                counts[row] = 0
            row += 1

        if self.state is not State.BALANCING:
            return False
        if not self.request & frame.REQUEST_ENGAGED:  # the step has not run engaged yet: enable, start at zero
            self.request |= frame.REQUEST_ENGAGED
            self._motor_error = not self._motors.enable()
            return False
        self._motor_error = not self._motors.write(duty_ns)
        if self.drive_scale < 1.0:
            self.drive_scale = min(1.0, self.drive_scale + self._scale_step)
        return not self._motor_error

    def _enter(self, to: State, fault: Fault, tick: int) -> None:
        if self.state is State.BALANCING:
            self._motors.off()
        self.state = to
        self.request = 0
        self.drive_scale = 0.0
        self._motor_error = False
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
