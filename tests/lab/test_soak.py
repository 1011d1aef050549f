"""`mip-rt soak` as a user runs it, and the door through which batches go."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mip_rt.lab import batch, soak
from mip_rt.log import open as open_log

ROOT = Path(__file__).parents[2]


def mip_rt(*arguments):
    return subprocess.run([sys.executable, "-m", "mip_rt", *map(str, arguments)], capture_output=True, text=True, cwd=ROOT, timeout=600, check=False)


def test_a_campaign_keeps_all_promises_and_counts(tmp_path):
    result = mip_rt("soak", "--hours", 0.1, "--seed", 40, "--json", "--out", tmp_path)
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout)
    assert report["runs"] == 2 and report["seeds"] == [40, 41] and report["simulated_hours"] > 0.1
    assert report["injected"] == sum(row["injected"] for row in report["faults"].values()) > 40
    assert report["broken"] == [] and report["false_alarms"] == []


def test_the_list_names_every_fault():
    from mip_rt.fake.faults import FAULTS

    result = mip_rt("soak", "--list")
    assert result.returncode == 0 and all(f"`{name}`" in result.stdout for name in FAULTS)


def test_an_unknown_fault_is_refused_with_the_nearest_name():
    result = mip_rt("soak", "--fault", "imu_frozn")
    assert result.returncode == 2 and "did you mean 'imu_frozen'" in result.stderr


def test_a_kept_run_replays_with_the_same_log(tmp_path):
    """What is kept of a broken run must show the same run, whole."""
    job = soak.Job(3, 30.0, ("i2c_bit_flips", "encoder_jump"))
    command, log = soak.keep(job, tmp_path)
    first = open_log(log).frames
    again = mip_rt(*command.split()[1:])
    assert again.returncode in (0, 1), again.stderr
    assert open_log(log).frames.tobytes() == first.tobytes() and len(first) > 5800
    seen, _ = soak.soak_run.observe(job.configured(), job.script(), 3, 30.0)
    assert (seen.rows["duty"] == first["duty"]).all() and (seen.rows["state"] == first["state"]).all()


def double(value):
    """A job."""
    return 2 * value


def refuse(value):
    """A job that fails."""
    if value == 3:
        raise ValueError("three")
    return value


def test_a_batch_does_every_job_once_and_in_order():
    assert batch.results(double, range(23), workers=2) == [2 * value for value in range(23)]


def test_a_batch_stops_with_its_listener_and_passes_errors_on():
    for job, result in batch.completed(double, range(10_000), workers=1):
        assert result == 2 * job
        break
    with pytest.raises(ValueError, match="three"):
        batch.results(refuse, range(5), workers=1)


def test_workers_end_with_a_killed_parent():
    """A campaign that is killed must not leave its workers behind."""
    program = "import time; from mip_rt.lab import batch; list(batch.completed(time.sleep, [600, 600], workers=2))"
    parent = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT)
    children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children")

    def workers():
        return [pid for pid in children.read_text().split() if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]

    def within(seconds, predicate):
        end = time.monotonic() + seconds
        while not predicate() and time.monotonic() < end:
            time.sleep(0.1)
        return predicate()

    assert within(60.0, lambda: len(workers()) == 2)
    started = workers()
    time.sleep(3.0)  # they have come to their work
    parent.kill()
    parent.wait()
    assert within(30.0, lambda: not any(Path(f"/proc/{pid}").exists() for pid in started))


@pytest.mark.slow
def test_a_silent_cluster_is_refused():
    pytest.importorskip("distributed")
    from mip_rt.errors import ConfigError

    with pytest.raises(ConfigError, match="no Dask scheduler"):
        batch.results(double, [1], cluster="tcp://127.0.0.1:1")


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_results():
    """The other executor behind the door: two workers, the same runs."""
    distributed = pytest.importorskip("distributed")
    jobs = [soak.Job(seed, 30.0, ("imu_silent", "serial_split")) for seed in range(1, 5)]
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        found = batch.results(soak.work, jobs, cluster=cluster.scheduler_address)
    here = [soak.work(job) for job in jobs]
    assert [result["reactions"] for result in found] == [result["reactions"] for result in here]
    assert [result["broken"] for result in found] == [[]] * 4
