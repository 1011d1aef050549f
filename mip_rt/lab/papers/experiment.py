"""What an experiment is, and what comes out of it: numbers beside the published ones, claims that hold or do not, figures, settings.

An experiment's verdict is derived, never written: every claim is a sentence with a comparison behind it.
"""

import io
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Row:
    """One number beside the published one.

    Attributes:
        what: which quantity, with its unit.
        ours: what came out.
        published: the paper's number, or the (lowest, highest) where it prints a range; None where it prints none.
        within: relative difference that still counts as the same, also beyond a range; None for a number that is only shown.
        digits: significant digits to print.
        by: absolute difference that still counts as the same, for what has a scale of its own, such as a share of 1.
        cell: (table, line, column) where the report shows it in a table as the paper does; None for a line of its own.
    """

    what: str
    ours: float
    published: float | tuple | None = None
    within: float | None = None
    digits: int = 3
    by: float | None = None
    cell: tuple | None = None

    @property
    def agrees(self) -> bool | None:
        """In the published range, or within the tolerance; None where nothing was to be compared."""
        if isinstance(self.published, tuple):
            low, high = self.published
            return bool(low * (1.0 - (self.within or 0.0)) <= self.ours <= high * (1.0 + (self.within or 0.0)))
        if self.published is None or (self.within is None and self.by is None):
            return None
        tolerance = self.by if self.within is None else self.within * abs(self.published)
        return bool(abs(self.ours - self.published) <= tolerance)

    @property
    def verdict(self) -> str:
        """In words."""
        if self.agrees is None:
            return ""
        if isinstance(self.published, tuple):
            inside = (
                "in the range"
                if self.published[0] <= self.ours <= self.published[1]
                else f"within {100 * (self.within or 0.0):g} % of the range"
            )
            return inside if self.agrees else f"no: {self.ours / np.mean(self.published):.2f} times its middle"
        if self.within is None:
            return f"within {self.by:g}" if self.agrees else f"no: {self.ours - self.published:+.2g}"
        return f"within {100 * self.within:g} %" if self.agrees else f"no: {self.ours / self.published:.2f} times"


@dataclass(frozen=True)
class Claim:
    """What the paper's figure or table says, as a sentence, and whether our run says so too."""

    text: str
    holds: bool


@dataclass
class Figure:
    """`draw(figure)` fills a matplotlib figure of size_in; `kind` "gif" where draw(path) writes an animation instead."""

    name: str
    caption: str
    draw: Callable
    size_in: tuple = (9.0, 6.0)
    kind: str = "png"

    def render(self) -> bytes:
        """The picture's bytes.

        Raises:
            PackageMissing: there is no matplotlib.
        """
        from mip_rt.log.picture import figure

        buffer = io.BytesIO()
        if self.kind == "gif":
            self.draw(buffer)
        else:
            page = figure(*self.size_in)
            self.draw(page)
            page.savefig(buffer, format="png", bbox_inches="tight", metadata={"Software": None})
        return buffer.getvalue()


@dataclass
class Result:
    """Outcome of one experiment. `notes` say why something differs; `settings` every parameter that matters, with its source."""

    rows: list = field(default_factory=list)
    claims: list = field(default_factory=list)
    figures: list = field(default_factory=list)
    settings: dict = field(default_factory=dict)
    notes: list = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """ "reproduced", "partly" or "not reproduced": all, some or none of the claims hold and rows agree."""
        judged = [claim.holds for claim in self.claims] + [row.agrees for row in self.rows if row.agrees is not None]
        return "reproduced" if all(judged) else "partly" if any(judged) else "not reproduced"

    def packed(self) -> dict:
        """Everything as plain data with the figures rendered: what crosses from a worker's process, and what --json prints but for the pictures."""
        return {
            "verdict": self.verdict,
            "rows": [
                {
                    "what": r.what,
                    "ours": float(r.ours),
                    "published": r.published,
                    "digits": r.digits,
                    "verdict": r.verdict,
                    "cell": r.cell,
                }
                for r in self.rows
            ],
            "claims": [{"text": c.text, "holds": bool(c.holds)} for c in self.claims],
            "settings": {k: str(v) for k, v in self.settings.items()},
            "notes": list(self.notes),
            "figures": [{"name": f.name, "caption": f.caption, "kind": f.kind, "picture": f.render()} for f in self.figures],
        }


@dataclass(frozen=True)
class Experiment:
    """A reproducible part of a paper.

    Attributes:
        name: for the command line.
        paper: key of catalogue.PAPERS.
        shows: numbered tables and figures that it reproduces, as catalogue entries ("Table III").
        title: what is shown.
        also: (paper, item) pairs of other papers that print the same.
        run: run(seed, quick, progress) -> Result, progress(done, total) optional to call.
    """

    name: str
    paper: str
    shows: tuple
    title: str
    run: Callable
    also: tuple = ()
