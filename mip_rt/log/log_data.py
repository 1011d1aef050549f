"""A log as read: what every reader returns."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mip_rt import frame

_NUMBERS = re.compile(r"<[fiu][248]|\|[iu]1")


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
    fields = [(f["name"], f["dtype"], tuple(f["shape"])) if f["shape"] else (f["name"], f["dtype"]) for f in description["fields"]]
    for _, kind, *_ in fields:  # numpy understands much more, and answers to nonsense with errors of any kind
        if not _NUMBERS.fullmatch(kind):
            raise ValueError(f"{kind!r} is no type of a field")
    dtype = np.dtype(fields, align=True)
    if dtype.itemsize != description["row_bytes"]:
        raise ValueError("field table and row size disagree")
    return dtype


def without_header(path: Path, sentence: str) -> Log:
    """The log of a file that is one, but does not say what its rows are: no frames, with the fields that every robot's have."""
    return Log(path, {}, np.zeros(0, frame.Layout(0, (), ()).dtype), [sentence])
