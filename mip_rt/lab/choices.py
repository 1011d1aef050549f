"""Costs of every estimator and controller of a robot: the compiled step with it in control, and what an estimator adds as a shadow.

Time on this machine by `mip-rt bench choices`; ARM instructions by `tools/test-armhf choices`, whose emulator prints how many have run so
far whenever the program asks for the process group MARK, which nobody has.
"""

import os
import sys
import time
from typing import NamedTuple

import numpy as np

from mip_rt import robots
from mip_rt.lab import costs

ROWS = 8
MARK = 0x6D697072


def standing(robot: str) -> np.ndarray:
    """(ROWS,) consecutive rows of a robot that balances in a dry run."""
    loop, bench = costs.stubbed_loop(robot)
    for _ in range(ROWS):
        loop.tick()
    rows = np.array([loop.ring.rows[tick % loop.ring.capacity] for tick in range(loop.ticks - ROWS, loop.ticks)])
    loop.supervisor.shut_down()
    bench.close()
    return rows


class Case(NamedTuple):
    """One choice: its label, its settings, and the label whose cost is to be subtracted."""

    label: str
    settings: dict
    less: str | None = None


def cases(robot: str) -> list[Case]:
    """Each estimator in control, each as a shadow beside another, each controller."""
    setup, shipped = robots.setup(robot), costs.shipped(robot).estimator.control
    other = next(name for name in setup.ESTIMATORS if name != shipped)
    listed = [Case(f"in control {name}", {"estimator.control": name}) for name in setup.ESTIMATORS]
    for name in setup.ESTIMATORS:
        control = other if name == shipped else shipped
        settings = {"estimator.control": control, "estimator.shadows": f"[{name}]"}
        listed.append(Case(f"as a shadow {name}", settings, f"in control {control}"))
    return listed + [Case(f"controller {name}", {"control.controller": name}) for name in getattr(setup, "CONTROLLERS", ())]


def _differences(robot: str, whole: dict) -> dict:
    """What each choice costs, from the cost of the whole steps."""
    return {case.label: whole[case.label] - (whole[case.less] if case.less else 0.0) for case in cases(robot)}


def stepper(robot: str, settings: dict, rows):
    """A function that makes a number of steps of such a robot on these rows over and over."""
    built = robots.setup(robot).build(costs.shipped(robot, **settings))
    built.attach(rows.copy())

    def steps(count: int) -> None:
        step = built.step
        for k in range(count):
            step(k & (ROWS - 1))

    return steps


def run(robot: str, quick: bool, progress) -> dict:
    """{label: nanoseconds a step, the best of several short runs taken in turn; for a shadow what it adds}."""
    rows, listed = standing(robot), cases(robot)
    count, rounds = 1000, (10 if quick else 60)
    made = {case.label: stepper(robot, case.settings, rows) for case in listed}
    whole = dict.fromkeys(made, np.inf)
    for number in range(rounds):
        progress(number, rounds, robot)
        for label, steps in made.items():
            steps(ROWS)
            whole[label] = min(whole[label], _seconds(steps, count) / count * 1e9)
    progress(rounds, rounds, "")
    return _differences(robot, whole)


def _seconds(steps, count: int) -> float:
    begin = time.perf_counter()
    steps(count)
    return time.perf_counter() - begin


def render(found: dict, unit: str = "ns") -> str:
    """Markdown."""
    named = dict.fromkeys(key.split()[-1] for key in found if key.startswith(("in control", "controller")))
    lines = [f"| estimator or controller | whole step ({unit}) | added as a shadow ({unit}) |", "|---|---|---|"]
    for name in named:
        whole = found.get(f"in control {name}", found.get(f"controller {name}"))
        shadow = found.get(f"as a shadow {name}")
        lines.append(f"| {name} | {whole:,.0f} | {'' if shadow is None else f'{shadow:,.0f}'} |")
    return "\n".join(lines)


def mark(label: str) -> None:
    """Names the next count of the emulator and asks for it, both on standard error."""
    sys.stderr.write(f"mark: {label}\n")
    sys.stderr.flush()
    try:
        os.getpgid(MARK)
    except ProcessLookupError:
        pass


def count(robot: str, steps_each: int) -> None:
    """Makes so many steps of each choice between two marks: to be run in the emulator."""
    rows = standing(robot)
    for case in cases(robot):
        steps = stepper(robot, case.settings, rows)
        steps(ROWS)
        for _ in range(2):
            mark(case.label)
            steps(steps_each)
        mark("end")


def counted(robot: str, lines, steps_each: int) -> dict:
    """What `run` returns, in instructions, from the lines that the emulator has written while `count` ran.

    The second of two runs counts; the marks' own instructions are in every one, some hundreds, shared by all its steps.
    """
    marks = []
    for line in lines:
        if line.startswith("mark: "):
            marks.append([line[6:].strip(), None])
        elif line.startswith("instructions: ") and marks and marks[-1][1] is None:
            marks[-1][1] = int(line.split()[1])
    return _differences(robot, {label: (end - begin) / steps_each for (label, begin), (_, end) in zip(marks, marks[1:]) if label != "end"})
