"""The live reader: newest and new rows of a ring that is being written, restarts, torn rows, a dead loop."""

import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from mip_rt.errors import LogError
from mip_rt.log.live import LiveRing, newest_ring
from mip_rt.log.ring import Ring, header
from mip_rt.robots.mbbr_frame import FRAME, LAYOUT


def make(path, rows=16, **extra):
    return Ring(path, FRAME, rows, header(LAYOUT, "robot: mbbr\n", extra))


def newest(live):
    """The newest complete row; None while there is none."""
    live.refresh()
    rows = live.since(live.counter - 1)
    return rows[-1] if len(rows) else None


def write(ring, first, last):
    for tick in range(first, last):
        index = tick % ring.capacity
        ring.begin(index)
        ring.rows["tick"][index] = tick
        ring.rows["edge_ns"][index] = time.monotonic_ns()
        ring.rows["imu_packet"][index] = tick % 251
        ring.commit(index, tick)


def test_rows_appear_as_they_are_committed(tmp_path):
    """A reader that shows old rows, or rows twice."""
    ring = make(tmp_path / "a.ring")
    with LiveRing(tmp_path / "a.ring") as live:
        assert newest(live) is None and not len(live.since(0)) and not len(live.arrived())
        write(ring, 0, 5)
        assert newest(live)["tick"] == 4 and list(live.since(2)["tick"]) == [2, 3, 4] and live.counter == 5
        assert list(live.arrived()["tick"]) == [0, 1, 2, 3, 4] and not len(live.arrived())
        write(ring, 5, 40)
        assert list(live.since(0)["tick"]) == list(range(25, 40))  # the oldest of the 16 may be overwritten at any moment
        assert list(live.arrived()["tick"]) == list(range(25, 40))
        assert live.dtype == FRAME and live.header["config"] == "robot: mbbr\n"


def test_the_first_call_of_arrived_gives_the_newest_row_only(tmp_path):
    """A tail that begins with a minute of history."""
    write(make(tmp_path / "a.ring"), 0, 9)
    with LiveRing(tmp_path / "a.ring") as live:
        assert list(live.arrived()["tick"]) == [8]


def test_a_row_being_written_is_not_shown(tmp_path):
    ring = make(tmp_path / "a.ring")
    write(ring, 0, 10)
    ring.begin(9)
    with LiveRing(tmp_path / "a.ring") as live:
        assert newest(live) is None and list(live.since(6)["tick"]) == [6, 7, 8]


def test_no_row_is_torn_while_the_writer_runs_at_full_speed(tmp_path):
    """Half of one tick and half of another in one row: every byte of a row's packet tells its tick."""
    ring = make(tmp_path / "a.ring", rows=8)
    stop = threading.Event()

    def turn():
        tick = 0
        while not stop.is_set():
            write(ring, tick, tick + 50)
            tick += 50

    writer = threading.Thread(target=turn)
    writer.start()
    try:
        with LiveRing(tmp_path / "a.ring") as live:
            seen, begun = 0, time.monotonic()
            # How many rows stay whole while they are read is the scheduler's choice: a busy machine only takes longer.
            while (seen <= 100 or time.monotonic() < begun + 1.0) and time.monotonic() < begun + 60.0:
                for row in live.since(0):
                    assert (row["imu_packet"] == row["tick"] % 251).all() and row["sequence"] == row["tick"] + 1
                    seen += 1
        assert seen > 100
    finally:
        stop.set()
        writer.join()


@pytest.mark.parametrize("new_file", [False, True])
def test_a_restart_is_followed(tmp_path, new_file):
    """A reader that shows the old run for ever: the file was truncated and written anew, or another one lies in its place."""
    write(make(tmp_path / "a.ring"), 0, 5)
    with LiveRing(tmp_path / "a.ring") as live:
        assert len(live.arrived()) == 1 and live.runs == 1
        if new_file:
            os.unlink(tmp_path / "a.ring")
            assert newest(live)["tick"] == 4
        ring = make(tmp_path / "a.ring")
        live._looked_s = 0.0
        assert newest(live) is None and live.runs == 2
        write(ring, 0, 9)
        assert list(live.arrived()["tick"]) == list(range(9)) and newest(live)["tick"] == 8


