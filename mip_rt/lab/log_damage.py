"""What a log survives: processes killed at random moments, files cut anywhere, bits flipped anywhere. For `mip-rt bench log-damage` and the tests.

The dry runs here are deterministic (virtual clock) but paced to real time, so every row that a reader returns can be compared with the
same tick of an undisturbed run: a row that was never written shows.
"""

import os
import random
import shutil
import signal
import tempfile
import time
from pathlib import Path

import numpy as np

from mip_rt import config as configuration
from mip_rt import session as runner
from mip_rt.config import scenario as scenarios
from mip_rt.errors import LogError
from mip_rt.fake import bench as fake_bench
from mip_rt.log import open as open_log
from mip_rt.log.ring_format import Status
from mip_rt.log.ring_source import RingSource

VICTIMS = ("loop", "recorder", "both")
ONE_SECOND = 200  # rows


class Pace:
    """Takes the place of the status line and holds a run on virtual time to a rate."""

    def __init__(self, rate_hz: float):
        self._dt_s, self._next = 1.0 / rate_hz, None

    def update(self, session) -> None:
        """Waits for the next tick's moment."""
        now = time.monotonic()
        self._next = (self._next or now) + self._dt_s
        time.sleep(max(0.0, self._next - now))


def dry_run(folder: Path, duration_s: float, record, live=None, **overrides) -> dict:
    """Summary of a deterministic dry run in this process; `record`: folder of the recorder, or None."""
    changes = {name.replace("__", "."): value for name, value in overrides.items()}
    config = configuration.load(configuration.default_path("mbbr"), {"estimator.shadows": "[]", "log.ring_s": "20", **changes})
    bench = fake_bench.build(config, scenarios.load("hold"), 1, False)
    try:
        session = runner.Session(config, bench, folder, bench.remote.device, 1, "hold", record)
        return session.run(duration_s, runner.Stop(), live, False)
    finally:
        bench.close()


def in_child(folder: Path, duration_s: float, rate_hz: float) -> int:
    """The same paced in a forked process; its number. The recorder is a process of its own, started by that one."""
    child = os.fork()
    if child:
        return child
    try:
        os.setsid()
        dry_run(folder, duration_s, folder, Pace(rate_hz))
    finally:
        os._exit(0)


def alive(process: int) -> bool:
    """Neither gone nor a zombie."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_for(condition, limit_s: float = 30.0):
    """The condition's first true value."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.005)
    raise TimeoutError("the run did not get that far")


class Killing:
    """One paced run of which a process is killed after some time; `verdict` has what the log then held."""

    def __init__(self, victim: str, delay_s: float):
        self.victim, self.delay_s = victim, delay_s
        self.folder = Path(tempfile.mkdtemp(prefix="mip-rt-kill-"))
        self.child = in_child(self.folder, 20.0, 200.0)

    def strike(self) -> None:
        """Waits for the moment and kills."""
        ring = wait_for(lambda: next(self.folder.glob("*.ring"), None))
        self.source = wait_for(lambda: self._source(ring))
        self.recorder = wait_for(lambda: self.source.status()[Status.PROCESS])
        time.sleep(self.delay_s)
        if self.victim in ("recorder", "both"):
            os.kill(self.recorder, signal.SIGKILL)
        self.committed = self.source.committed()
        if self.victim in ("loop", "both"):
            os.kill(self.child, signal.SIGKILL)
            self.committed = self.source.committed()
        else:  # the loop must live on
            wait_for(lambda: self.source.committed() > self.committed + 20)
            os.kill(self.child, signal.SIGKILL)
        os.waitpid(self.child, 0)
        wait_for(lambda: not alive(self.recorder))

    @staticmethod
    def _source(ring: Path):
        try:
            return RingSource(ring)
        except (LogError, ValueError):  # not whole yet
            return None

    def verdict(self, reference) -> dict:
        """Reads everything that is left.

        Args:
            reference: (n,) rows of the undisturbed run, by tick.

        Returns:
            rows lost at the end by a reader of the recorded files alone, rows that were never written, rows that the ring lost.
        """
        run = next((path for path in self.folder.iterdir() if path.is_dir()), None)
        ring = open_log(next(self.folder.glob("*.ring")))
        logs = [ring, open_log(self.folder)]
        recorded = None
        if run is not None and any(run.iterdir()):
            recorded = open_log(run)
            logs += [recorded, *map(open_log, run.iterdir())]
        logs += map(open_log, self.folder.glob("fault-*.miplog"))
        kept = len(recorded.frames) if recorded is not None else 0
        result = {
            "victim": self.victim,
            "committed": int(self.committed),
            "lost": int(self.committed) - kept,
            "invented": sum(invented(log.frames, reference) for log in logs),
            "ring_lost": max(0, int(self.committed) - len(ring.frames)),
        }
        shutil.rmtree(self.folder)
        return result


def invented(frames, reference) -> int:
    """How many of the frames are not exactly the reference's row of the same tick."""
    if not len(frames):
        return 0
    known = frames["tick"] < len(reference)
    ours, theirs = (np.ascontiguousarray(rows).view(np.uint8).reshape(-1, frames.itemsize)
                    for rows in (frames[known], reference[frames["tick"][known]]))  # fmt: skip
    return int((~known).sum()) + int((ours != theirs).any(axis=1).sum())


