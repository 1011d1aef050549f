"""The recorder as a process of its own: light, unimportant, and neither its troubles nor its death are felt by the loop."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from helpers import make_config
from recorder_bench import SETTINGS

from mip_rt.lab import log_damage
from mip_rt.log import open as open_log
from mip_rt.log import recorder_process
from mip_rt.log.ring import Ring, header, remove_old_rings
from mip_rt.log.ring_format import Status
from mip_rt.robots.mbbr_frame import FRAME, LAYOUT


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


def test_settings_are_those_of_the_configuration(tmp_path):
    config = make_config(log__files="3", log__file_mb="2.5")
    found = recorder_process.settings(config.log, tmp_path, "run", 200.0)
    assert set(found) == set(SETTINGS) and found["files"] == 3 and found["file_bytes"] == 2_500_000


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


def test_loop_feels_no_allocation_and_little_time():
    """The budget: at most 2 microseconds a tick, nothing that stays allocated."""
    from mip_rt.lab import log_costs

    cost = log_costs.tick_cost(20_000)
    assert cost["bytes_grown"] < 256 and cost["us_per_tick"] < 2.0
