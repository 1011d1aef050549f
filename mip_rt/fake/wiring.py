"""The wires between the board's pins and the simulated robot: what the motor drivers make of PWM and lines, what the encoders show."""

from mip_rt.compiled import direct, span
from mip_rt.fake import pins
from mip_rt.hardware.boards import GPIO


class Wiring:
    """Motors, encoders and battery of one board.

    Args:
        config: configuration (motors, encoders, battery, motor).
        board: hardware.boards.Board.
        sysfs: FakeSysfs.
        gpio: FakeGpio.
    """

    def __init__(self, config, board, sysfs, gpio):
        self._sysfs, self._gpio = sysfs, gpio
        self.enable_line = (GPIO[board.enable[0]], board.enable[1])
        self._enable_bank = gpio.bank(self.enable_line[0])
        self._pins = [board.motors[channel] for channel in config.motors.channels]
        self._signs = config.motors.signs
        self._period_ns = 1e9 / config.motor.pwm_frequency_hz
        self._encoder_index = [channel - 1 for channel in config.encoders.channels]
        self._battery_channel = config.battery.adc_channel
        self._parts = None
        self._counters, self._show_counts = pins.records(), direct(pins.show_counts)
        self._counters_span = span(self._counters)
        p = self._counters[0]
        wheels = p["wheels"] = len(self._encoder_index)
        p["signed"] = sysfs.counts_are_signed
        files = [self.count_file(wheel) for wheel in range(wheels)]
        p["count_at"][:wheels], p["count_fd"][:wheels] = [file.address for file in files], [file.fd for file in files]

    def read(self, duty) -> bool:
        """Fills duty (wheels,) with the signed duties by wheel that the drivers see; returns whether they are enabled."""
        if self._parts is None and not self._connect():
            duty[:] = 0.0
            return False
        if not self._enable_bank.level(self.enable_line[1]):
            duty[:] = 0.0
            return False
        for i, (file, back, a_levels, a, b_levels, b, sign) in enumerate(self._parts):
            if back is not None:
                duty[i] = sign * (file.number() - back.number()) / self._period_ns
            elif a_levels is not None:
                duty[i] = (a_levels[a] - b_levels[b]) * sign * file.number() / self._period_ns
            else:
                duty[i] = sign * (file.number() / self._period_ns - b_levels[b])
        return True

    def _connect(self) -> bool:
        parts = []
        for pin, sign in zip(self._pins, self._signs):
            files = [self._sysfs.duty_file(*channel) for channel in pin.channels]
            lines = [(self._gpio.bank(GPIO[line[0]]), line[1]) if line else (None, 0) for line in (pin.a, pin.b)]
            if None in files or not all(bank is None or bank.held(line) for bank, line in lines):
                return False
            (a_bank, a), (b_bank, b) = lines
            levels = [bank.levels if bank else None for bank in (a_bank, b_bank)]
            parts.append((files[0], files[1] if len(files) > 1 else None, levels[0], a, levels[1], b, sign * pin.polarity))
        self._parts = parts
        return True

    def disconnect(self) -> None:
        """Looks the lines up anew at the next sample, after a driver was closed and opened."""
        self._parts = None

    def show_encoders(self, counts) -> None:
        """Puts the wheels' counts into the counters."""
        self._show_counts(*self._counters_span, *span(counts))

    def count_file(self, wheel: int):
        """The mapped file of a wheel's counter."""
        return self._sysfs.counts[self._encoder_index[wheel]]

    def duty_file(self, wheel: int):
        """The mapped file of a wheel's duty; None before the driver exports it."""
        return self._sysfs.duty_file(*self._pins[wheel].pwm)

    @property
    def battery_file(self):
        """The mapped file of the battery's reading."""
        return self._sysfs.adc[self._battery_channel]

    def forget_shown(self) -> None:
        """Shows all counts anew at the next sample, after their files were changed."""
        self._counters["shown"], self._counters["length"] = pins.NEVER, -1

    def show_battery(self, raw: int) -> None:
        """Puts the battery's reading into the ADC."""
        self._sysfs.set_adc(self._battery_channel, raw)