def kill(count: int, seed: int, together: int = 4, progress=lambda done, total: None) -> list[dict]:
    """Verdicts of `count` runs, some at the same time; victims take turns, moments are random."""
    source = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        reference = open_log(dry_run(Path(folder), 20.0, None)["log"]).frames
    verdicts = []
    for begin in range(0, count, together):
        killings = [Killing(VICTIMS[i % 3], source.uniform(0.0, 2.5)) for i in range(begin, min(count, begin + together))]
        for killing in sorted(killings, key=lambda k: k.delay_s):
            killing.strike()
        verdicts += [killing.verdict(reference) for killing in killings]
        progress(len(verdicts), count)
    return verdicts


def sample(folder: Path, duration_s: float) -> tuple[Path, Path]:
    """(ring, recorded file) of an undisturbed run."""
    report = dry_run(folder, duration_s, folder)
    (recorded,) = Path(report["recorder"]["folder"]).iterdir()
    (ring,) = folder.glob("*.ring")
    return ring, recorded


def cut(path: Path, count: int, seed: int, progress=lambda done, total: None) -> dict:
    """Reads a copy that was cut at `count` random lengths.

    Returns:
        raised: times that the reader raised; invented: rows that were never written; worst: most rows lost before the cut.
    """
    source, reference = random.Random(seed), open_log(path).frames
    copy = path.with_name("cut" + path.suffix)
    shutil.copyfile(path, copy)
    size = path.stat().st_size
    result = {"count": count, "raised": 0, "invented": 0, "worst": 0}
    ends = row_ends(path, reference)
    for done, length in enumerate(sorted((source.randrange(1, size) for _ in range(count)), reverse=True)):
        os.truncate(copy, length)
        try:
            frames = open_log(copy).frames
        except LogError:
            result["raised"] += 1
            continue
        result["invented"] += invented(frames, reference)
        result["worst"] = max(result["worst"], int((ends <= length).sum()) - len(frames))
        progress(done + 1, count)
    copy.unlink()
    return result


def row_ends(path: Path, frames):
    """(n,) the byte of the file at which each row ends at the latest, if rows lay evenly in it; of a ring, exactly."""
    if path.suffix == ".ring":
        geometry = RingSource(path).geometry
        return geometry.rows_at + (frames["tick"] % geometry.rows + 1) * geometry.row_bytes
    from mip_rt.log import block_format

    ends = [np.full(block.rows, block.end) for block in block_format.blocks(path.read_bytes()) if block.kind == block_format.Kind.ROWS]
    return np.concatenate(ends)


def flip(path: Path, count: int, seed: int, progress=lambda done, total: None) -> dict:
    """Reads a copy in which one bit differs, `count` times. Returns as `cut`; worst: most rows lost by one bit."""
    source, reference = random.Random(seed), open_log(path).frames
    copy = path.with_name("flipped" + path.suffix)
    shutil.copyfile(path, copy)
    size = path.stat().st_size
    result = {"count": count, "raised": 0, "invented": 0, "worst": 0}
    with copy.open("r+b", buffering=0) as file:
        for done in range(count):
            at, bit = source.randrange(size), 1 << source.randrange(8)
            (byte,) = os.pread(file.fileno(), 1, at)
            os.pwrite(file.fileno(), bytes([byte ^ bit]), at)
            try:
                frames = open_log(copy).frames
                result["invented"] += invented(frames, reference)
                result["worst"] = max(result["worst"], len(reference) - len(frames))
            except LogError:
                result["raised"] += 1
            os.pwrite(file.fileno(), bytes([byte]), at)
            progress(done + 1, count)
    copy.unlink()
    return result


def report(quick: bool, progress) -> dict:
    """For `mip-rt bench log-damage`: 200 kills, 2,000 cuts and flips of a ring and of a recorded file; a twentieth where quick."""
    kills, times = (10, 100) if quick else (200, 2000)

    def told(what):
        return lambda done, total: progress(done, total, what)

    verdicts = kill(kills, 1, progress=told("kill -9"))
    found = {
        "kills": {
            victim: {
                "count": len(chosen := [verdict for verdict in verdicts if verdict["victim"] == victim]),
                "rows_lost_at_most": max(verdict["lost"] for verdict in chosen),
                "rows_lost_in_ring": max(verdict["ring_lost"] for verdict in chosen),
                "invented": sum(verdict["invented"] for verdict in chosen),
            }
            for victim in VICTIMS
        }
    }
    with tempfile.TemporaryDirectory() as folder:
        for path in sample(Path(folder), 5.0):
            name = "ring" if path.suffix == ".ring" else "recorded file"
            found[f"{name} cut"] = cut(path, times, 2, told(f"{name} cut"))
            found[f"{name} flipped"] = flip(path, times, 3, told(f"{name} flipped"))
    return found


def passed(found: dict) -> bool:
    """Nothing raised, nothing was invented, at most a second is lost."""
    kills = found["kills"].values()
    rest = [value for key, value in found.items() if key != "kills"]
    return (
        all(k["rows_lost_at_most"] <= ONE_SECOND and not k["rows_lost_in_ring"] and not k["invented"] for k in kills)
        and not found["kills"]["loop"]["rows_lost_at_most"]
        and all(r["worst"] <= ONE_SECOND and not r["raised"] and not r["invented"] for r in rest)
    )


def render(found: dict) -> None:
    """Markdown."""
    print("| kill -9 of | times | rows missing at the end of the recorded files, at most | in the ring | rows never written |")
    print("|---|---|---|---|---|")
    for victim, row in found["kills"].items():
        print(f"| {victim} | {row['count']} | {row['rows_lost_at_most']} | {row['rows_lost_in_ring']} | {row['invented']} |")
    print("\n| damage | times | reader raised | intact rows lost at most | rows never written |")
    print("|---|---|---|---|---|")
    for what, row in found.items():
        if what != "kills":
            print(f"| {what} | {row['count']} | {row['raised']} | {row['worst']} | {row['invented']} |")
