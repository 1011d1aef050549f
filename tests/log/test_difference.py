"""`mip-rt log diff`: equal is equal to the bit, and a difference is named by field, tick and size."""

import json

import numpy as np
import pytest

from mip_rt import cli, frame
from mip_rt.log import open as open_log
from mip_rt.log.difference import compare


@pytest.fixture
def pair(make_log, rows):
    """Callable that makes two logs of 100 rows, the second changed by a function of its rows."""

    def make(change=None, **extra):
        a, b = rows(100), rows(100)
        for frames in (a, b):
            frames["battery_v"] = 7.5
            frames["remote_age_s"] = np.nan
        if change:
            b = change(b)
        return open_log(make_log(a, name="a")), open_log(make_log(b, name="b", **extra))

    return make


def changed(name, row, value, index=()):
    def change(frames):
        frames[name][(row, *index)] = value
        return frames

    return change


def test_equal_logs_are_equal(pair):
    """NaN equals NaN: a field that was never measured is no difference."""
    report = compare(*pair())
    assert report["equal"] and report["rows"] == 100 and report["fields"] == {}


def test_first_and_largest_difference(pair):
    def change(frames):
        frames["duty"][40, 2] += 0.25
        frames["duty"][60, 2] -= 0.75
        frames["battery_v"][30] = np.nan
        frames["limits"][50] = 8
        frames["imu_packet"][70, [1, 5]] = 9
        return frames

    report = compare(*pair(change))
    assert not report["equal"] and list(report["fields"]) == ["battery_v", "duty[2]", "limits", "imu_packet"]  # in the order in which they part
    duty = report["fields"]["duty[2]"]
    assert duty["rows"] == 2 and duty["first"] == {"tick": 40, "time_s": 0.2, "a": 0.0, "b": 0.25, "difference": 0.25}
    assert (duty["largest"]["tick"], duty["largest"]["difference"]) == (60, 0.75)
    assert report["fields"]["battery_v"]["largest"]["difference"] == np.inf
    assert report["fields"]["imu_packet"]["first"]["difference"] == 2.0


@pytest.mark.parametrize("bits", [1, 1 << 20, 1 << 51])
def test_one_bit_is_a_difference(pair, bits):
    def change(frames):
        frames["battery_v"].view(np.int64)[13] ^= bits
        return frames

    report = compare(*pair(change))
    assert list(report["fields"]) == ["battery_v"] and report["fields"]["battery_v"]["first"]["tick"] == 13


def test_tolerance(pair):
    a, b = pair(changed("battery_v", 5, 7.5 * (1 + 1e-10)))
    assert not compare(a, b)["equal"] and compare(a, b, tolerance=1e-9)["equal"] and not compare(a, b, tolerance=1e-11)["equal"]
    a, b = pair(changed("battery_v", 5, np.nan))
    assert not compare(a, b, tolerance=1.0)["equal"]


def test_rows_are_compared_by_tick(pair):
    """A log that begins later is compared where both have rows, and that is told."""
    report = compare(*pair(lambda frames: frames[20:90]))
    assert (report["rows"], report["only_a"], report["only_b"]) == (70, 30, 0) and report["fields"] == {} and not report["equal"]


def test_rows_may_be_compared_by_time(make_log, rows):
    """Two runs whose ticks are apart: the second began 50 ticks later by number, and by another clock."""
    a, b = rows(100), rows(100, first=50)
    b["edge_ns"] += 7_000_000_000
    b["edge_ns"][1:] += 400_000  # less than half a tick
    b["battery_v"][40] = 1.0
    report = compare(open_log(make_log(a, name="a")), open_log(make_log(b, name="b")), "time", "battery_v")
    assert (report["rows"], report["only_a"], report["only_b"]) == (100, 0, 0)
    assert report["fields"]["battery_v"]["first"]["tick"] == 40


def test_logs_without_a_common_row_are_different(make_log, rows):
    a, b = open_log(make_log(rows(10), name="a")), open_log(make_log(rows(10, first=100), name="b"))
    assert compare(a, b)["rows"] == 0 and not compare(a, b)["equal"]
    empty = open_log(make_log(rows(0), name="c"))
    for align in ("tick", "time"):
        assert not compare(a, empty, align)["equal"] and not compare(empty, a, align)["equal"]
    one = open_log(make_log(rows(1), name="d"))
    assert compare(one, one, "time")["equal"]


def test_fields_and_configuration_that_only_one_has(make_log, rows):
    layout = frame.Layout(2, ("pitch_rad",), ())
    a = open_log(make_log(rows(10), name="a", config="robot: mbbr\nlimits: {duty: 1.0}\n"))
    b = open_log(make_log(rows(10, layout), layout, name="b", config="robot: edumip\nlimits: {duty: 0.5}\n"))
    report = compare(a, b)
    assert "command_feedback" in report["fields_only_a"] and "duty" in report["fields_only_a"] and not report["equal"]
    assert report["fields_only_b"] == [] and "estimates" in report["fields_only_a"]  # of the estimates A has more numbers
    assert report["configuration"] == [{"key": "robot", "a": "mbbr", "b": "edumip"}, {"key": "limits.duty", "a": 1.0, "b": 0.5}]
    assert compare(a, b, fields="battery_v")["equal"]


def test_the_same_dry_run_twice_is_equal_and_another_seed_is_not(fallen, tmp_path, capsys):
    from helpers import DryRun, make_config

    files = []
    for seed in (1, 1, 2):
        with DryRun(tmp_path / str(len(files)), make_config(log__ring_s="5"), seed=seed) as dry:
            dry.run(1.0)
            files.append(str(dry.session.ring.path))
    assert cli.main(["log", "diff", files[0], files[1]]) == 0 and capsys.readouterr().out.rstrip().endswith("equal")
    assert cli.main(["log", "diff", files[0], files[2]]) == 1
    out = capsys.readouterr().out
    assert "imu_packet" in out and "first" in out and out.rstrip().endswith("different")
    assert cli.main(["log", "diff", files[0], files[2], "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["fields"]["imu_packet"]["rows"] > 100
    assert cli.main(["log", "diff", files[0], "/nowhere"]) == 3
