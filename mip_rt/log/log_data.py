"""A log as read: what every reader returns."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

NUMBERS = re.compile(r"[<|][iuf][1248]")
NO_ROWS = np.dtype([("sequence", "<i8"), ("tick", "<i8")])  # of a log whose header is lost


@dataclass
class Log:
    """A log as read: see `mip_rt.log.open`.

    Attributes:
        path: what was opened.
        header: what the log says of itself; {} where that is lost.
        frames: (n,) records in order of tick, every one complete.
        damage: sentences about what could not be read; empty for a whole log.
        states: by tick, the bytes of the controller's and the estimators' state after that tick, one a second.
        recorder: the recorder's counters and clocks as it wrote them, in order; empty for a ring.
        end: why the recording ended, and its last counters; {} where it did not end in an orderly way, and for a ring.
    """

    path: Path
    header: dict
    frames: np.ndarray
    damage: list[str] = field(default_factory=list)
    states: dict[int, bytes] = field(default_factory=dict)
    recorder: list[dict] = field(default_factory=list)
    end: dict = field(default_factory=dict)

    @property
    def config(self) -> str:
        """The full configuration, YAML."""
        return self.header.get("config", "")


def record_type(description: dict) -> np.dtype:
    """The type of a row from the field table of a log's header.

    Raises:
        ValueError, KeyError, TypeError: the table is not one, or disagrees with the row size.
    """
    for f in description["fields"]:  # numpy would take much else for a type, objects and records among them
        if not NUMBERS.fullmatch(f["dtype"]) or not all(isinstance(length, int) and 0 < length < 4096 for length in f["shape"]):
            raise ValueError(f"{f['name']!r} is not of numbers")
    fields = [(f["name"], f["dtype"], tuple(f["shape"])) if f["shape"] else (f["name"], f["dtype"]) for f in description["fields"]]
    dtype = np.dtype(fields, align=True)
    if any(dtype.fields.get(name, (None,))[0] != np.dtype("<i8") for name in NO_ROWS.names):
        raise ValueError("the field table has no sequence and tick")
    if dtype.itemsize != description["row_bytes"]:
        raise ValueError("field table and row size disagree")
    return dtype


def without_header(path: Path, sentence: str) -> Log:
    """The log of a file that is one, but does not say what its rows are."""
    return Log(path, {}, np.zeros(0, NO_ROWS), [sentence])