def test_a_file_that_is_cut_under_the_reader_gives_no_rows(tmp_path):
    """A bus error: a mapping of the file would end the reader's process here."""
    write(make(tmp_path / "a.ring"), 0, 5)
    with LiveRing(tmp_path / "a.ring") as live:
        assert newest(live)["tick"] == 4
        os.truncate(tmp_path / "a.ring", 0)
        assert newest(live) is None and not len(live.since(0)) and not len(live.arrived())


def test_the_newest_ring_of_a_folder_is_found_and_a_newer_one_followed(tmp_path):
    write(make(tmp_path / "a.ring"), 0, 5)
    os.utime(tmp_path / "a.ring", (1, 1))
    with LiveRing([tmp_path, tmp_path / "nowhere"]) as live:
        assert live.path.name == "a.ring"
        write(make(tmp_path / "b.ring"), 0, 2)
        live._looked_s = 0.0
        # Of two loops that run at a time, both would seem the newest in turn.
        assert not live.refresh() and live.path.name == "a.ring"
        live._moved_s -= 1.0
        assert live.refresh() and live.path.name == "b.ring" and newest(live)["tick"] == 1
    assert newest_ring(tmp_path).name == "b.ring" and newest_ring(tmp_path / "nowhere") is None


def test_quiet_time_tells_a_dead_loop_at_once(tmp_path):
    """Attaching to a loop that died a minute ago must not look like attaching to a live one."""
    ring = make(tmp_path / "a.ring", clock={"monotonic_ns": 0, "realtime_ns": 0})
    write(ring, 0, 5)
    with LiveRing(tmp_path / "a.ring") as live:
        assert live.quiet_s < 5.0
    ring.rows["edge_ns"] -= 60_000_000_000
    with LiveRing(tmp_path / "a.ring") as live:
        assert 59.0 < live.quiet_s < 100.0
        write(ring, 5, 6)
        live.refresh()
        assert live.quiet_s < 5.0
    ring.rows["edge_ns"] = 2**62  # the monotonic clock began anew since
    with LiveRing(tmp_path / "a.ring") as live:
        assert live.quiet_s == np.inf


def test_refusals(tmp_path):
    (tmp_path / "x.txt").write_bytes(b"hello" * 100)
    (tmp_path / "cut.ring").write_bytes((lambda ring: ring.path.read_bytes()[:300])(make(tmp_path / "a.ring")))
    for path, words in ((tmp_path / "x.txt", "not a ring"), (tmp_path / "none", "cannot be opened"), (tmp_path / "cut.ring", "damaged")):
        with pytest.raises(LogError, match=words):
            LiveRing(path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match="no ring in"):
        LiveRing(tmp_path / "empty")


def test_a_killed_process_can_be_attached_to(tmp_path):
    """The rows that a killed process had committed are there."""
    code = (
        "import os, sys, pathlib; sys.path[:0] = ['tests', 'tests/log']\n"
        "import test_live; r = test_live.make(pathlib.Path(sys.argv[1])); test_live.write(r, 0, 12); os.kill(os.getpid(), 9)"
    )
    root = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.ring")], cwd=root, check=False)
    with LiveRing(tmp_path) as live:
        assert newest(live)["tick"] == 11 and not live.finished


def test_an_orderly_end_is_told_from_a_death(tmp_path):
    ring = make(tmp_path / "a.ring")
    write(ring, 0, 3)
    with LiveRing(tmp_path / "a.ring") as live:
        assert not live.finished
        ring.close()
        assert live.finished and newest(live)["tick"] == 2
