"""The recorder: complete, bounded, undisturbing; a fault is kept aside; troubles of the disk are counted, not felt."""

import errno
import os
import resource
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from helpers import make_config

from mip_rt.config.scenario import Event, Scenario
from mip_rt.lab import log_damage
from mip_rt.log import open as open_log
from mip_rt.log import recorder as recorder_module
from mip_rt.log import recorder_process, recording_files
from mip_rt.log.ring import Ring, header, remove_old_rings
from mip_rt.log.ring_format import Status
from mip_rt.robots.mbbr_frame import FRAME, LAYOUT
from mip_rt.summary import render_recorder

SETTINGS = {
    "folder": "", "run_folder": "run", "files": 4, "file_bytes": 500_000, "flush_s": 0.0, "compression": 1, "fault_files": 2,
    "fault_before_s": 1.0, "fault_after_s": 0.5, "rate_hz": 200.0,
}  # fmt: skip


class Bench:
    """A ring with random rows and a recorder in this process, moved by hand."""

    def __init__(self, folder, rows=1000, state_bytes=0, **settings):
        description = {"recording": {**SETTINGS, "folder": str(folder), **settings}, "codes": {"fault": {"4": "tipped"}}}
        self.folder = folder
        self.ring = Ring(folder / "a.ring", FRAME, rows, header(LAYOUT, "robot: mbbr\n", description), state_bytes)
        self.recorder = recorder_module.Recorder(self.ring.path)
        self.random = np.random.default_rng(1)
        self.ticks = 0
        self.written = []

    def tick(self, count):
        for _ in range(count):
            index = self.ticks % self.ring.capacity
            self.ring.begin(index)
            self.ring.rows["duty"][index] = self.random.normal(size=3)
            self.ring.rows["tick"][index] = self.ticks
            self.ring.commit(index, self.ticks)
            self.written.append(self.ring.rows[index].tobytes())
            self.ticks += 1

    def record(self, ended=False):
        self.recorder._drain(time.monotonic(), ended)
        self.recorder._publish()

    def status(self, name):
        return self.recorder.status[Status[name.upper()]]

    def check(self, log):
        """Every frame of the log is exactly what was written."""
        assert [row.tobytes() for row in log.frames] == [self.written[tick] for tick in log.frames["tick"]]
        return log


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


def test_program_that_stops_before_its_first_tick_keeps_no_fault_file(tmp_path):
    """Refused starts must not use up the places of real faults."""
    bench = Bench(tmp_path)
    file = recorder_module.FaultFile(bench.recorder, 0, 0, "loop-died")
    assert not file.advance(time.monotonic(), True) and not list(tmp_path.glob("fault-*"))


def fall():
    """A run that is armed, balances, and is then pushed over."""
    return Scenario("fall", "", 20.0, [Event(at_s=2.0, press="arm")])


def test_fault_is_kept_aside_with_what_led_to_it(tmp_path):
    """The last moments before a fall are what the user needs; they must survive the ring of files, complete and readable alone."""
    config = make_config(estimator__shadows="[]", log__fault_before_s="3", log__fault_after_s="1", log__ring_s="20")
    from mip_rt import session as runner
    from mip_rt.fake import bench as fake_bench

    bench = fake_bench.build(config, fall(), 1, False)
    session = runner.Session(config, bench, tmp_path, bench.remote.device, 1, "fall", tmp_path)

    class Push:
        def update(self, session):
            if session.loop.ticks == 1500:
                bench.world.state[0].x[0] = 1.0

    try:
        report = session.run(12.0, runner.Stop(), Push(), False)
    finally:
        bench.close()
    assert report["faults"] == ["tipped"] and report["recorder"]["faults_kept"] == 1
    (file,) = tmp_path.glob("fault-*.miplog")
    assert "-tipped-" in file.name
    log = open_log(file)
    entered = open_log(report["log"]).frames
    first = int(entered["tick"][entered["state"] == 5][0])
    assert log.damage == [] and list(log.frames["tick"]) == list(range(first - 600, first + 200))
    assert log.frames.tobytes() == entered[first - 600 : first + 200].tobytes()
    assert log.end["reason"] == "fault tipped" and log.end["fault"] == 4 and log.end["tick"] == first


