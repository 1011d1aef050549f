"""What led to a fault is kept aside: complete, bounded, never overwritten, and refused or lost files are counted."""

import errno
import os
import time

from helpers import make_config
from recorder_bench import Bench

from mip_rt.config.scenario import Event, Scenario
from mip_rt.log import open as open_log
from mip_rt.log import recorder as recorder_module


def fall():
    """A run that is armed, balances, and is then pushed over."""
    return Scenario("fall", "", 20.0, [Event(at_s=2.0, press="arm")])


def test_program_that_stops_before_its_first_tick_keeps_no_fault_file(tmp_path):
    """Refused starts must not use up the places of real faults."""
    bench = Bench(tmp_path)
    file = recorder_module.FaultFile(bench.recorder, 0, 0, "loop-died")
    assert not file.advance(time.monotonic(), True) and not list(tmp_path.glob("fault-*"))


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
