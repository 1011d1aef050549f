"""The recorder: complete, bounded; rows that it lost, and troubles of the disk, are counted."""

import errno
import os
import resource
import subprocess
from pathlib import Path

import numpy as np
import pytest
from recorder_bench import Bench

from mip_rt.lab import log_damage
from mip_rt.log import open as open_log
from mip_rt.log import recorder as recorder_module
from mip_rt.log import recording_files
from mip_rt.robots.mbbr_frame import FRAME
from mip_rt.summary import render_recorder


def test_run_is_recorded_completely(tmp_path):
    """What the reader gives from the recorded files must be what the loop wrote, bit for bit, also at full speed and beyond the ring."""
    with_ring = log_damage.dry_run(tmp_path, 15.0, tmp_path)
    recorder = with_ring["recorder"]
    assert recorder["state"] == "finished" and recorder["recorded"] == with_ring["ticks"] == 3000
    assert not recorder["dropped"] and not recorder["backlog"] and not recorder["errors"]
    ring, folder, above = open_log(with_ring["log"]), open_log(recorder["folder"]), open_log(tmp_path)
    for log in (folder, above):
        assert log.damage == [] and log.frames.dtype == ring.frames.dtype and log.header == ring.header and log.config == ring.config
        assert log.frames.tobytes() == ring.frames.tobytes()
        assert log.end["reason"] == "the loop has ended" and log.end["recorded"] == 3000 and len(log.recorder) >= 1
    report = log_damage.dry_run(tmp_path / "long", 30.0, tmp_path / "long", log__ring_s=8)
    log = open_log(report["log"])
    assert report["log"] == report["recorder"]["folder"] and list(log.frames["tick"]) == list(range(report["ticks"])) and log.damage == []
    assert log.frames[:3000].tobytes() == ring.frames.tobytes()


def test_no_recorder_unless_asked(tmp_path):
    """A dry run without --log leaves no process and no files; the summary says so."""
    report = log_damage.dry_run(tmp_path, 2.0, None)
    assert report["recorder"] is None and [path.suffix for path in tmp_path.iterdir()] == [".ring"]


def test_header_says_everything_that_a_reader_must_know(tmp_path):
    """Without it a log of next year's program, or of another robot, could not be understood."""
    about = open_log(log_damage.dry_run(tmp_path, 1.0, None)["log"]).header
    assert {"name", "dtype", "shape", "unit", "meaning", "offset"} <= set(about["fields"][0])
    for field in about["fields"]:
        assert FRAME.fields[field["name"]][1] == field["offset"]
    assert set(about["versions"]) == {"python", "numba", "numpy", "llvmlite"} and {"kernel", "name", "machine", "cpu"} <= set(about["host"])
    assert set(about["clock"]) == {"monotonic_ns", "realtime_ns"} and len(about["source_hash"]) == 16 and len(about["run"]) == 16
    assert about["codes"]["fault"]["4"] == "tipped" and about["codes"]["state"]["4"] == "BALANCING"
    assert about["calibration"]["gyro_bias_rad_s"] == [0.0, 0.0, 0.0] and about["seed"] == 1 and about["estimators"] == ["dmp_ekf"]
    if (Path(__file__).parents[2] / ".git").exists():
        commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True, check=True).stdout
        assert about["commit"]["hash"] == commit.strip() and about["commit"]["dirty"] in (True, False)


def test_ring_of_files_is_bounded_over_all_runs_and_removes_the_oldest(tmp_path):
    """The disk of a robot that is switched on a thousand times must not fill."""
    for run in range(5):
        bench = Bench(tmp_path, run_folder=f"run{run}", file_bytes=400_000, compression=0)
        for _ in range(20):
            bench.tick(80)
            bench.record()
        files = recording_files.recorded_files(tmp_path)
        assert sum(path.stat().st_size for path in files) <= 4 * 400_000
        numbers = [int(path.stem) for path in files]
        assert numbers == list(range(numbers[0], numbers[-1] + 1)) and len(files) >= 3
        log = bench.check(open_log(tmp_path))
        assert log.frames["tick"][-1] == 1599 and bench.status("files_removed") > 0
        bench.check(open_log(files[-1]))  # any file alone
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == ["run4"]