def test_fault_files_are_bounded_and_never_overwritten(tmp_path):
    """A robot that falls all day keeps its first falls; what is refused is counted."""
    bench = Bench(tmp_path)

    def fault():
        bench.ring.report_fault(4, bench.ticks)
        file = recorder_module.FaultFile(bench.recorder, 4, bench.ticks, "tipped")
        bench.tick(100)
        while file.advance(time.monotonic(), False):
            pass

    for _ in range(2):
        bench.tick(300)
        fault()
    before = {path: path.read_bytes() for path in tmp_path.glob("fault-*")}
    for _ in range(3):
        fault()
    assert {path: path.read_bytes() for path in tmp_path.glob("fault-*")} == before and len(before) == 2
    assert bench.status("faults_kept") == 2 and bench.status("faults_refused") == 3
    next(iter(before)).unlink()
    fault()
    assert bench.status("faults_kept") == 3
    for path in tmp_path.glob("fault-*"):
        bench.check(open_log(path))


def test_fault_file_on_a_full_disk_is_tried_again_and_then_counted_as_lost(tmp_path, monkeypatch):
    """Half a fault file that looks whole would mislead."""
    bench = Bench(tmp_path, rows=500)
    bench.tick(300)
    file = recorder_module.FaultFile(bench.recorder, 4, bench.ticks, "tipped")
    bench.tick(100)

    def full(*_):
        raise OSError(errno.ENOSPC, "injected")

    monkeypatch.setattr(os, "pwrite", full)
    now = time.monotonic()
    assert file.advance(now, False) and bench.status("errors") == 1 and not bench.status("faults_lost")
    assert not list(tmp_path.glob("fault-*"))
    bench.tick(500)
    assert not file.advance(now + 2.0, None) and bench.status("faults_lost") == 1 and not list(tmp_path.glob("fault-*"))


@pytest.mark.slow
def test_stopped_recorder_is_not_felt_and_its_drops_are_counted(tmp_path):
    """The loop must never wait for the disk: it runs on with a recorder that does nothing, in real time."""
    config = make_config(estimator__shadows="[]", log__ring_s="1")
    from mip_rt import session as runner
    from mip_rt.config import scenario as scenarios
    from mip_rt.fake import bench as fake_bench

    bench = fake_bench.build(config, scenarios.load("hold"), 1, True)
    session = runner.Session(config, bench, tmp_path, bench.remote.device, 1, "hold", tmp_path)
    told = []

    class Watch:
        def update(self, session):
            if session.loop.ticks == 300:
                session.recorder.process.send_signal(signal.SIGSTOP)
            elif session.loop.ticks == 900:
                session.recorder.process.send_signal(signal.SIGCONT)
            elif session.loop.ticks == 1000:
                told.append(session.recorder.trouble())

    try:
        report = session.run(6.0, runner.Stop(), Watch(), True)
    finally:
        bench.close()
    recorder = report["recorder"]
    assert report["ticks"] + report["missed"] >= 1190
    assert 300 < recorder["dropped"] < 700 and recorder["recorded"] + recorder["dropped"] == report["ticks"]
    assert "rows not recorded" in told[0]
    log = open_log(recorder["folder"])
    assert len(log.frames) == recorder["recorded"] and any("are missing" in sentence for sentence in log.damage)


