"""The two lamps: red while the robot is not armed, green while it is.

Where the kernel's LED driver has them (BeagleBone Blue) they are files of /sys/class/leds, otherwise lines, which go dark when the process dies.
A robot balances without lamps: nothing here raises once they are opened, and opening them only notes what is in the way.

Source: Documentation/leds/leds-class.rst.
"""

import os

from mip_rt.errors import GpioError
from mip_rt.hardware.boards import GPIO
from mip_rt.hardware.gpio import OutputLines


class _File:
    def __init__(self, path):
        self._fd = os.open(path, os.O_WRONLY | os.O_CLOEXEC)

    def put(self, on: bool) -> None:
        os.pwrite(self._fd, b"1\n" if on else b"0\n", 0)

    def close(self) -> None:
        self.put(False)
        os.close(self._fd)


class _Line:
    def __init__(self, kernel, line):
        self._lines = OutputLines(kernel, GPIO[line[0]], (line[1],), 0, "mip-rt led")

    def put(self, on: bool) -> None:
        self._lines.set(int(on), 1)

    def close(self) -> None:
        self._lines.close()


class Leds:
    """Both lamps.

    Args:
        kernel: hardware.kernel.Kernel.
        leds: boards.Led by colour: "red", "green".

    Attributes:
        problems: sentences about lamps that cannot be opened.
        errors: changes that the kernel refused.
    """

    def __init__(self, kernel, leds: dict):
        self._lamps, self.problems, self.errors, self._armed = {}, [], 0, None
        for colour, led in leds.items():
            path = kernel.path("sys/class/leds", led.name, "brightness")
            try:
                self._lamps[colour] = _File(path) if path.exists() else _Line(kernel, led.line)
            except (OSError, GpioError) as error:
                self.problems.append(f"the {colour} LED stays dark: {error}")

    def show(self, armed: bool) -> None:
        """Green for armed, red otherwise; the kernel hears of changes only."""
        if armed is self._armed:
            return
        self._armed = armed
        for colour, lamp in self._lamps.items():
            try:
                lamp.put(armed == (colour == "green"))
            except OSError:
                self.errors += 1

    def close(self) -> None:
        """Both dark."""
        for lamp in self._lamps.values():
            try:
                lamp.close()
            except OSError:
                self.errors += 1
        self._lamps = {}
