"""The battery's voltage through the AM335x ADC (IIO).

Zero or nonsense is "no reading" (NaN), never a voltage: it must not become a divisor.
"""

import math
import os

from mip_rt.errors import HardwareError

ADC_NAME = "TI-am335x-adc"
VOLTS_PER_COUNT = 1.8 / 4095.0


class Battery:
    """One ADC channel behind a divider.

    Args:
        kernel: hardware.kernel.Kernel.
        settings: the configuration's battery section (adc_channel, ratio, offset_v, plausible_v).

    Attributes:
        errors: readings that failed or were implausible.
    """

    def __init__(self, kernel, settings):
        folder = kernel.path("sys/bus/iio/devices")
        names = sorted(folder.glob("iio:device*/name")) if folder.is_dir() else []
        found = [name.parent for name in names if name.read_text().startswith(ADC_NAME)]
        if not found:
            raise HardwareError("there is no AM335x ADC.", "Load the ADC overlay (BB-ADC-00A0).", "adc_missing")
        self._fd = os.open(found[0] / f"in_voltage{settings.adc_channel}_raw", os.O_RDONLY | os.O_CLOEXEC)
        self._ratio, self._offset_v = settings.ratio, settings.offset_v
        self._low_v, self._high_v = settings.plausible_v
        self.errors = 0

    def read(self) -> float:
        """Volts, or NaN."""
        try:
            volts = int(os.pread(self._fd, 16, 0)) * VOLTS_PER_COUNT * self._ratio + self._offset_v
        except (OSError, ValueError):
            volts = math.nan
        if not self._low_v <= volts <= self._high_v:
            self.errors += 1
            return math.nan
        return volts

    def close(self) -> None:
        """Closes the file."""
        os.close(self._fd)
