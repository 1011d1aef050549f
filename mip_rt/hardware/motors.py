"""The motors: PWM, direction lines and the enable line, behind one handle that only the supervisor holds.

Truth tables: TB6612 and MC33926 with PWM on D2 share one: A = 1, B = 0 forward; A = 0, B = 1 backward; the enable line (standby, EN) low
switches the outputs off. The guard's process holds it (mip_rt/guard.py); the motors only ask for it.
"""

from mip_rt.errors import MotorError
from mip_rt.hardware import compiled_io
from mip_rt.hardware.boards import GPIO
from mip_rt.hardware.gpio import OutputLines
from mip_rt.hardware.pwm import PwmChannel


class Motors:
    """The motors of a robot.

    Args:
        kernel: hardware.kernel.Kernel.
        board: hardware.boards.Board.
        channels: the board's motor outputs by wheel.
        period_ns: PWM period.
        enable: the enable line: guard_client.GuardClient.

    Attributes:
        errors: writes that the kernel refused.
        last_error: the last of them, None before the first.
        enabled: the enable line was asked to be high.
        beat: the enable line's `beat(now_ns)`, which the supervisor calls once a tick.
    """

    def __init__(self, kernel, board, channels, period_ns: int, enable):
        pins = [board.motors[channel] for channel in channels]
        self._pwm = [PwmChannel(kernel, *pin.pwm) for pin in pins]
        self._period_ns = period_ns
        self._pulses = compiled_io.records(compiled_io.PULSES, len(pins))
        self._pulses["period_ns"], self._pulses["written_ns"] = period_ns, -1
        self._rows = None
        self.errors, self.last_error, self.enabled = 0, None, False
        self._enable, self.beat = enable, enable.beat
        # Direction lines may lie in several banks: one request a bank, and for each motor its bits there.
        by_bank = {}
        for pin in pins:
            for bank, offset in (pin.a, pin.b):
                by_bank.setdefault(bank, []).append(offset)
        lines = {bank: OutputLines(kernel, GPIO[bank], offsets, 0, "mip-rt direction") for bank, offsets in by_bank.items()}
        self._direction_lines = list(lines.values())
        self._direction = [
            tuple((lines[bank], 1 << by_bank[bank].index(offset)) for bank, offset in (pin.a, pin.b)) for pin in pins
        ]

    def start(self) -> None:
        """Sets up the PWM channels, all off; the enable line stays low."""
        for channel in self._pwm:
            channel.export()
        for channel in self._pwm:
            channel.start(self._period_ns)
        self._pulses["fd"][0, : len(self._pwm)] = [channel.fd for channel in self._pwm]

    def differences(self) -> list[list[str]]:
        """By wheel: what the kernel says of its PWM channel and should not, while all are off."""
        return [channel.differences(self._period_ns) for channel in self._pwm]

    def attach(self, rows) -> None:
        """Takes pulses from these rows of frames and notes there what was applied."""
        self._rows = rows

    def enable(self) -> bool:
        """Wakes the drivers with duty 0; False where the kernel refuses."""
        try:
            self._pulses["written_ns"] = -1
            for channel in self._pwm:
                channel.off()
            self._enable.set(True)
            self.enabled = True
            return True
        except OSError as error:
            return self._failed(error)

    def write(self, index: int) -> bool:
        """Applies the pulses (duty_ns) of row `index`; only changes reach the kernel. False where it refuses.

        At a reversal the old pulse is taken away before the direction changes.
        """
        turn = compiled_io.write_pulses(self._pulses, self._rows, index)
        if turn == 0:
            return True
        try:
            while turn > 0:
                for i in range(len(self._pwm)):
                    if turn >> i & 1:
                        self._turn(i, 1 if self._rows["duty_ns"][index, i] > 0 else -1)
                turn = compiled_io.write_pulses(self._pulses, self._rows, index)
        except OSError as error:
            return self._failed(error)
        return turn == 0 or self._failed(OSError("a pulse was refused"))

    def _turn(self, i: int, sign: int) -> None:
        (a_lines, a), (b_lines, b) = self._direction[i]
        if a_lines is b_lines:
            a_lines.set(a if sign > 0 else b, a | b)
        else:
            a_lines.set(a if sign > 0 else 0, a)
            b_lines.set(b if sign < 0 else 0, b)
        self._pulses["sign"][0, i] = sign

    def _failed(self, error) -> bool:
        self.errors += 1
        self.last_error = error
        return False

    def off(self) -> None:
        """Enable low and duty 0; every part is tried, whatever the others do. Never raises."""
        self._enable.set(False)
        self.enabled = False
        self._pulses["written_ns"] = -1
        for channel in self._pwm:
            try:
                channel.off()
            except OSError as error:
                self._failed(error)

    def close(self) -> None:
        """Off, then every line and file but the enable line is released. Raises nothing but what a later start would also meet."""
        self.off()
        self._pulses["fd"] = -1
        problems = []
        for part in (*self._pwm, *self._direction_lines):
            try:
                part.close()
            except OSError as error:
                problems.append(error)
        if problems:
            raise MotorError(f"closing the motors failed: {problems[0]}.", "They are off; run mip-rt doctor.", "motor_close")
