"""The second and last hand on the motors: short pulses of small duty on a robot whose wheels are off the ground, for finding out what turns.

Only the supervisor moves the motors of a robot that runs. `mip-rt doctor --interactive` and `mip-rt calibrate` need to move one when nothing runs;
they do it here, with the same driver, behind the same guard (a hung or killed caller drops the enable line), and within limits that are constants
of this file. Who imports it is a test (tests/faults/test_motor_handle.py).
"""

from mip_rt.errors import MotorError
from mip_rt.hardware.motors import Motors

LARGEST_DUTY = 0.3
LONGEST_S = 0.6
BEAT_S = 0.01


class MotorBench:
    """The motors of a configuration, one at a time.

    Args:
        kernel: hardware.kernel.Kernel.
        pins: hardware.boards.Board.
        outputs: the board's motor outputs, by wheel.
        period_ns: PWM period.
        guard: guard_client.GuardClient that holds the enable line.
        rows: (1,) frames of the robot, as the compiled write wants them (those that `mip-rt warm-up` has compiled it for).
    """

    def __init__(self, kernel, pins, outputs, period_ns: int, guard, rows):
        self._kernel, self._guard, self._rows, self._period_ns = kernel, guard, rows, period_ns
        guard.wait_ready()
        self._motors = Motors(kernel, pins, outputs, period_ns, guard)
        self._motors.start()
        self._motors.attach(rows)

    def differences(self) -> list[list[str]]:
        """By wheel: what the kernel says of its PWM channel and should not."""
        return self._motors.differences()

    def pulse(self, wheel: int, duty: float, seconds: float, watch=None) -> None:
        """Turns one motor for a moment; afterwards, however it ends, the enable line is low and all duties are zero.

        Args:
            wheel: index into the outputs.
            duty: signed, as the motor's driver sees it.
            watch: called every 10 ms meanwhile.

        Raises:
            MotorError: beyond the limits, or the kernel refuses.
        """
        if not (abs(duty) <= LARGEST_DUTY and 0.0 < seconds <= LONGEST_S):
            raise MotorError(f"a pulse of {duty:g} for {seconds:g} s is too much.", f"At most {LARGEST_DUTY:g} for {LONGEST_S:g} s.", "motor_bench")
        kernel, motors = self._kernel, self._motors
        self._rows["duty_ns"][0] = 0
        self._rows["duty_ns"][0, wheel] = round(duty * self._period_ns)
        end_ns = kernel.monotonic_ns() + round(seconds * 1e9)
        try:
            self._guard.beat(kernel.monotonic_ns())
            if not motors.enable():
                raise MotorError(f"the motors cannot be enabled: {motors.last_error}.", "Run mip-rt doctor.", "motor_bench")
            while kernel.monotonic_ns() < end_ns:
                self._guard.beat(kernel.monotonic_ns())
                if not motors.write(0):
                    raise MotorError(f"the kernel refuses the pulse: {motors.last_error}.", "Run mip-rt doctor.", "motor_bench")
                kernel.sleep(BEAT_S)
                if watch is not None:
                    watch()
        finally:
            motors.off()

    def time_zero_writes(self, count: int) -> list[int]:
        """Nanoseconds of `count` rounds of writing duty zero to every channel, with the enable line low: what a tick's writes cost the kernel."""
        spent = []
        for _ in range(count):
            begin = self._kernel.monotonic_ns()
            self._motors.off()
            spent.append(self._kernel.monotonic_ns() - begin)
        return spent

    def close(self) -> None:
        """Off, and everything released but the enable line, which is the guard's."""
        self._motors.close()
