"""The one door through which the lab's batches go: a function, its jobs, and an executor of the concurrent.futures interface.

By default that is a pool of processes on this machine's processors; with the address of a Dask scheduler it is that cluster. Give Dask
workers one thread each: a dry run stops the garbage collector of its process.
"""

import concurrent.futures
import contextlib
import ctypes
import multiprocessing
import os
import signal
import time

from mip_rt.errors import ConfigError
from mip_rt.progress import progress

PR_SET_PDEATHSIG = 1  # linux/prctl.h
AHEAD = 2  # jobs handed out per worker: enough to keep it busy, few to wait for when the batch stops early


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for ever."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


@contextlib.contextmanager
def executor(cluster: str | None = None, workers: int | None = None):
    """(executor, number of workers).

    Args:
        cluster: address of a Dask scheduler, such as tcp://host:8786; None for processes on this machine.
        workers: processes; None for one a processor.

    Raises:
        ConfigError: dask.distributed is not installed, or the scheduler does not answer.
    """
    if cluster is None:
        count = workers or len(os.sched_getaffinity(0))
        with concurrent.futures.ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _end_with_parent) as pool:
            try:
                yield pool, count
            finally:
                # Before Python 3.11.5 a pool hangs at its end when only cancelled jobs are left in it (CPython issue 94777).
                pool.shutdown(cancel_futures=True)
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError("--cluster needs dask.distributed.", "Install it: pip install 'mip-rt[cluster]'", "cluster_missing") from error
    try:
        client = Client(cluster, timeout="10s")
    except (OSError, ValueError) as error:
        raise ConfigError(f"no Dask scheduler answers at {cluster}: {error}.", "Start one: dask scheduler", "cluster_silent") from error
    with client:
        yield client.get_executor(pure=False, retries=0), max(1, len(client.nthreads()))


def completed(work, jobs, label: str = "", cluster: str | None = None, workers: int | None = None):
    """Yields (job, work(job)) in the order of completion, with a progress bar; whoever stops listening stops the batch.

    Args:
        work: a module's function of one argument.
        jobs: a sequence.

    Raises:
        whatever `work` raises.
    """
    jobs = list(jobs)
    waiting = iter(jobs)
    with executor(cluster, workers) as (pool, count):
        running = {}

        def hand_out(number):
            for _, job in zip(range(number), waiting):
                running[pool.submit(work, job)] = job

        done_count, begin = 0, time.monotonic()
        try:
            progress(0, len(jobs), label)
            hand_out(AHEAD * count)
            while running:
                done, _ = concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED)
                for future in done:
                    job = running.pop(future)
                    result = future.result()
                    done_count += 1
                    left_s = (time.monotonic() - begin) * (len(jobs) - done_count) / done_count
                    progress(done_count, len(jobs), f"{label}, {left_s // 60:.0f}:{left_s % 60:02.0f} left")
                    hand_out(1)
                    yield job, result
        finally:
            for future in running:
                future.cancel()


def results(work, jobs, label: str = "", cluster: str | None = None, workers: int | None = None) -> list:
    """All results, in the order of the jobs."""
    numbered = list(enumerate(jobs))
    found = {index: result for (index, _), result in completed(_Numbered(work), numbered, label, cluster, workers)}
    return [found[index] for index, _ in numbered]


class _Numbered:
    """`work` on the second part of a (number, job) pair."""

    def __init__(self, work):
        self.work = work

    def __call__(self, job):
        return self.work(job[1])


def add_arguments(parser) -> None:
    """Declares --workers and --cluster."""
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one a processor)")
    parser.add_argument("--cluster", metavar="ADDRESS", help="run on a Dask cluster instead, for example tcp://host:8786")
