"""The motors: PWM, direction lines and the enable line, behind one handle that only the supervisor holds.

Truth tables. TB6612, and MC33926 with PWM on D2 (S1): A = 1, B = 0 one way; A = 0, B = 1 the other way; the pulse is the PWM's high time.
MC33926 with PWM on IN1 and IN2 (S2): the PWM of the way it turns carries the pulse, the other is low. MC33926 with PWM on IN1 and a line on IN2
(S3): line low, the pulse is the high time; line high, the pulse is the low time, so that rest is an IN1 that is always high. Line and PWM cannot change
at once: at a reversal the motor gets full voltage in its new direction for the time between two writes, never in the old one.
In all of them the enable line (standby, EN) low switches the outputs off. The guard's process holds it (mip_rt/guard.py); the motors only
ask for it.

Source: data sheets of TB6612FNG and MC33926; librobotcontrol's motor table.
"""

from functools import partial

from mip_rt.compiled import span
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
    """

    def __init__(self, kernel, board, channels, period_ns: int, enable):
        pins = [_pins(board, channel) for channel in channels]
        limit_hz = board.bridge.pwm_limit_hz
        if period_ns < round(1e9 / limit_hz):
            raise MotorError(
                f"the drivers of {board.name} take at most {limit_hz / 1e3:g} kHz, not {1e6 / period_ns:.4g} kHz.",
                f'Set motor.pwm_frequency_hz to "{limit_hz / 1e3:g} kHz".', "pwm_too_fast",
            )  # fmt: skip
        scheme = board.bridge.scheme
        self._mirroring = scheme == "mirrored"
        self._polarity = [pin.polarity for pin in pins]
        self._pwm = [PwmChannel(kernel, *pin.pwm) for pin in pins]
        self._pwm_back = [PwmChannel(kernel, *pin.pwm_back) for pin in pins if pin.pwm_back]
        self._period_ns = period_ns
        self._pulses = compiled_io.records(compiled_io.PULSES, len(pins))
        self._pulses["period_ns"], self._pulses["written_ns"] = period_ns, -1
        self._pulses["two"] = int(scheme == "two-pwm")
        self._rows = self._write = None
        self.errors, self.last_error, self.enabled = 0, None, False
        self._enable = enable
        # Direction lines may lie in several banks: one request a bank, and for each motor its bits there.
        by_bank = {}
        for pin in pins:
            for bank, offset in filter(None, (pin.a, pin.b)):
                by_bank.setdefault(bank, []).append(offset)
        lines = {bank: OutputLines(kernel, GPIO[bank], offsets, 0, "mip-rt direction") for bank, offsets in by_bank.items()}
        self._direction_lines = list(lines.values())
        self._direction = [
            tuple((lines[line[0]], 1 << by_bank[line[0]].index(line[1])) if line else (None, 0) for line in (pin.a, pin.b)) for pin in pins
        ]

    def start(self) -> None:
        """Sets up the PWM channels, all off; the enable line stays low."""
        channels = [*self._pwm, *self._pwm_back]
        for channel in channels:
            channel.quiet()
        for channel in channels:
            channel.export(self._period_ns)
        for channel in channels:
            channel.start(self._period_ns)
        for i, polarity in enumerate(self._polarity):
            way = [channel.fd for channel in (self._pwm[i], *self._pwm_back[i : i + 1])][::polarity]
            self._pulses["fd"][0, i :: compiled_io.MOST][: len(way)] = way

    def differences(self) -> list[list[str]]:
        """By wheel: what the kernel says of its PWM channel and should not, while all are off."""
        return [channel.differences(self._period_ns) for channel in self._pwm]

    def attach(self, rows) -> None:
        """Takes pulses from these rows of frames and notes there what was applied."""
        self._rows = rows
        self._write = partial(compiled_io.writer_for(rows.dtype), *span(self._pulses), *span(rows))

    def enable(self) -> bool:
        """Wakes the drivers with duty 0; False where the kernel refuses."""
        try:
            self._pulses["written_ns"] = -1
            if self._mirroring:  # only now, with the drivers asleep, may rest become the low PWM with the low line
                for i in range(len(self._pwm)):
                    self._turn(i, self._polarity[i])
            for channel in (*self._pwm, *self._pwm_back):
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
        turn = self._write(index)
        if turn == 0:
            return True
        try:
            while turn > 0:
                for i in range(len(self._pwm)):
                    if turn >> i & 1:
                        self._turn(i, 1 if self._rows["duty_ns"][index, i] > 0 else -1)
                turn = self._write(index)
        except OSError as error:
            return self._failed(error)
        return turn == 0 or self._failed(OSError("a pulse was refused"))

    def _turn(self, i: int, sign: int) -> None:
        (a_lines, a), (b_lines, b) = self._direction[i]
        forward = sign * self._polarity[i] > 0
        if a_lines is b_lines:
            a_lines.set(a if forward else b, a | b)
        else:
            if a_lines is not None:
                a_lines.set(a if forward else 0, a)
            b_lines.set(0 if forward else b, b)
        self._pulses["sign"][0, i] = sign
        self._pulses["mirrored"][0, i] = int(self._mirroring and not forward)

    def _failed(self, error) -> bool:
        self.errors += 1
        self.last_error = error
        return False

    def give_up(self) -> None:
        """The enable line's guard is lost for good."""
        self._enable.give_up()

    def off(self) -> None:
        """Enable low and no pulse; every part is tried, whatever the others do. Never raises."""
        self._enable.set(False)
        self.enabled = False
        self._pulses["written_ns"] = -1
        for i, channel in enumerate((*self._pwm, *self._pwm_back)):
            try:
                channel.off(self._period_ns if i < len(self._pwm) and self._pulses["mirrored"][0, i] else 0)
            except OSError as error:
                self._failed(error)

    def close(self) -> None:
        """Off, then every line and file but the enable line is released. Raises nothing but what a later start would also meet."""
        self.off()
        self._pulses["fd"] = -1
        problems = []
        for part in (*self._pwm, *self._pwm_back, *self._direction_lines):
            try:
                part.close()
            except OSError as error:
                problems.append(error)
        if problems:
            raise MotorError(f"closing the motors failed: {problems[0]}.", "They are off; run mip-rt doctor.", "motor_close")


def _pins(board, channel: int):
    if channel not in board.motors:
        outputs = ", ".join(map(str, board.motors))
        raise MotorError(f"{board.name} has no motor output {channel}; it has {outputs}.", "Correct motors.channels.", "motor_output")
    return board.motors[channel]
