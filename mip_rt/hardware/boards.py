"""Pin tables: which chip, line and channel does what on each board, by device address, never by number.

Sources: librobotcontrol's motor, encoder, button and ADC tables; BeagleBoard device trees (line addresses).
"""

from dataclasses import dataclass

from mip_rt.errors import HardwareError

GPIO = ("44e07000", "4804c000", "481ac000", "481ae000")  # banks 0 to 3
EHRPWM = ("48300200", "48302200", "48304200")
EQEP = ("48300180", "48302180", "48304180")


@dataclass(frozen=True)
class MotorPins:
    """PWM (chip address, channel) and the two direction lines (bank, offset)."""

    pwm: tuple[str, int]
    a: tuple[int, int]
    b: tuple[int, int]


@dataclass(frozen=True)
class Board:
    """One board.

    Attributes:
        motors: by output number from 1.
        driver: "tb6612" (IN1, IN2, PWM) or "mc33926" (one PWM on D2, IN1, IN2).
        enable: standby or enable line, high = run.
        encoders: eQEP addresses by channel from 1.
        imu_interrupt, arm_button: (bank, offset).
        uart: the remote's serial device.
    """

    name: str
    driver: str
    motors: dict
    enable: tuple[int, int] = (0, 20)
    encoders: tuple = EQEP
    imu_interrupt: tuple[int, int] = (3, 21)
    arm_button: tuple[int, int] = (2, 5)
    uart: str = "dev/ttyS5"


def _motors(first_a, second_b):
    return {
        1: MotorPins((EHRPWM[1], 0), first_a, (0, 31)),
        2: MotorPins((EHRPWM[1], 1), (1, 16), second_b),
        3: MotorPins((EHRPWM[2], 0), (2, 9), (2, 8)),
        4: MotorPins((EHRPWM[2], 1), (2, 6), (2, 7)),
    }


BOARDS = {
    "beaglebone-black-cape": Board("beaglebone-black-cape", "tb6612", _motors((1, 28), (2, 17))),
    "beaglebone-blue": Board("beaglebone-blue", "tb6612", _motors((2, 0), (0, 10))),
    "beaglebone-black-mc33926": Board("beaglebone-black-mc33926", "mc33926", _motors((1, 28), (2, 17))),
}


def board(name: str, kernel) -> Board:
    """The pin table of a name, or of the device tree's model for "auto"."""
    if name != "auto":
        return BOARDS[name]
    try:
        model = kernel.path("proc/device-tree/model").read_text(errors="replace")
    except OSError:
        model = ""
    if "Blue" in model:
        return BOARDS["beaglebone-blue"]
    if "Black" in model:
        return BOARDS["beaglebone-black-cape"]
    raise HardwareError(
        f"this is no BeagleBone Black or Blue (model: {model.strip(chr(0)) or 'unknown'}).",
        "Run mip-rt --dry-run on a PC, or name the board in the configuration.",
        "board_unknown",
    )
