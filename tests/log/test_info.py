"""`mip-rt log info`: nothing that happened is left out, and every time and number is that of the rows."""

import json

import numpy as np
import pytest

from mip_rt import cli
from mip_rt.errors import ConfigError
from mip_rt.faults import FAULTS
from mip_rt.frame import ALARMS, LIMITS
from mip_rt.log import open as open_log
from mip_rt.log.info import EDGES_US, render, report
from mip_rt.prearm import CHECKS
from mip_rt.supervisor import State


def info(path, config=None):
    return report(open_log(path), config)


def test_a_fall_is_told_with_its_time_cure_and_what_came_before(fallen):
    """The user must not have to look for the reason in 300 columns."""
    found, log = info(fallen), open_log(fallen)
    (fault,) = found["faults"]
    row = np.flatnonzero(log.frames["state"] == State.FAULT)[0] - 1
    assert fault["tick"] == log.frames["tick"][row] and fault["code"] == "tipped" and fault["cure"] == FAULTS["tipped"].cure
    assert fault["time_s"] == pytest.approx(row * 0.005, abs=1e-6)
    before = log.frames[row - 199 : row + 1]
    assert fault["limits_before"]["wheel_saturated"] == np.count_nonzero(before["limits"] & LIMITS["wheel_saturated"]) > 0
    assert [entry["state"] for entry in found["states"]] == ["BOOT", "CALIBRATING", "DISARMED", "ARMING", "BALANCING", "FAULT"]
    text = render(found)
    for words in ("tipped: the robot leaned too far; cure: stand it up", "wheel_saturated in", "BALANCING", "estimators dmp_ekf", "seed 1"):
        assert words in text


def test_limits_have_counts_and_first_and_last_time(make_log, rows):
    frames = rows(100)
    frames["limits"][[10, 11, 80]] = LIMITS["lean_limited"]
    frames["limits"][80] |= LIMITS["remote_lost"] | 1 << 40
    frames["imu_status"] = 1
    frames["imu_status"][5] = 1 | 4
    frames["alarms"][70:75] = ALARMS["encoder_static"]
    frames["state"], frames["refusals"] = State.DISARMED, CHECKS["battery_low"].bit
    found = info(make_log(frames))
    assert {n: e["ticks"] for n, e in found["alarms"].items()} == {"encoder_static": 5} and found["refusals"]["battery_low"]["ticks"] == 100
    assert {n: (e["ticks"], e["first_s"], e["last_s"]) for n, e in found["limits"].items()} == {
        "lean_limited": (3, 0.05, 0.4), "remote_lost": (1, 0.4, 0.4), "bit 40": (1, 0.4, 0.4)}  # fmt: skip
    assert {n: e["ticks"] for n, e in found["imu"].items()} == {"backlog": 1}


def test_latencies_by_stage_and_the_slowest_ticks(make_log, rows):
    frames = rows(1000)
    frames["write_ns"][700] += 3_000_000
    frames["wake_ns"][20] += 100_000  # the stages after it are then shorter, not the whole
    found = info(make_log(frames))
    assert found["latency_us"]["wake"] == {"p50": 50.0, "p99": 50.0, "p999": 50.1, "max": 150.0}
    assert found["latency_us"]["edge_to_write"]["max"] == 3300.0
    assert (found["worst"][0]["tick"], found["worst"][0]["write"], len(found["worst"])) == (700, 3040.0, 10)
    edges, counts = found["histogram_us"]["edges"], found["histogram_us"]["edge_to_write"]
    assert edges[:-1] == list(EDGES_US[:-1]) and sum(counts) == 1000
    assert counts[EDGES_US.index(200)] == 999 and counts[EDGES_US.index(2000)] == 1
    assert "200 to 500" in render(found) and "2000 to 5000" in render(found)


def test_missed_ticks_and_lost_rows_are_told_apart(make_log, rows):
    """Interrupts that the loop missed are the loop's; rows that are not in the log are the recorder's."""
    frames = np.delete(rows(100), [40, 41, 42])
    frames["missed"][10] = 2
    frames["edge_ns"][10:] += 10_000_000
    found = info(make_log(frames))
    assert (found["missed"], found["lost"]) == (2, 3)
    assert [(e["tick"], e["missed"]) for e in found["missed_at"]] == [(10, 2)] and [(e["tick"], e["lost"]) for e in found["lost_at"]] == [(43, 3)]
    assert found["rate_hz"] == pytest.approx(200.0, abs=0.01)


