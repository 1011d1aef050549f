"""The wires between the board's pins and the simulated robot: what the motor drivers make of PWM and lines, what the encoders show."""

from mip_rt.compiled import direct, span
from mip_rt.fake import pins
from mip_rt.hardware.boards import GPIO

NOT_CONNECTED = -1


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
        self._encoder_index = [channel - 1 for channel in config.encoders.channels]
        self._battery_channel = config.battery.adc_channel
        self._connected = NOT_CONNECTED  # otherwise the number of exports by which the files' addresses are known
        self._records, self._show_counts, self._read_duties = pins.records(), direct(pins.show_counts), direct(pins.read_duties)
        self._span = span(self._records)
        self._duty_span = self._counts_span = ()
        self._duty = self._counts = None  # the arrays of the last sample: always the same, and a look at where they are costs more than their use
        p = self._records[0]
        p["period_ns"] = 1e9 / config.motor.pwm_frequency_hz
        wheels = p["wheels"] = len(self._encoder_index)
        p["signed"] = sysfs.counts_are_signed
        files = [self.count_file(wheel) for wheel in range(wheels)]
        p["count_at"][:wheels], p["count_fd"][:wheels] = [file.address for file in files], [file.fd for file in files]

    @property
    def level_at(self) -> int:
        """Address of the enable line's level."""
        return self._enable_bank.address + self.enable_line[1]

    @property
    def enable_is_high(self) -> bool:
        """The enable line's level, while its holder is known to live."""
        return self._enable_bank.levels[self.enable_line[1]] == 1

    @property
    def pins_at(self) -> int:
        """Address of what compiled code needs: pins.PINS."""
        return self._span[0]

    def connected(self) -> bool:
        """The driver has made all files and lines; they are known from then on."""
        return self._connected == self._sysfs.exports or self._connect()

    def read(self, duty) -> bool:
        """Fills duty (wheels,) with the signed duties by wheel that the drivers see; returns whether they are enabled."""
        if not self.connected() or not self._enable_bank.level(self.enable_line[1]):
            duty[:] = 0.0
            return False
        if duty is not self._duty:
            self._duty, self._duty_span = duty, span(duty)
        self._read_duties(*self._span, *self._duty_span)
        return True

    def _connect(self) -> bool:
        p = self._records[0]
        for i, pin in enumerate(self._pins):
            files = [self._sysfs.duty_file(*channel) for channel in pin.channels]
            lines = [(self._gpio.bank(GPIO[line[0]]), line[1]) if line else (None, 0) for line in (pin.a, pin.b)]
            if None in files or not all(bank is None or bank.held(line) for bank, line in lines):
                return False
            p["duty_at"][i], p["back_at"][i] = files[0].address, files[1].address if len(files) > 1 else 0
            p["a_at"][i], p["b_at"][i] = (bank.address + line if bank else 0 for bank, line in lines)
            p["sign"][i] = self._signs[i] * pin.polarity
        self._connected = self._sysfs.exports
        return True

    def disconnect(self) -> None:
        """Looks the lines up anew at the next sample, after a driver was closed and opened."""
        self._connected = NOT_CONNECTED

    def show_encoders(self, counts) -> None:
        """Puts the wheels' counts into the counters."""
        if counts is not self._counts:
            self._counts, self._counts_span = counts, span(counts)
        self._show_counts(*self._span, *self._counts_span)

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
        self._records["shown"], self._records["length"] = pins.NEVER, -1

    def show_battery(self, raw: int) -> None:
        """Puts the battery's reading into the ADC."""
        self._sysfs.set_adc(self._battery_channel, raw)
