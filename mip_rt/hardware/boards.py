"""Boards: which chip, line and channel does what, by device address, never by number. The tables are in config/boards/.

Addresses: AM335x technical reference manual, memory map; the same on every kernel, while the numbers of gpiochipN, pwmchipN and
counterN change from kernel to kernel.
"""

import functools
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mip_rt.errors import ConfigError, HardwareError

GPIO = ("44e07000", "4804c000", "481ac000", "481ae000")  # banks 0 to 3
EHRPWM = ("48300200", "48302200", "48304200")
EQEP = ("48300180", "48302180", "48304180")
UART = ("44e09000", "48022000", "48024000", "481a6000", "481a8000", "481aa000")
NAMES = (
    "beaglebone-blue", "beaglebone-black-cape", "beaglebone-black-mc33926", "beaglebone-black-mc33926-s2", "beaglebone-black-mc33926-s3",
)  # fmt: skip


@dataclass(frozen=True)
class Driver:
    """How a motor driver is wired.

    Attributes:
        scheme: "lines" (pulse on one PWM, direction on lines a and b), "two-pwm" (one PWM a direction), "mirrored" (PWM against line b:
            where b is high, the motor turns while the PWM is low).
        off_time: what the motor does between pulses: "brake" or "coast"; what motor.drive of the configuration has to say.
        pwm_limit_hz: highest PWM frequency.
    """

    scheme: str
    off_time: str
    pwm_limit_hz: float


DRIVERS = {
    "tb6612": Driver("lines", "brake", 100e3),
    "mc33926-s1": Driver("lines", "coast", 20e3),
    "mc33926-s2": Driver("two-pwm", "brake", 20e3),
    "mc33926-s3": Driver("mirrored", "brake", 20e3),
}


@dataclass(frozen=True)
class MotorPins:
    """PWM (chip address, channel), direction lines (bank, offset); `pwm_back` is the PWM of the other direction.

    Attributes:
        polarity: 1 where a positive pulse makes line a high; -1 where it makes line b high.
    """

    pwm: tuple[str, int]
    a: tuple[int, int] | None = None
    b: tuple[int, int] | None = None
    pwm_back: tuple[str, int] | None = None
    polarity: int = 1

    @property
    def channels(self) -> tuple:
        """All PWM channels."""
        return (self.pwm,) if self.pwm_back is None else (self.pwm, self.pwm_back)


@dataclass(frozen=True)
class Led:
    """Name in /sys/class/leds, and the line (bank, offset) for where the kernel has no such LED."""

    name: str
    line: tuple[int, int]


@dataclass(frozen=True)
class Divider:
    """ADC channel; volts are those at the pin * ratio + offset_v."""

    channel: int
    ratio: float
    offset_v: float


@dataclass(frozen=True)
class Board:
    """One board.

    Attributes:
        model: what /proc/device-tree/model contains.
        overlay: the project's overlay for it; its name stands in /proc/device-tree/chosen/overlays.
        driver: name in DRIVERS.
        motors: MotorPins by output number from 1.
        enable: standby or enable line (bank, offset), high = run.
        encoders: eQEP addresses by channel from 1.
        imu_interrupt, arm_button, mode_button: (bank, offset); a pressed button is low.
        leds: Led by colour.
        uart: address of the remote's serial port.
        adc: Divider by what it measures.
    """

    name: str
    model: str
    overlay: str
    driver: str
    motors: dict
    enable: tuple[int, int]
    encoders: tuple
    imu_interrupt: tuple[int, int]
    arm_button: tuple[int, int]
    mode_button: tuple[int, int]
    leds: dict
    uart: str
    adc: dict = field(default_factory=dict)

    @property
    def bridge(self) -> Driver:
        """The driver's wiring and limits."""
        return DRIVERS[self.driver]


# -- the shipped tables ----------------------------------------------------------------------------------------------
class _Boards(Mapping):
    """The shipped boards by name; a table is read when it is first asked for."""

    def __getitem__(self, name: str) -> Board:
        if name not in NAMES:
            raise KeyError(name)
        return _load(name)

    def __iter__(self):
        return iter(NAMES)

    def __len__(self):
        return len(NAMES)


@functools.cache
def _load(name: str) -> Board:
    from mip_rt.hardware.board_table import parse

    for folder in (Path(__file__).resolve().parents[2] / "config", Path(sys.prefix) / "share/mip-rt/config"):
        path = folder / "boards" / f"{name}.yaml"
        if path.exists():
            return parse(path.read_text(), name)
    raise ConfigError(f"there is no {name}.yaml in boards/ beside the shipped configurations.", "Install mip-rt again.", "board_table")


BOARDS = _Boards()


# -- which board this is ---------------------------------------------------------------------------------------------
def loaded_overlays(kernel) -> tuple[str, ...]:
    """Names of the overlays that U-Boot has applied; each leaves a property in /chosen/overlays."""
    folder = kernel.path("proc/device-tree/chosen/overlays")
    return tuple(sorted(entry.name for entry in folder.iterdir() if entry.name != "name")) if folder.is_dir() else ()


def model(kernel) -> str:
    """The device tree's name of the machine; empty where there is none."""
    try:
        return kernel.path("proc/device-tree/model").read_text(errors="replace").strip("\0\n ")
    except OSError:
        return ""


def board(name: str, kernel) -> Board:
    """The pin table of a name; for "auto" of the machine: the one whose overlay is loaded, otherwise the first of its model.

    Raises:
        HardwareError: this is no BeagleBone Black or Blue.
        ConfigError: the table is damaged.
    """
    if name != "auto":
        return BOARDS[name]
    found = model(kernel)
    for first in NAMES:
        if BOARDS[first].model in found:
            overlays = loaded_overlays(kernel)
            return next((b for b in BOARDS.values() if b.model in found and b.overlay in overlays), BOARDS[first])
    raise HardwareError(
        f"this is no BeagleBone Black or Blue (model: {found or 'unknown'}).",
        "Run mip-rt --dry-run on a PC, or name the board in the configuration.",
        "board_unknown",
    )


def serial_device(wanted: str, pins: Board, kernel) -> str:
    """Path of the remote's serial port: as wanted, or for "auto" the port at the board's address, whatever its number.

    Raises:
        HardwareError: there is no port at that address.
    """
    from mip_rt.hardware.sysfs import find_by_address

    if wanted != "auto":
        return wanted
    entry = find_by_address(kernel.path("sys/class/tty"), "tty*", pins.uart)
    if entry is None:
        raise HardwareError(f"no serial port at {pins.uart}.", "Load the project's overlay: mip-rt firmware apply.", "uart_missing")
    return str(kernel.path("dev", entry.name))