def test_missing_file_in_the_middle_is_named(tmp_path):
    """A gap must not look like a robot that jumped."""
    bench = Bench(tmp_path, file_bytes=400_000, files=100, compression=0)
    for _ in range(20):
        bench.tick(100)
        bench.record()
    bench.recorder._finish("the loop has ended")
    files = recording_files.recorded_files(tmp_path)
    files[2].unlink()
    log = bench.check(open_log(tmp_path / "run"))
    assert "00000002.miplog is followed by 00000004.miplog: 1 files are missing" in log.damage
    gap = next(sentence for sentence in log.damage if sentence.startswith("ticks "))
    first, last = int(gap.split()[1]), int(gap.split()[3])
    assert len(log.frames) == 2000 - (last - first + 1)


def test_states_are_recorded(tmp_path):
    """Without them a replay could only start at the beginning of a run, which the ring of files forgets."""
    bench = Bench(tmp_path, state_bytes=24)
    for second in range(8):
        bench.tick(200)
        bench.ring.keep_state(bench.ticks - 1, (np.full(24, second, np.uint8),))
        bench.record()
    log = open_log(tmp_path / "run")
    assert log.states == {200 * (second + 1) - 1: bytes([second] * 24) for second in range(8)}
    (tmp_path / "a.ring").unlink()
    assert open_log(tmp_path).states == log.states and log.header["state_bytes"] == 24


def test_rows_that_the_ring_overwrote_are_counted(tmp_path):
    """A recorder that was stopped must not pretend that the log is whole."""
    bench = Bench(tmp_path, rows=400)
    bench.tick(300)
    bench.record()
    bench.tick(1000)
    bench.record(ended=True)
    log = bench.check(open_log(tmp_path / "run"))
    assert bench.status("dropped") + bench.status("recorded") == 1300 and bench.status("dropped") > 600
    assert len(log.frames) == bench.status("recorded") and log.recorder[-1]["dropped"] == bench.status("dropped")
    assert any("are missing" in sentence for sentence in log.damage)


def test_row_in_the_writing_is_not_recorded(tmp_path):
    """Half of one tick and half of another would be a measurement that never was."""
    bench = Bench(tmp_path)
    bench.tick(10)
    bench.ring.begin(4)
    bench.record(ended=True)
    assert list(open_log(tmp_path / "run").frames["tick"]) == [0, 1, 2, 3, 5, 6, 7, 8, 9] and bench.status("torn") == 1


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EROFS, errno.EIO])
@pytest.mark.parametrize("call", ["pwrite", "fdatasync", "open"])
def test_refusing_disk_loses_nothing_that_the_ring_still_has(tmp_path, monkeypatch, error, call):
    """A disk that is full for a while costs nothing; it is reported, and half a block does not stay in the file."""
    bench = Bench(tmp_path)
    if call != "open":
        bench.tick(100)
        bench.record()
    whole, left = getattr(os, call), [3]

    def refuse(target, *arguments, **options):
        if left[0] and (call != "open" or ".miplog" in str(target)):
            left[0] -= 1
            if call == "pwrite":
                whole(target, bytes(arguments[0][: len(arguments[0]) // 2]), *arguments[1:])  # half of it arrives
            raise OSError(error, "injected")
        return whole(target, *arguments, **options)

    monkeypatch.setattr(recorder_module.os if call == "open" else os, call, refuse)
    monkeypatch.setattr(recorder_module, "RETRY_S", 0.0)
    for _ in range(6):
        bench.tick(100)
        bench.record()
    bench.recorder._finish("the loop has ended")
    log = bench.check(open_log(tmp_path / "run"))
    assert bench.status("errors") == 3 and bench.status("errno") == error and log.end["errors"] == 3
    assert list(log.frames["tick"]) == list(range(bench.ticks)) and log.damage == []


@pytest.mark.slow
def test_disk_that_never_works_costs_a_run_nothing_and_is_reported(tmp_path):
    """A robot must balance without a disk; its recorder must neither spin nor pretend."""
    (tmp_path / "file").write_text("in the way of the folder")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = log_damage.dry_run(tmp_path, 10.0, tmp_path / "file" / "logs")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    recorder = report["recorder"]
    assert report["ticks"] == 2000 and recorder["recorded"] == 0 and recorder["dropped"] + recorder["backlog"] == 2000
    assert recorder["errors"] >= 2 and recorder["last_error"] == os.strerror(errno.ENOTDIR)
    assert after.ru_utime - before.ru_utime < 2.0
    assert len(open_log(report["log"]).frames) == 2000
    text = "\n".join(render_recorder(recorder))
    assert "2000 rows lost" in text and "writes refused" in text and recorder["last_error"] in text
