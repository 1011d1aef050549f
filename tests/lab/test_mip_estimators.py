"""The table of the eduMIP's estimators: every one is in it, and what it is there to show."""

from mip_rt.lab import mip_estimators
from mip_rt.robots.edumip_setup import ESTIMATORS


def test_ours_errs_by_less_than_half_of_every_other(monkeypatch):
    """On the same samples of one turning column; a filter that did not know the IMU's place would err by a hundred times as much."""
    column = "10 rad/s, displaced"
    monkeypatch.setattr(mip_estimators, "COLUMNS", {column: mip_estimators.COLUMNS[column]})
    monkeypatch.setattr(mip_estimators, "DURATION_S", 14.0)
    table = mip_estimators.run(True, lambda jobs: [mip_estimators.work(job) for job in jobs])
    errors = table[column]
    assert set(errors) == {*ESTIMATORS, "fell"} and errors["fell"] == 0
    ours = errors["inertial_ekf"]
    assert ours < 1e-3 and ours < 0.5 * min(errors[name] for name in ESTIMATORS if name != "inertial_ekf")
    assert errors["complementary"] > 0.1
    lines = mip_estimators.render(table).splitlines()
    assert len(lines) == len(ESTIMATORS) + 3 and f"| inertial_ekf | {1e3 * ours:.2f} |" in lines
