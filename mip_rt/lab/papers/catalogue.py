"""Every numbered table and figure of the five papers, and for those that no experiment shows, why."""

from typing import NamedTuple


class Paper(NamedTuple):
    """One of the sources: its title, and the reason by table or figure that no experiment shows."""

    title: str
    left_out: dict


PHOTO = "photograph"
DRAWING = "drawing of the mechanism or the frames, no result"
DIAGRAM = "block diagram, no result"
SYMBOLS = "list of symbols, no result"

PAPERS = {
    "acc2018": Paper(
        "Sihite and Bewley, Attitude estimation of a high-yaw-rate Mobile Inverted Pendulum (ACC 2018)",
        {"Table I": SYMBOLS, "Fig. 1": PHOTO, "Fig. 2": DRAWING, "Fig. 3": DIAGRAM},
    ),
    "dissertation": Paper(
        "Sihite, dissertation on the Micro Ball-Balancing Robot (UCSD 2019)",
        {
            "Table 3.1": SYMBOLS, "Table 4.1": SYMBOLS, "Table 4.2": "list of parts, no result", "Table 5.1": SYMBOLS,
            "Fig. 2.1": PHOTO, "Fig. 2.2": PHOTO, "Fig. 2.3": PHOTO, "Fig. 2.4": PHOTO, "Fig. 2.5": DRAWING, "Fig. 2.6": PHOTO,
            "Fig. 2.7": "finite-element stress analysis of a part: none of our models", "Fig. 2.8": PHOTO, "Fig. 2.11": PHOTO,
            "Fig. 3.1": PHOTO, "Fig. 3.2": DRAWING, "Fig. 3.3": DIAGRAM,
            "Fig. 4.1": "circuit drawing, no result", "Fig. 4.3": "drawing of the test stand, no result", "Fig. 5.1": DRAWING, "Fig. 5.2": PHOTO,
            "Fig. 6.1": DIAGRAM, "Fig. 6.2": DIAGRAM, "Fig. 6.7": PHOTO,
        },
    ),
    "omurchadha": Paper("O'Murchadha, Simulation and Control of a Mobile Inverted Pendulum", {"Fig. 1": DRAWING}),
    "aoyagi-choi": Paper("Aoyagi and Choi, Angular Position Estimation of an Inverted Pendulum Using Low-Cost IMUs (2018)", {"Fig. 1": PHOTO}),
    "lee-jung": Paper(
        "Report on Lee and Jung, Gyro Sensor Drift Compensation by Kalman Filter",
        {"Fig. 1": DRAWING, "Fig. 2": DRAWING, "Fig. 3": DIAGRAM, "Fig. 4": "circuit diagram, no result", "Fig. 5": PHOTO},
    ),
}  # fmt: skip

# What the papers number: first and last of every run of figures, and the tables.
NUMBERED = {
    "acc2018": (["Table I", "Table II", "Table III"], [("Fig. {}", 1, 5)]),
    "dissertation": (
        ["Table 2.1", "Table 3.1", "Table 3.2", "Table 3.3", "Table 4.1", "Table 4.2", "Table 4.3", "Table 4.4", "Table 4.5", "Table 5.1", "Table 5.2",
         "Table 6.1", "Table 6.2", "Table 6.3"],
        [("Fig. 2.{}", 1, 11), ("Fig. 3.{}", 1, 4), ("Fig. 4.{}", 1, 6), ("Fig. 5.{}", 1, 3), ("Fig. 6.{}", 1, 32)],
    ),
    "omurchadha": ([], [("Fig. {}", 1, 8)]),
    "aoyagi-choi": ([], [("Fig. {}", 1, 4)]),
    "lee-jung": ([], [("Fig. {}", 1, 6)]),
}  # fmt: skip


class Entry(NamedTuple):
    """One table or figure: the experiment that shows it, or the reason why none does."""

    paper: str
    item: str
    experiment: str | None
    reason: str


def pairs(experiment) -> list:
    """(paper, item) of everything that an experiment shows."""
    return [*((experiment.paper, item) for item in experiment.shows), *experiment.also]


def entries(experiments) -> list[Entry]:
    """Every numbered table and figure in the order of the papers; "not yet" where neither an experiment nor a reason exists."""
    shown = {pair: e.name for e in experiments.values() for pair in pairs(e)}
    found = []
    for paper, (tables, figures) in NUMBERED.items():
        for item in tables + [pattern.format(n) for pattern, first, last in figures for n in range(first, last + 1)]:
            name = shown.get((paper, item))
            found.append(Entry(paper, item, name, "" if name else PAPERS[paper].left_out.get(item, "not yet")))
    return found
