"""The session's side of the recorder: starts it, watches it between ticks, lets it finish. Nothing here waits while time is real."""

import os
import subprocess
import sys
import time
from pathlib import Path

import mip_rt

LOOK_EVERY = 200  # ticks between looks at the process
STALLED_S = 5.0  # no sign of life for so long: named in the status line
PATIENCE_S = 5.0  # on virtual time: longest wait for a recorder that makes no progress
FINISH_S = 8.0  # at the end; a recorder that needs longer goes on by itself


def settings(log, folder: Path, run_folder: str, rate_hz: float) -> dict:
    """What the recorder reads from the log's description.

    Args:
        log: section `log` of the configuration.
        folder: of the ring of files, and of the fault files.
        run_folder: name of this run's folder in it.
    """
    return {
        "folder": os.path.abspath(folder),
        "run_folder": run_folder,
        "files": log.files,
        "file_bytes": round(log.file_mb * 1e6),
        "flush_s": log.flush_s,
        "compression": log.compression,
        "fault_files": log.fault_files,
        "fault_before_s": log.fault_before_s,
        "fault_after_s": log.fault_after_s,
        "rate_hz": rate_hz,
    }


class RecorderProcess:
    """A recorder for this ring, or none.

    Args:
        ring: log.ring.Ring, whose description has `recording`, or nothing where no recorder is wanted.
        recording: those settings; None for no recorder.

    Attributes:
        process: the started process, None where there is none.
        died: it is gone although it should not be.
    """

    def __init__(self, ring, recording: dict | None):
        self._ring, self._recording = ring, recording
        self.process = None
        self.died = False
        self._patient = True

    @property
    def folder(self) -> Path | None:
        """Where this run's files are."""
        return Path(self._recording["folder"]) / self._recording["run_folder"] if self._recording else None

    def start(self) -> None:
        """Starts the process. Call before the loop becomes real-time: priorities and locked memory would be inherited."""
        if self._recording is None:
            return
        package = str(Path(mip_rt.__file__).parents[1])
        paths = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "mip_rt.log.recorder", str(self._ring.path)],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env={**os.environ, "PYTHONPATH": paths}, start_new_session=True,
            )  # fmt: skip
        except OSError:  # too little memory: recording is not needed to balance
            self.died = True

    def look(self) -> None:
        """Notices whether the process is gone; one system call."""
        if self.process is not None and not self.died:
            self.died = self.process.poll() is not None

    def wait_where_time_is_virtual(self) -> None:
        """Lets a recorder that is half a ring behind catch up; not for long where it makes no progress."""
        ring = self._ring
        if self.process is None or ring.committed() - ring.needed() < ring.capacity // 2 or not self._patient:
            return
        needed, since = ring.needed(), time.monotonic()
        while ring.committed() - ring.needed() >= ring.capacity // 4 and not self.died:
            time.sleep(0.002)
            self.look()
            if ring.needed() != needed:
                needed, since = ring.needed(), time.monotonic()
            elif time.monotonic() - since > PATIENCE_S:
                self._patient = False
                return

    def finish(self) -> None:
        """After the ring was closed: waits for the rest to be on disk, but not forever."""
        if self.process is None:
            return
        self.look()
        if self.died:
            return
        try:
            self.process.wait(FINISH_S)
        except subprocess.TimeoutExpired:
            pass
        self.died = not self._ring.recorder_status()["done"] and self.process.poll() is not None

    def trouble(self) -> str:
        """What the status line should say; empty where all is well."""
        if self.died:
            return "the recorder died"
        if self.process is None:
            return ""
        status = self._ring.recorder_status()
        words = []
        if status["heartbeat_ns"] and time.monotonic_ns() - status["heartbeat_ns"] > STALLED_S * 1e9:
            words.append("the recorder does not respond")
        if status["errors"] and status["backlog"] > 2 * LOOK_EVERY:
            words.append(f"the recorder cannot write: {os.strerror(status['errno'])}")
        if status["dropped"]:
            words.append(f"{status['dropped']} rows not recorded")
        if status["faults_refused"]:
            words.append("no room for more fault files: remove some")
        return ", ".join(words)

    def summary(self) -> dict | None:
        """For the run's summary; None where nothing was to be recorded.

        `recorded`, `dropped` and `backlog` are rows; a backlog after the end is what the recorder had not written when the summary was made.
        """
        if self._recording is None:
            return None
        status = self._ring.recorder_status()
        names = (
            "recorded", "dropped", "torn", "backlog_max", "bytes", "errors", "sync_max_ns", "files_removed", "faults_kept",
            "faults_refused", "faults_lost",
        )  # fmt: skip
        backlog = 0 if status["done"] else self._ring.committed() - status["recorded"] - status["dropped"]
        state = "finished" if status["done"] else "died" if self.died else "behind"
        last_error = os.strerror(status["errno"]) if status["errno"] else ""
        return {"folder": str(self.folder), "state": state, "backlog": backlog, **{name: status[name] for name in names}, "last_error": last_error}