def test_death_of_the_recorder_is_noticed_and_the_run_goes_on(tmp_path):
    """The loop survives its recorder; the summary and the status line say what happened, and the ring still has the run."""

    class Kill:
        def update(self, session):
            if session.loop.ticks == 700:
                log_damage.wait_for(lambda: any(path.stat().st_size for path in tmp_path.rglob("*.miplog")))
                session.recorder.process.kill()
                session.recorder.process.wait()
            elif session.loop.ticks == 1001:
                assert session.recorder.trouble() == "the recorder died"

    report = log_damage.dry_run(tmp_path, 10.0, tmp_path, Kill())
    assert report["recorder"]["state"] == "died" and report["ticks"] == 2000 and report["recorder"]["backlog"] > 0
    log = open_log(report["log"])
    assert len(log.frames) == 2000 and log.damage == []
    joined = open_log(tmp_path)
    assert any("cut off" in sentence for sentence in joined.damage), joined.damage
    same = joined.frames.tobytes() == log.frames.tobytes()
    assert same


def test_killed_loop_is_recorded_to_its_last_row_and_kept_aside(tmp_path):
    """A crash of the program is a fault as well: its last seconds are kept."""
    child = log_damage.in_child(tmp_path, 20.0, 400.0)
    ring = log_damage.wait_for(lambda: next(tmp_path.glob("*.ring"), None))
    source = log_damage.wait_for(lambda: log_damage.Killing._source(ring))
    log_damage.wait_for(lambda: source.committed() > 200)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    log_damage.wait_for(lambda: source.status()[Status.DONE])
    recorded = open_log(next(path for path in tmp_path.iterdir() if path.is_dir()))
    assert len(recorded.frames) == source.committed() and recorded.end["reason"] == "the loop's process died" and recorded.damage == []
    (file,) = tmp_path.glob("fault-*-loop-died-*.miplog")
    assert open_log(file).frames.tobytes() == recorded.frames.tobytes()


def test_recorder_starts_light(tmp_path):
    """On the BeagleBone numpy and numba cost seconds and tens of megabytes; the recorder must not need them."""
    import sys

    code = "import sys, mip_rt.log.recorder; print([m for m in ('numpy', 'numba', 'yaml', 'ctypes') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parents[2], check=True)
    assert result.stdout.strip() == "[]"


def test_recorder_is_unimportant(tmp_path):
    """It inherits real-time scheduling where the service has it, and would then compete with the loop."""
    code = "import os; from mip_rt.log.recorder import be_unimportant; be_unimportant(); print(os.sched_getscheduler(0), os.nice(0))"
    import sys

    start = [sys.executable, "-c", code]
    if os.geteuid() == 0:
        start = ["chrt", "-f", "10", *start]
    result = subprocess.run(start, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=True)
    policy, nice = map(int, result.stdout.split())
    assert policy == os.SCHED_OTHER and nice >= 10


def test_old_rings_of_dead_processes_make_room(tmp_path):
    """Rings are in memory on the robot: after a few crashes there would be none left."""
    for number in range(4):
        ring = Ring(tmp_path / f"mip-rt-{number}.ring", FRAME, 16, header(LAYOUT, ""))
        if number != 1:
            ring._counter[3] = 2**31 - 5  # no such process
        os.utime(ring.path, (number, number))
    (tmp_path / "mip-rt-x.ring").write_bytes(b"not ours")
    remove_old_rings(tmp_path, "mip-rt-*.ring")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mip-rt-1.ring", "mip-rt-3.ring", "mip-rt-x.ring"]


def test_settings_are_those_of_the_configuration(tmp_path):
    config = make_config(log__files="3", log__file_mb="2.5")
    found = recorder_process.settings(config.log, tmp_path, "run", 200.0)
    assert set(found) == set(SETTINGS) and found["files"] == 3 and found["file_bytes"] == 2_500_000


def test_loop_feels_no_allocation_and_little_time():
    """The budget: at most 2 microseconds a tick, nothing that stays allocated."""
    from mip_rt.lab import log_costs

    cost = log_costs.tick_cost(20_000)
    assert cost["bytes_grown"] < 256 and cost["us_per_tick"] < 2.0
