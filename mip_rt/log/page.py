"""What stands on the page of `mip-rt log plot`: panels of lines over time, bands of states and limits, faults, and a verdict in words.

Nothing here draws; `picture` makes a PNG of a page, `interactive` an HTML file.
"""

from typing import NamedTuple

import numpy as np

# Okabe and Ito's palette: told apart by colour-blind readers, too.
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILLION, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
)  # fmt: skip
GREY, PALE = "#8C8C8C", "#C4C4C4"
SERIES = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION, GREY, BLACK)


class Line(NamedTuple):
    """One curve: (n,) values over the page's times."""

    label: str
    values: np.ndarray
    colour: str
    style: str = "solid"  # or dash, dot
    width: float = 1.2


class Panel(NamedTuple):
    """One pair of axes. `bounds` are horizontal marks."""

    title: str
    unit: str
    lines: list
    bounds: tuple = ()


class Band(NamedTuple):
    """Spans of time in a row of their own: (begin, end, text, colour)."""

    label: str
    spans: list


class Page(NamedTuple):
    """A whole plot.

    Attributes:
        heading: which log.
        verdict: sentences: the faults in the window, or that there was none.
        times_s: (n,) seconds since the loop's first tick.
        columns: lists of Panels; a column is drawn from top to bottom.
        bands: states first, then one a limit.
        faults: (time, code) in the window.
    """

    heading: str
    verdict: list
    times_s: np.ndarray
    columns: list
    bands: list
    faults: list
