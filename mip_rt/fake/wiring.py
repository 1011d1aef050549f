"""The wires between the board's pins and the simulated robot: what the motor drivers make of PWM and lines, what the encoders show."""

from mip_rt.compiled import direct
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
        self._motors = [board.motors[channel] for channel in config.motors.channels]
        self._encoder_index = [channel - 1 for channel in config.encoders.channels]
        self._battery_channel = config.battery.adc_channel
        self._connected = False
        self._pins = pins.records()
        self._read_duties, self._show_counts = direct(pins.read_duties), direct(pins.show_counts)
        p = self._pins[0]
        wheels = p["wheels"] = len(self._motors)
        p["sign"][:wheels] = config.motors.signs
        p["period_ns"] = 1e9 / config.motor.pwm_frequency_hz
        p["signed"] = sysfs.counts_are_signed
        files = [self.count_file(wheel) for wheel in range(wheels)]
        p["count_at"][:wheels], p["count_fd"][:wheels] = [file.address for file in files], [file.fd for file in files]

    def read(self, duty) -> bool:
        """Fills duty (wheels,) with the signed duties by wheel that the drivers see; returns whether they are enabled."""
        if not (self._connected or self._connect()) or not self._enable_bank.level(self.enable_line[1]):
            duty[:] = 0.0
            return False
        if self._read_duties(self._pins, duty):
            raise ValueError("a duty file holds no number")
        return True

    def _connect(self) -> bool:
        p = self._pins[0]
        for i, pin in enumerate(self._motors):
            file = self._sysfs.duty_file(*pin.pwm)
            banks = [self._gpio.bank(GPIO[bank]) for bank, _ in (pin.a, pin.b)]
            if file is None or not all(bank.held(line) for bank, (_, line) in zip(banks, (pin.a, pin.b))):
                return False
            p["duty_at"][i] = file.address
            p["a_at"][i], p["b_at"][i] = banks[0].address + pin.a[1], banks[1].address + pin.b[1]
        self._connected = True
        return True

    def disconnect(self) -> None:
        """Looks the lines up anew at the next sample, after a driver was closed and opened."""
        self._connected = False

    def show_encoders(self, counts) -> None:
        """Puts the wheels' counts into the counters."""
        self._show_counts(self._pins, counts)

    def count_file(self, wheel: int):
        """The mapped file of a wheel's counter."""
        return self._sysfs.counts[self._encoder_index[wheel]]

    def duty_file(self, wheel: int):
        """The mapped file of a wheel's duty; None before the driver exports it."""
        return self._sysfs.duty_file(*self._motors[wheel].pwm)

    @property
    def battery_file(self):
        """The mapped file of the battery's reading."""
        return self._sysfs.adc[self._battery_channel]

    def forget_shown(self) -> None:
        """Shows all counts anew at the next sample, after their files were changed."""
        self._pins["shown"], self._pins["length"] = pins.NEVER, -1

    def show_battery(self, raw: int) -> None:
        """Puts the battery's reading into the ADC."""
        self._sysfs.set_adc(self._battery_channel, raw)
