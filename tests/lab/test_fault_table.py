"""The table of faults: how injections are judged, and that the README's is about the faults there are."""

import math
from pathlib import Path

import pytest

from mip_rt.fake.faults import FAULTS, OFF, RIDES, ZERO
from mip_rt.lab import fault_table
from mip_rt.lab.soak_run import Reaction

README = Path(__file__).parents[2] / "README.md"
OFF_FAULT = next(name for name, kind in FAULTS.items() if kind.promise == OFF and kind.weight)
ZERO_FAULT = next(name for name, kind in FAULTS.items() if kind.promise == ZERO and kind.weight)
RIDING_FAULT = next(name for name, kind in FAULTS.items() if kind.promise == RIDES and kind.weight)
BOUND_S = FAULTS[OFF_FAULT].bound_s


@pytest.mark.parametrize("name, reaction, failed", [
    (OFF_FAULT, {"off_s": BOUND_S}, 0),
    (OFF_FAULT, {"off_s": BOUND_S + 0.001}, 1),
    (OFF_FAULT, {}, 1),
    (ZERO_FAULT, {"zero_s": FAULTS[ZERO_FAULT].bound_s}, 0),
    (ZERO_FAULT, {"zero_s": FAULTS[ZERO_FAULT].bound_s + 0.005}, 1),
    (RIDING_FAULT, {"lean_rad": 0.1}, 0),
    (RIDING_FAULT, {"fell": True}, 1),
    (RIDING_FAULT, {"off_s": 0.3}, 1),
])  # fmt: skip
def test_a_reaction_is_judged_by_the_promise(name, reaction, failed):
    good = {OFF: {"off_s": 0.0}, ZERO: {"zero_s": 0.0}, RIDES: {}}[FAULTS[name].promise]
    found = [Reaction(name, 1.0, True, **good), Reaction(name, 2.0, True, **reaction), Reaction(name, 3.0, False)]
    row = fault_table.judge(name, found)
    assert row["injected"] == 2 and row["failed"] == failed
    assert ("FAILED" in fault_table.render({"faults": {name: row}, "broken": []})) == bool(failed)


def test_the_table_of_the_readme_is_about_the_faults_there_are():
    text = README.read_text()
    rows = [line.split(" | ") for line in text.split("<!-- faults:begin -->")[1].split("<!-- faults:end -->")[0].splitlines() if line.startswith("| `")]
    shown = {row[0].strip("| `"): row for row in rows}
    assert list(shown) == [name for name, kind in FAULTS.items() if kind.weight], "put the output of `mip-rt soak --table` between the markers"
    for name, (_, boundary, meaning, promise, injected, worst, result) in shown.items():
        kind = FAULTS[name]
        assert (boundary, meaning) == (kind.boundary, kind.meaning)
        assert promise == kind.promise + (f" within {kind.bound_s * 1e3:g} ms" if kind.promise in (OFF, ZERO) else "")
        assert int(injected) >= 100 and "FAILED" not in result
        if worst.endswith(" ms") and kind.promise in (OFF, ZERO):
            assert float(worst.split()[0]) <= kind.bound_s * 1e3
        assert not math.isnan(float(worst.split()[-2]))
