"""Reads a board's table (config/boards/NAME.yaml) into a boards.Board, strictly: an unknown key, a pin that is none or serves twice is refused."""

import functools
import re

from mip_rt.errors import ConfigError
from mip_rt.hardware.boards import DRIVERS, EHRPWM, EQEP, UART, Board, Divider, Led, MotorPins


def _line(text) -> tuple[int, int]:
    found = re.fullmatch(r"gpio([0-3])_([0-9]|[12][0-9]|3[01])", str(text))
    if not found:
        raise ValueError(f"{text!r} is no line such as gpio3_21")
    return int(found[1]), int(found[2])


def _pwm(text) -> tuple[str, int]:
    found = re.fullmatch(r"ehrpwm([0-2])([AB])", str(text))
    if not found:
        raise ValueError(f"{text!r} is no PWM such as ehrpwm1A")
    return EHRPWM[int(found[1])], "AB".index(found[2])


def _unit(kind: str, addresses):
    def read(text):
        found = re.fullmatch(rf"{kind}([0-9])", str(text))
        if not found or int(found[1]) >= len(addresses):
            raise ValueError(f"{text!r} is none of {kind}0 to {kind}{len(addresses) - 1}")
        return addresses[int(found[1])]

    return read


def _polarity(value) -> int:
    if value not in (1, -1):
        raise ValueError(f"polarity is 1 or -1, found {value!r}")
    return value


def _fields(make, readers: dict, needed: int, where: str):
    """Reader of a mapping with these keys, of which the first `needed` must be there."""

    def read(value):
        if not isinstance(value, dict):
            raise ValueError(f"expected {where}, found {value!r}")
        for key in value:
            if key not in readers:
                raise ValueError(f"{key!r} is no key of {where}; there are {', '.join(readers)}")
        for key in list(readers)[:needed]:
            if key not in value:
                raise ValueError(f"{key!r} is missing in {where}")
        return make(**{key: _named(key, readers[key], text) for key, text in value.items()})

    return read


def _named(key, reader, value):
    try:
        return reader(value)
    except (ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"{key}: {error}") from None


def _table(reader):
    return lambda value: {key: _named(key, reader, entry) for key, entry in value.items()}


_MOTOR = _fields(MotorPins, {"pwm": _pwm, "a": _line, "b": _line, "pwm_back": _pwm, "polarity": _polarity}, 1, "a motor")
_BOARD = {
    "model": str,
    "overlay": str,
    "driver": str,
    "motors": _table(_MOTOR),
    "enable": _line,
    "encoders": lambda value: tuple(map(_unit("eqep", EQEP), value)),
    "imu_interrupt": _line,
    "arm_button": _line,
    "mode_button": _line,
    "leds": _table(_fields(Led, {"name": str, "line": _line}, 2, "an LED")),
    "uart": _unit("uart", UART),
    "adc": _table(_fields(Divider, {"channel": int, "ratio": float, "offset_v": float}, 3, "a divider")),
}
_WANTED = {"lines": {"a", "b"}, "two-pwm": {"pwm_back"}, "mirrored": {"b"}}


def parse(text: str, name: str) -> Board:
    """A board's table.

    Raises:
        ConfigError: with the key and what is wrong with it.
    """
    import yaml

    try:
        made = _fields(functools.partial(Board, name=name), _BOARD, len(_BOARD), "a board")(yaml.safe_load(text))
        if made.driver not in DRIVERS:
            raise ValueError(f"driver: {made.driver!r} is none of {', '.join(DRIVERS)}")
        for number, pins in made.motors.items():
            has = {key for key in ("a", "b", "pwm_back") if getattr(pins, key) is not None}
            wanted = _WANTED[made.bridge.scheme]
            if has != wanted:
                raise ValueError(f"motors: {number}: {made.driver} has {', '.join(sorted(wanted))} beside pwm, not {', '.join(sorted(has))}")
        _each_once(made)
    except (ValueError, yaml.YAMLError) as error:
        raise ConfigError(f"the table of the board {name} is not valid: {error}.", "Compare with the shipped ones.", "board_table") from None
    return made


def _each_once(made: Board) -> None:
    used = {}
    places = [(f"motors: {n}", place) for n, pins in made.motors.items() for place in (*pins.channels, pins.a, pins.b) if place]
    places += [(key, getattr(made, key)) for key in ("enable", "imu_interrupt", "arm_button", "mode_button")]
    places += [(f"leds: {colour}", led.line) for colour, led in made.leds.items()]
    for key, place in places:
        if place in used:
            raise ValueError(f"{key}: the pin serves {used[place]} already")
        used[place] = key