@pytest.mark.parametrize(
    ("states", "faults", "wanted"),
    [
        ([4, 4, 5, 5], [0, 4, 4, 4], [(1, "tipped")]),
        ([4, 4, 5, 5], [0, 0, 1, 1], [(2, "imu_silent")]),  # no row when it was raised
        ([4, 4, 4, 4], [0, 0, 0, 4], [(3, "tipped")]),  # the log ends with the tick of the fault
        ([5, 5, 2, 2], [4, 4, 4, 4], [(0, "tipped")]),  # the log begins after it
        ([5, 2, 4, 5], [4, 4, 4, 4], [(0, "tipped"), (3, "tipped")]),  # the same again after it was acknowledged
        ([4, 4, 5, 5], [2, 4, 4, 4], [(1, "tipped")]),  # another one than before
        ([4, 4, 5, 5], [0, 99, 99, 99], [(1, "fault 99")]),  # of a newer program
        ([2, 2, 4, 4], [0, 0, 0, 0], []),
    ],
)
def test_every_fault_is_found_once(make_log, rows, states, faults, wanted):
    frames = rows(4)
    frames["state"], frames["fault"] = states, faults
    assert [(f["tick"], f["code"]) for f in info(make_log(frames))["faults"]] == wanted


def test_a_log_that_begins_late_keeps_the_time_of_the_run(make_log, rows):
    """The times of info, plot and monitor must agree, also when the ring has lost the beginning."""
    found = info(make_log(rows(50, first=1000)))
    assert found["begin_s"] == 5.0 and found["worst"][0]["time_s"] == 5.0 + 0.005 * (found["worst"][0]["tick"] - 1000)


def test_configuration_differences_against_a_file(fallen, tmp_path):
    other = tmp_path / "other.yaml"
    other.write_text("robot: mbbr\ncontrol: {lean_limit_rad: 0.1}\n")
    found = info(fallen, other)["configuration"]
    differing = {d["key"]: (d["log"], d["file"]) for d in found["differences"]}
    assert differing["control.lean_limit_rad"][1] == 0.1 and differing["log.ring_s"] == (20.0, 120.0) and len(differing) == 3
    assert "control.lean_limit_rad" in render(info(fallen, other))
    assert [d["key"] for d in info(fallen)["configuration"]["differences"]] == ["limits.tip_rad", "log.ring_s"]
    other.write_text("robot: mbbr\nnonsense: 1\n")
    with pytest.raises(ConfigError, match="nonsense"):
        info(fallen, other)


def test_command_line(fallen, capsys, make_log, rows):
    assert cli.main(["log", "info", str(fallen)]) == 0 and "tipped" in capsys.readouterr().out
    assert cli.main(["log", "info", str(fallen), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ticks"] == 2200
    assert cli.main(["log", "info", str(fallen), "--fields"]) == 0
    listed = capsys.readouterr().out
    assert "battery_v" in listed and "[0] dmp_ekf" in listed and "ball_rate_x_rad_s" in listed
    assert cli.main(["log", "info", str(make_log(rows(0)))]) == 3 and "no complete row" in capsys.readouterr().err


def test_the_newest_log_is_taken_when_none_is_named(fallen, make_log, rows, monkeypatch, capsys, tmp_path):
    from mip_rt.log import folders

    monkeypatch.setattr(folders, "usual_folders", lambda: [tmp_path])
    monkeypatch.setattr(folders, "usual_record_folder", lambda: tmp_path / "recorded")
    assert cli.main(["log", "info"]) == 3 and "there is no log in" in capsys.readouterr().err
    make_log(rows(3), name="new")
    assert cli.main(["log", "info", "--json"]) == 0 and json.loads(capsys.readouterr().out)["log"].endswith("new.ring")


def test_damage_is_shown(fallen, tmp_path, capsys):
    cut = tmp_path / "cut.ring"
    cut.write_bytes(fallen.read_bytes()[:3_000_000])
    assert cli.main(["log", "info", str(cut)]) == 0 and "damage: " in capsys.readouterr().out


def test_a_closed_pipe_is_no_error(fallen):
    """`mip-rt log info | head -1` ended in a traceback."""
    import subprocess
    import sys

    code = f"import sys; from mip_rt import cli; sys.exit(cli.main(['log', 'info', {str(fallen)!r}]))"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    assert process.stderr.read() == b"" and process.wait(30) == 0


def test_no_action_imports_numba_and_help_not_even_numpy(fallen):
    """On the BeagleBone importing numba takes seconds, and none of this needs it."""
    import subprocess
    import sys

    code = (
        "import sys; from mip_rt import cli\n"
        "try: cli.main(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        "print(*(name for name in ('numba', 'numpy', 'yaml', 'matplotlib') if name in sys.modules), file=sys.stderr)"
    )
    for arguments, allowed in ((["log", "--help"], ""), (["log", "tail", "--help"], ""), (["log", "info", str(fallen)], "numpy yaml"),
                               (["log", "tail", str(fallen)], "numpy yaml")):  # fmt: skip
        result = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
        assert result.stderr.splitlines()[-1] == allowed and result.stdout, arguments
