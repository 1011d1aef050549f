"""The kinds of values a configuration may hold: each checks, converts to SI, and documents itself.

A field is data: kind, unit, bounds, default and one sentence of documentation. `convert` returns the value or raises
`Refusal` with what was expected; file, line and key are added by the loader, which knows them.
"""

import math
import re
from dataclasses import dataclass

# Factors to SI of the units that a value may be written in, by the SI unit of the field.
UNITS = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "kg": {"kg": 1.0, "g": 1e-3},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0, "mrad": 1e-3},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "mrad/s": 1e-3},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "ms": {"ms": 1.0},
    "Hz": {"Hz": 1.0, "kHz": 1e3, "rad/s": 0.5 / math.pi},
    "V": {"V": 1.0, "mV": 1e-3},
    "H": {"H": 1.0, "mH": 1e-3, "uH": 1e-6},
    "ohm": {"ohm": 1.0},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2},
}
_WITH_UNIT = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z/]*)")


class Refusal(Exception):
    """A value is not what its field wants; the message says what was expected."""


def _number(value, unit: str) -> float:
    """A finite float from YAML's number or text ("1e-5", "50 deg"); booleans are not numbers."""
    if isinstance(value, bool) or value is None or not isinstance(value, (int, float, str)):
        raise Refusal(f"expected a number{f' in {unit}' if unit else ''}, found {value!r}")
    if isinstance(value, str):
        match = _WITH_UNIT.fullmatch(value.strip())
        if match is None:
            raise Refusal(f"expected a number{f' in {unit}' if unit else ''}, found {value!r}")
        number, written = match.groups()
        factors = UNITS.get(unit, {unit: 1.0} if unit else {})
        if written and written not in factors:
            raise Refusal(f"expected a number in {' or '.join(factors) or 'no unit'}, found the unit {written!r}")
        value = float(number) * factors.get(written, 1.0)
    try:
        value = float(value)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise Refusal("expected a finite number")
    return value


@dataclass(frozen=True)
class Field:
    """What all kinds share: default, documentation."""

    default: object
    doc: str

    def describe(self) -> str:
        """Kind, unit and range in a few words, for messages and documentation."""
        raise NotImplementedError

    def convert(self, value):
        """The value in SI, or Refusal."""
        raise NotImplementedError


@dataclass(frozen=True)
class Number(Field):
    """A float with unit and inclusive bounds."""

    unit: str = ""
    low: float = -math.inf
    high: float = math.inf

    def describe(self):
        bounds = []
        if self.low > -math.inf:
            bounds.append(f"at least {self.low:g}")
        if self.high < math.inf:
            bounds.append(f"at most {self.high:g}")
        return " ".join(["number", *([f"in {self.unit}"] if self.unit else []), *([", ".join(bounds)] if bounds else [])])

    def convert(self, value):
        number = _number(value, self.unit)
        if not self.low <= number <= self.high:
            raise Refusal(f"expected a {self.describe()}, found {number:g}")
        return number


@dataclass(frozen=True)
class Integer(Field):
    """A whole number with inclusive bounds."""

    low: int = -(2**63)
    high: int = 2**63 - 1

    def describe(self):
        return f"whole number from {self.low} to {self.high}"

    def convert(self, value):
        if isinstance(value, str) and re.fullmatch(r"[-+]?\d{1,18}|0x[0-9a-fA-F]{1,15}", value):
            value = int(value, 0)
        if isinstance(value, bool) or not isinstance(value, int) or not self.low <= value <= self.high:
            raise Refusal(f"expected a {self.describe()}, found {value!r}")
        return value


@dataclass(frozen=True)
class Text(Field):
    """Text; may be limited by a regular expression."""

    pattern: str = ".*"
    wanted: str = "text"

    def describe(self):
        return self.wanted

    def convert(self, value):
        if not isinstance(value, str) or "\0" in value or re.fullmatch(self.pattern, value) is None:
            raise Refusal(f"expected {self.describe()}, found {value!r}")
        return value


@dataclass(frozen=True)
class Choice(Field):
    """One of a few words."""

    choices: tuple = ()

    def describe(self):
        return "one of " + ", ".join(self.choices)

    def convert(self, value):
        if value not in self.choices or not isinstance(value, str):
            from mip_rt.config.suggestion import nearest

            raise Refusal(f"expected {self.describe()}, found {value!r}{nearest(value, self.choices)}")
        return value


@dataclass(frozen=True)
class Flag(Field):
    """true or false."""

    def describe(self):
        return "true or false"

    def convert(self, value):
        if value in ("true", "false") and isinstance(value, str):  # overrides come as text
            return value == "true"
        if not isinstance(value, bool):
            raise Refusal(f"expected true or false, found {value!r}")
        return value


@dataclass(frozen=True)
class Several(Field):
    """A list of one kind; `length` fixes how many, otherwise up to `most`."""

    item: Field = None
    length: int | None = None
    most: int = 64

    def describe(self):
        return f"list of {self.length if self.length is not None else f'up to {self.most}'}: {self.item.describe()}"

    def convert(self, value):
        if not isinstance(value, list):
            raise Refusal(f"expected a {self.describe()}, found {value!r}")
        if (self.length is not None and len(value) != self.length) or len(value) > self.most:
            raise Refusal(f"expected a {self.describe()}, found {len(value)} items")
        return tuple(self.item.convert(entry) for entry in value)


@dataclass(frozen=True)
class Named(Field):
    """A table of entries that the user names, each with the same fields; `default` holds the shipped ones."""

    entry: dict = None

    def describe(self):
        return "table of named entries"


@dataclass(frozen=True)
class Rows(Field):
    """A list of entries with the same fields."""

    entry: dict = None

    def describe(self):
        return "list of entries"


def numbers(default, doc, length, unit="", low=-math.inf, high=math.inf):
    """A list of `length` numbers."""
    return Several(default, doc, item=Number(0.0, "", unit=unit, low=low, high=high), length=length)


def matrix(default, doc):
    """A 3x3 matrix, row by row."""
    row = Several((), "", item=Number(0.0, "", low=-1.0 - 1e-3, high=1.0 + 1e-3), length=3)
    return Several(default, doc, item=row, length=3)
