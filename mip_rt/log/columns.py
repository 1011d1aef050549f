"""The scalar columns of a log: every element of every field, by a name that a user can type, with its unit.

Names: `battery_v`, `gyro_rad_s[0]`, `estimates[0].roll_rad` (or `estimates[dmp_ekf].roll_rad`). A field without an index means all its elements.
Fields, units and meanings come from the log's header, so a log of any robot and any age can be shown.
"""

import re
from typing import NamedTuple

import numpy as np

from mip_rt.config.suggestion import nearest
from mip_rt.errors import LogError

UNIT_BY_SUFFIX = {
    "_rad_s2": "rad/s^2",
    "_rad_s": "rad/s",
    "_rad": "rad",
    "_m_s2": "m/s^2",
    "_m_s": "m/s",
    "_m": "m",
    "_ns": "ns",
    "_s": "s",
    "_v": "V",
}
_NAME = re.compile(r"(\w+)((?:\[\w+\])*)(?:\.(\w+))?$")


class Column(NamedTuple):
    """One scalar of a tick (or, for packets, one string of bytes).

    Attributes:
        name: as a user types it.
        field: the frame's field.
        index: element of it, () for a scalar field and for bytes.
        unit: of this element where the header or the element's name tells, else of the field.
        meaning: one sentence.
        is_bytes: the values are rows of bytes.
    """

    name: str
    field: str
    index: tuple
    unit: str
    meaning: str
    is_bytes: bool = False

    def of(self, frames) -> np.ndarray:
        """(n,) values; (n, bytes) for bytes."""
        return frames[self.field] if self.is_bytes else frames[self.field][(slice(None), *self.index)]

    @property
    def title(self) -> str:
        """Name and unit."""
        return f"{self.name} ({'hex' if self.is_bytes else self.unit})"


def unit_of(name: str, otherwise: str) -> str:
    """Unit that the suffix of a name stands for."""
    return next((unit for suffix, unit in UNIT_BY_SUFFIX.items() if name.endswith(suffix)), otherwise)


def columns(header: dict) -> list[Column]:
    """All columns of a log in the order of its fields. Estimator slots that were not in use are left out."""
    return [column for entry in header["fields"] for column in _of_field(entry, header)]


def estimators(header: dict) -> list[str]:
    """Names of the estimators in the log's slots; the first was in control."""
    return list(header.get("estimators", []))


def _of_field(entry: dict, header: dict) -> list[Column]:
    name, shape, unit, meaning = entry["name"], tuple(entry["shape"]), entry["unit"], entry["meaning"]
    if entry["dtype"].endswith("u1"):
        return [Column(name, name, (), unit, meaning, True)]
    names = header.get("estimate_names", ()) if name == "estimates" else ()
    used = len(estimators(header)) if name in ("estimates", "estimator_flags") else 0
    if used:
        shape = (min(used, shape[0]), *shape[1:])
    found = []
    for index in np.ndindex(shape):
        if len(names) and len(index) == 2 and index[1] < len(names):
            element = names[index[1]]
            found.append(Column(f"{name}[{index[0]}].{element}", name, index, unit_of(element, unit), meaning))
        else:
            found.append(Column(name + "".join(f"[{i}]" for i in index), name, index, unit, meaning))
    return found


def pick(header: dict, text: str) -> list[Column]:
    """The columns that one name stands for.

    Raises:
        LogError: the log has none of that name; names the nearest one.
    """
    every = columns(header)
    match = _NAME.match(text.strip())
    name, brackets, element = match.groups() if match else (text.strip(), "", None)
    slots = {estimator: str(i) for i, estimator in reversed(list(enumerate(estimators(header))))}
    wanted = [slots.get(index, index) for index in re.findall(r"\[(\w+)\]", brackets)]
    found = [
        column for column in every
        if column.field == name
        and wanted == [str(i) for i in column.index][: len(wanted)]
        and (element is None or column.name.endswith(f".{element}"))
    ]  # fmt: skip
    if not found:
        known = [column.name for column in every] + [entry["name"] for entry in header["fields"]]
        raise LogError(f"the log has no field {text!r}{nearest(text, known)}.", "mip-rt log info --fields lists them.", "log_field")
    return found


def picked(header: dict, text: str | None) -> list[Column]:
    """The columns of a comma-separated list in one row; all columns where there is no list."""
    return columns(header) if text is None else [column for group in pick_groups(header, text) for column in group]


def pick_groups(header: dict, text: str) -> list[list[Column]]:
    """Columns of a comma-separated list, in groups: names joined by + share one."""
    return [[c for name in group.split("+") for c in pick(header, name)] for group in text.split(",") if group.strip()]
