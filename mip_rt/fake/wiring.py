"""The wires between the board's pins and the simulated robot: what the motor drivers make of PWM and lines, what the encoders show."""

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
        self._shown = [None] * len(self._encoder_index)

    def read(self, duty) -> bool:
        """Fills duty (wheels,) with the signed duties by wheel that the drivers see; returns whether they are enabled."""
        if self._parts is None and not self._connect():
            duty[:] = 0.0
            return False
        if not self._enable_bank.level(self.enable_line[1]):
            duty[:] = 0.0
            return False
        for i, (file, a_levels, a, b_levels, b) in enumerate(self._parts):
            duty[i] = (a_levels[a] - b_levels[b]) * self._signs[i] * file.number() / self._period_ns
        return True

    def _connect(self) -> bool:
        parts = []
        for pin in self._pins:
            file = self._sysfs.duty_file(*pin.pwm)
            lines = [(self._gpio.bank(GPIO[bank]), line) for bank, line in (pin.a, pin.b)]
            if file is None or not all(bank.held(line) for bank, line in lines):
                return False
            parts.append((file, lines[0][0].levels, pin.a[1], lines[1][0].levels, pin.b[1]))
        self._parts = parts
        return True

    def disconnect(self) -> None:
        """Looks the lines up anew at the next sample, after a driver was closed and opened."""
        self._parts = None

    def show_encoders(self, counts) -> None:
        """Puts the wheels' counts into the counters."""
        for i, index in enumerate(self._encoder_index):
            count = int(counts[i])
            if count != self._shown[i]:
                self._shown[i] = count
                self._sysfs.set_count(index, count)

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
        self._shown = [None, None, None]

    def show_battery(self, raw: int) -> None:
        """Puts the battery's reading into the ADC."""
        self._sysfs.set_adc(self._battery_channel, raw)
