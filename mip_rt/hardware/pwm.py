"""PWM channels through sysfs, in the order that the ehrpwm driver wants.

The two channels of a chip share their period: it can only change while both are off with duty 0, and a channel that is off still blocks
another period until it is unexported. Kernels name an exported
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
        self._number = re.sub(r"\D", "", chip.name)
        self._chip = chip
        self._fd = -1
        self.folder = None

    def quiet(self) -> None:
        """Off, if it still runs from earlier use; for all channels of a robot before the first is exported."""
        self.folder = self._folder(self._channel)
        if self.folder is not None and os.access(self.folder / "enable", os.W_OK):
            self._set("enable", "0", ignore=errno.EINVAL)

    def export(self, period_ns: int) -> None:
        """Makes the channel's folder appear, waits for permission, and leaves it off with duty 0. Periods of earlier use, also of the chip's
        other channel, are forgotten where they differ from period_ns.

        Raises:
            MotorError: refused; or another program's channel of the chip runs with another period.
        """
        self._forget_period(1 - self._channel, period_ns)
        self._forget_period(self._channel, period_ns)
        self.folder = self._folder(self._channel)
        if self.folder is None:
            try:
                sysfs.write(self._chip / "export", f"{self._channel}\n")
            except OSError as error:
                if error.errno != errno.EBUSY:
                    raise self._refused("export", error) from error
            self._kernel.sleep(0.02)
            self.folder = self._folder(self._channel) or self._names(self._channel)[0]
        if not sysfs.wait_writable(self._kernel, self.folder / "duty_cycle"):
            raise MotorError(
                f"{self.folder} cannot be written.", "Install the project's udev rules and join the group gpio.", "pwm_permission"
            )
        self._set("enable", "0", ignore=errno.EINVAL)
        self._set("duty_cycle", "0", ignore=errno.EINVAL)  # refused while the period is 0

    def _names(self, channel: int):
        return self._chip / f"pwm{channel}", self._kernel.path(f"sys/class/pwm/pwm-{self._number}:{channel}")

    def _folder(self, channel: int):
        return next((folder for folder in self._names(channel) if folder.is_dir()), None)

    def _forget_period(self, channel: int, period_ns: int) -> None:
        """Unexports a channel whose stored period would make the driver refuse ours."""
        folder = self._folder(channel)
        if folder is None:
            return
        try:
            found = sysfs.read(folder / "period")
            if found in ("0", str(period_ns)):
                return
            if sysfs.read(folder / "enable") != "0":
                raise MotorError(
                    f"{self._chip.name} channel {channel} runs with a period of {found} ns, and this chip's channels share theirs.",
                    "Stop the program that uses it.", "pwm_shared",
                )  # fmt: skip
            sysfs.write(self._chip / "unexport", f"{channel}\n")
        except OSError as error:
            raise self._refused("unexport", error) from error
        self._kernel.sleep(0.02)

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

    def off(self, rest_ns: int = 0) -> None:
        """Duty 0 (or what else is rest), written whatever was written before; OSError where the kernel refuses."""
        if self._fd >= 0:
            os.pwrite(self._fd, b"%d\n" % rest_ns, 0)

    def close(self) -> None:
        """Channel off, files closed."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
            sysfs.write(self.folder / "enable", "0\n")
