"""PWM channels through sysfs, in the order that the ehrpwm driver wants.

The two channels of a chip share their period: it can only change while both are off with duty 0. Kernels name an exported
channel pwmchipK/pwmN or, 4.14 to 4.19, pwm-K:N; K is never stable, so the chip is found by its address.

Source: drivers/pwm/pwm-tiehrpwm.c, Documentation/driver-api/pwm.rst.
"""

import errno
import os
import re

from mip_rt.errors import MotorError
from mip_rt.hardware import sysfs


class PwmChannel:
    """One channel.

    Args:
        kernel: hardware.kernel.Kernel.
        address: chip address, such as "48302200".
        channel: 0 (A) or 1 (B).
    """

    def __init__(self, kernel, address: str, channel: int):
        self._kernel, self._channel = kernel, channel
        chip = sysfs.find_by_address(kernel.path("sys/class/pwm"), "pwmchip*", address)
        if chip is None:
            raise MotorError(f"no PWM chip at {address}.", "Load the project's overlay; run mip-rt doctor.", "pwm_missing")
        number = re.sub(r"\D", "", chip.name)
        self._names = (chip / f"pwm{channel}", kernel.path(f"sys/class/pwm/pwm-{number}:{channel}"))
        self._chip = chip
        self._fd = -1
        self.folder = None

    def export(self) -> None:
        """Makes the channel's folder appear, waits for permission, and leaves it off with duty 0."""
        self.folder = next((folder for folder in self._names if folder.is_dir()), None)
        if self.folder is None:
            try:
                sysfs.write(self._chip / "export", f"{self._channel}\n")
            except OSError as error:
                if error.errno != errno.EBUSY:
                    raise self._refused("export", error) from error
            self._kernel.sleep(0.02)
            self.folder = next((folder for folder in self._names if folder.is_dir()), self._names[0])
        if not sysfs.wait_writable(self._kernel, self.folder / "duty_cycle"):
            raise MotorError(
                f"{self.folder} cannot be written.", "Install the project's udev rules and join the group gpio.", "pwm_permission"
            )
        self._set("enable", "0", ignore=errno.EINVAL)
        self._set("duty_cycle", "0", ignore=errno.EINVAL)  # refused while the period is 0

    def start(self, period_ns: int) -> None:
        """Period, polarity, duty 0, on; the chip's other channel must be off or have the same period."""
        self._set("period", str(period_ns))
        self._set("polarity", "normal")
        self._set("duty_cycle", "0")
        self._set("enable", "1")
        self._fd = os.open(self.folder / "duty_cycle", os.O_WRONLY | os.O_CLOEXEC)

    def _set(self, attribute: str, value: str, ignore: int = 0) -> None:
        try:
            sysfs.write(self.folder / attribute, value + "\n")
        except OSError as error:
            if error.errno != ignore:
                raise self._refused(attribute, error) from error

    def _refused(self, attribute, error) -> MotorError:
        return MotorError(
            f"{self._chip.name} channel {self._channel} refuses {attribute}: {error.strerror}.",
            "Is another program using this PWM chip with another period?",
            "pwm_refused",
        )

    def differences(self, period_ns: int) -> list[str]:
        """What the kernel says of the channel and should not, after `start`; OSError where it says nothing."""
        wanted = {"period": str(period_ns), "duty_cycle": "0", "enable": "1", "polarity": "normal"}
        found = {name: sysfs.read(self.folder / name) for name in wanted}
        return [f"{name} is {found[name]}, not {value}" for name, value in wanted.items() if found[name] != value]

    @property
    def fd(self) -> int:
        """The open duty_cycle, to which pulses are written in ns; -1 before `start` and after `close`."""
        return self._fd

    def off(self) -> None:
        """Duty 0, written whatever was written before; OSError where the kernel refuses."""
        if self._fd >= 0:
            os.pwrite(self._fd, b"0\n", 0)

    def close(self) -> None:
        """Channel off, files closed."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
            sysfs.write(self.folder / "enable", "0\n")
