"""Every experiment in quick mode: it runs, draws, and shows what it is there to show. The claims named here are the central ones; others may fail honestly."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("PIL")

from mip_rt import cli
from mip_rt.lab.papers import catalogue, experiments, report
from mip_rt.lab.papers.experiment import Claim, Experiment, Result, Row

KNOWN = experiments()
# Experiment: the beginnings of the claims that must hold even in a short run.
CENTRAL = {
    "acc-table-3": ("at 10 rad/s DMP and yaw EKF", "Fig. 5", "the robot balances", "against the simulated truth our inertial EKF"),
    "parameters": ("every shipped parameter",),
    "dissertation-table-2.1": ("the axes are orthogonal",),
    "dissertation-fig-2.10": ("12:1 gives",),
    "dissertation-tables-4.4-4.5": ("the drive/coast model explains", "the linear model's RMSE", "motor 1", "motor 2", "motor 3"),
    "dissertation-fig-4.2": ("in the first case", "the closed form"),
    "dissertation-fig-4.6": ("compensated, a coasting bridge", "without compensation it is less stable"),
    "dissertation-fig-5.3": ("the printed regressor",),
    "dissertation-fig-6.3": ("the ball first moves against", "then it follows"),
    "dissertation-fig-6.4": ("without compensation the estimated", "compensation makes", "Fig. 6.8"),
    "dissertation-fig-6.6": ("with c2 = 0.2", "with the printed gains"),
    "dissertation-table-6.1": ("the robot balances", "tilt and speed errors grow"),
    "dissertation-table-6.1-causes": ("without any of these", "nothing else"),
    "dissertation-fig-6.14": ("at 1 Hz and more the DMP", "EKF and KF have almost"),
    "dissertation-fig-6.24": ("at every drive rate", "the line's frequency"),
    "dissertation-figs-6.25-6.32": ("at 1.5 Hz the EKF loses", "DMP+KF is the stabler", "ours"),
    "omurchadha-fig-2": ("both angles", "energy"),
    "omurchadha-figs-3-4": ("Fig. 3", "Fig. 4: PID", "Fig. 4: θ", "τ = Kx", "LQR designed"),
    "omurchadha-fig-5": ("the EKF tracks",),
    "omurchadha-fig-6": ("the EKF in the loop",),
    "omurchadha-fig-7": ("the robot goes",),
    "omurchadha-fig-8": ("the robot follows",),
    "aoyagi-figs-2-4": ("the EKF on the MPU-9250", "its lag", "the EKF on the BNO055", "the integrated gyro", "Fig. 4"),
    "lee-jung-fig-6": ("at rest the Kalman", "in motion the Kalman filter is more accurate"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", KNOWN)
def test_central_claims_hold_and_figures_are_drawn(name):
    result = KNOWN[name].run(1, True, lambda done, total: None)
    for beginning in CENTRAL[name]:
        found = [claim for claim in result.claims if claim.text.startswith(beginning)]
        assert found and all(claim.holds for claim in found), [claim.text for claim in found] or beginning
    assert result.settings
    picture = next((f for f in result.figures if f.kind == "png"), None)
    assert picture is None or picture.render()[:4] == b"\x89PNG"


def test_acc_table_3_comes_from_the_imu_offset():
    """The complementary filter at 10 rad/s: 0.16 rad, from 16 mm; a filter that knew the place, or a robot that did not turn, would show a tenth."""
    from mip_rt.lab.papers import acc2018

    record = acc2018._run(10.0, 2, 12.0)
    rows, truth, _ = record.after(acc2018.SETTLE_S)
    bias = float((rows["estimates"][:, record.slot("complementary"), 0] - truth["pitch_rad"]).mean())
    assert 0.7 * 0.1605 < bias < 1.3 * 0.1605


def test_nothing_is_left_out_silently():
    """Every numbered table and figure has an experiment or a reason, and every experiment shows something that exists, once."""
    listed = catalogue.entries(KNOWN)
    items = {(entry.paper, entry.item) for entry in listed}
    shown = [pair for e in KNOWN.values() for pair in catalogue.pairs(e)]
    assert len(shown) == len(set(shown)) and set(shown) <= items
    for paper, (_, left_out) in catalogue.PAPERS.items():
        assert {(paper, item) for item in left_out} <= items - set(shown)
    assert [entry for entry in listed if not entry.experiment and entry.reason == "not yet"] == []
    assert set(CENTRAL) == set(KNOWN)


def test_readme_counts_are_the_catalogues():
    listed = catalogue.entries(KNOWN)
    shown = sum(1 for entry in listed if entry.experiment)
    text = (Path(__file__).parents[2] / "README.md").read_text()
    assert f"{len(KNOWN)} experiments show {shown} of the {len(listed)} numbered tables and figures" in text


def test_verdicts_are_derived():
    same, other = Row("a", 1.2, 1.0, 0.3), Row("a", 1.4, 1.0, 0.3)
    assert same.verdict == "within 30 %" and other.verdict == "no: 1.40 times" and Row("a", 1.0).verdict == ""
    assert Row("a", 0.95, 0.9, by=0.1).verdict == "within 0.1" and Row("a", 0.7, 0.9, by=0.1).verdict == "no: -0.2"
    ranged = [Row("a", ours, (1.5, 2.0), 0.1).verdict for ours in (1.6, 2.1, 2.5)]
    assert ranged == ["in the range", "within 10 % of the range", "no: 1.43 times its middle"]
    assert Result([same], [Claim("x", True)]).verdict == "reproduced"
    assert Result([other], [Claim("x", True)]).verdict == "partly"
    assert Result([other], [Claim("x", False)]).verdict == "not reproduced"


def test_the_spin_that_a_robot_gives_up_counts_as_lost():
    """A robot that saves its balance by its spin-down does not fall; what it was to do it does no longer."""
    from mip_rt.lab.papers.mbbr_runs import SPUN_UP_S, held_s
    from mip_rt.lab.papers.runs import Record

    time_s = np.arange(0.0, 20.0, 0.005)
    truth = np.zeros(len(time_s), [("yaw_rate_rad_s", "f8")])
    truth["yaw_rate_rad_s"] = np.where(time_s < 12.0, 2.0 * np.pi, 0.0)
    record = Record(["ekf"], truth, truth, time_s, False)
    assert SPUN_UP_S < held_s(record, 1.0) == pytest.approx(12.0)
    assert held_s(record, 0.0) == pytest.approx(SPUN_UP_S, abs=0.01)


def test_table_6_1_comes_from_the_missing_rotation():
    """The EKF as flown errs where the robot turns and moves at once; standing still it does not, nor with the rotation in its model."""
    from mip_rt.lab.papers import dissertation_table61, mbbr_runs

    overrides = {**dissertation_table61.SHADOWS, "estimator.noise_set": "friction"}
    still, moving = (mbbr_runs.see(mbbr_runs.fly(0.5, speed, overrides, 15.0, 2), 2) for speed in (0.0, 0.1))
    flown = [seen.errors("ekf_flown")[0] for seen in (still, moving)]
    assert flown[0] < 0.025 and abs(flown[1] / 0.057 - 1.0) < 0.3 and moving.errors("ekf")[0] < 0.025


def test_numbers_and_lists_read_like_the_papers():
    assert [report.number(value, 3) for value in (22.0, 170.0, 0.06, 1234.4, 6.3e-5, 0.0)] == ["22.0", "170", "0.0600", "1234", "6.30e-05", "0"]
    assert report.published((0.02, 0.03)) == "0.02 to 0.03" and report.published(None) == ""
    assert report.listed(("Table 6.1", "Fig. 6.9", "Fig. 6.10", "Fig. 6.11", "Fig. 6.13")) == "Table 6.1, Figs 6.9 to 6.11, Fig. 6.13"
    assert report.listed(("Table III", "Fig. 4", "Fig. 5")) == "Table III, Figs 4 and 5"


def test_report_holds_everything_and_needs_nothing(tmp_path, monkeypatch, capsys):
    """Through the command line: all with two small experiments; pictures are embedded, no address is loaded."""
    import mip_rt.lab.papers as papers

    few = {name: KNOWN[name] for name in ("dissertation-fig-2.10", "dissertation-table-2.1")}
    monkeypatch.setattr(papers, "experiments", lambda: few)
    monkeypatch.setattr("mip_rt.lab.batch.completed", lambda work, jobs, *_: ((job, work(job)) for job in jobs))
    assert cli.main(["reproduce", "all", "--quick", "--json", "--out", str(tmp_path)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed) == set(few) and printed["dissertation-table-2.1"]["verdict"] == "reproduced"
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2 and not re.search(r'(src|href)="(?!#|data:)', page)
    assert "35.2644" in page and "not shown: photograph" in page and (tmp_path / "dissertation-fig-2.10.png").exists()


def test_unknown_experiment_is_refused_with_a_suggestion(capsys):
    assert cli.main(["reproduce", "acc-table-4"]) == 2
    assert "acc-table-3" in capsys.readouterr().err


def test_list_says_what_is_not_shown_and_why(capsys):
    assert cli.main(["reproduce", "list"]) == 0
    assert "finite-element" in capsys.readouterr().out


def test_experiment_is_a_value():
    """Experiments are looked up by name in worker processes: two of one name would run the wrong one."""
    assert len({e.name for e in KNOWN.values()}) == len(KNOWN) and all(isinstance(e, Experiment) for e in KNOWN.values())
