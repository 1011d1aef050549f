"""`mip-rt log tail`: what it prints is what the loop wrote, it ends when the loop has, and follows the next run when told to."""

import json
import threading
import time

import numpy as np
import pytest

from mip_rt import cli
from mip_rt.log.ring import Ring, header
from mip_rt.robots.mbbr_frame import FRAME, LAYOUT


class Writer(threading.Thread):
    """A loop of 200 Hz that writes `count` ticks into a ring and ends as told."""

    def __init__(self, path, count, finish=True, rows=1000, **about):
        super().__init__(daemon=True)
        self.ring = Ring(path, FRAME, rows, header(LAYOUT, "robot: mbbr\n", {"estimators": ["one"], **about}))
        self.count, self.finish = count, finish

    def run(self):
        for tick in range(self.count):
            index = tick % self.ring.capacity
            self.ring.begin(index)
            row = self.ring.rows[index]
            row["tick"], row["edge_ns"], row["battery_v"] = tick, time.monotonic_ns(), 7.0 + tick * 1e-3
            row["write_ns"] = row["edge_ns"] + (5_000_000 if tick == 30 else 100_000)
            row["missed"] = tick == 31
            row["limits"] = 16 if tick == 32 else 0
            self.ring.commit(index, tick)
            time.sleep(0.005)
        if self.finish:
            self.ring.close()


def lines(capsys, *arguments):
    assert cli.main(["log", "tail", *map(str, arguments)]) == 0
    captured = capsys.readouterr()
    return captured.out.splitlines(), captured.err


def test_every_row_once_in_order_and_the_end_with_the_loop(tmp_path, capsys):
    writer = Writer(tmp_path / "a.ring", 100)
    writer.start()
    out, err = lines(capsys, tmp_path / "a.ring", "--every", "--json", "--fields", "battery_v")
    rows = [json.loads(line) for line in out]
    ticks = [row["tick"] for row in rows]
    assert ticks == list(range(ticks[0], 100)) and ticks[0] < 60
    assert all(row["battery_v"] == 7.0 + row["tick"] * 1e-3 for row in rows) and "the loop has ended" in err


def test_rate(tmp_path, capsys):
    """Lines come at the rate that was asked for, whatever the loop's."""
    writer = Writer(tmp_path / "a.ring", 10_000)
    writer.start()
    begin = time.monotonic()
    out, _ = lines(capsys, tmp_path, "--rate", "20", "--lines", "12", "--fields", "battery_v")
    assert len(out) == 12 and 0.5 < time.monotonic() - begin < 3.0


def test_what_happened_between_two_lines_is_told(tmp_path, capsys):
    """At one line a second, 199 of 200 rows are not shown: what was slow, missed or limited in them must be."""
    writer = Writer(tmp_path / "a.ring", 80)
    writer.start()
    out, _ = lines(capsys, tmp_path, "--rate", "2", "--json")
    rows = [json.loads(line) for line in out]
    assert max(row["slowest_us"] for row in rows) == 5000.0 and sum(row["missed"] for row in rows) == 1
    assert [row["limits"] for row in rows if row["limits"]] == [["lean_limited"]]


def test_the_next_run_is_followed(tmp_path, capsys):
    Writer(tmp_path / "a.ring", 5).run()

    def restart():
        time.sleep(0.7)
        Writer(tmp_path / "a.ring", 40).run()

    threading.Thread(target=restart, daemon=True).start()
    out, err = lines(capsys, tmp_path, "--follow", "--every", "--json", "--fields", "battery_v", "--lines", "31")
    assert [json.loads(line)["tick"] for line in out] == [4, *range(30)] and err.count("the loop has ended") == 1


def test_a_dead_loop_shows_its_last_row_and_how_long_ago(tmp_path, capsys):
    """A loop that was killed must not look as if it ran, nor keep the tail waiting for ever."""
    writer = Writer(tmp_path / "a.ring", 10, finish=False, clock={"monotonic_ns": 0, "realtime_ns": 0})
    writer.run()
    writer.ring.rows["edge_ns"] -= 10_000_000_000
    out, err = lines(capsys, tmp_path / "a.ring")
    assert len(out) == 1 and float(err.partition("no row for ")[2].split()[0]) >= 10.0


def test_text_of_the_usual_line(fallen, capsys):
    out, err = lines(capsys, fallen)
    assert len(out) == 1 and "fall" in err
    for words in ("10.995 s", "FAULT", "fault tipped", "battery_unknown", "deg"):
        assert words in out[0], out[0]
    out, err = lines(capsys, fallen, "--fields", "duty,imu_packet,tick")
    assert len(out[0].split()) == 6 and "duty[0] (1)" in err and int(out[0].split()[-1]) == 2199
    out, _ = lines(capsys, fallen, "--json")
    assert json.loads(out[0])["battery_v"] is None  # JSON has no NaN


def test_the_ring_is_opened_for_reading_only(fallen, capsys):
    """Attaching must not change a byte, not even of a ring that may not be written."""
    fallen.chmod(0o444)
    before = (fallen.stat().st_mtime_ns, np.fromfile(fallen, np.uint8).sum())
    lines(capsys, fallen)
    assert (fallen.stat().st_mtime_ns, np.fromfile(fallen, np.uint8).sum()) == before


@pytest.mark.parametrize("arguments", [["--rate", "0"], ["--fields", "nothing"], ["/nowhere.ring"]])
def test_refusals(fallen, capsys, arguments):
    path = [] if arguments[0].startswith("/") else [str(fallen)]
    assert cli.main(["log", "tail", *path, *arguments]) == 3 and "cure" in capsys.readouterr().err
