"""Costs of every estimator and controller: none is left out, shadows cost what they add, and the emulator's lines are read right."""

import pytest

from mip_rt import robots
from mip_rt.lab import choices


@pytest.mark.parametrize("robot", robots.NAMES)
def test_every_choice_has_a_cost(robot, monkeypatch):
    monkeypatch.setattr(choices, "_seconds", lambda steps, count: (steps(choices.ROWS), 1e-6 * count)[1])
    found = choices.run(robot, True, lambda *_: None)
    setup = robots.setup(robot)
    for name in setup.ESTIMATORS:
        assert found[f"in control {name}"] == pytest.approx(1000.0) and found[f"as a shadow {name}"] == pytest.approx(0.0)
    table = choices.render(found).splitlines()
    assert len(table) == 2 + len(setup.ESTIMATORS) + len(getattr(setup, "CONTROLLERS", ()))
    assert f"| {setup.ESTIMATORS and list(setup.ESTIMATORS)[0]} | 1,000 | 0 |" in table


def test_the_emulators_counts_are_taken_between_the_marks_of_one_choice():
    """The second of the two runs, and never the instructions between two choices."""
    lines, total = [], 0
    for case in choices.cases("edumip"):
        cost = 300 if case.label.startswith("as a shadow") else 200
        for label, instructions in ((case.label, 999 * 50), (case.label, cost * 50), ("end", 123456)):
            lines += [f"mark: {label}", f"instructions: {total}"]
            total += instructions
    found = choices.counted("edumip", lines, 50)
    assert found["in control inertial_ekf"] == 200 and found["as a shadow inertial_ekf"] == 100 and found["controller pid"] == 200
