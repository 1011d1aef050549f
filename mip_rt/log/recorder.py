"""The recorder: a process of low priority that brings the ring to disk. Started by the session with the ring's path; needs no numpy.

It polls the ring, so the loop never waits for it and never tells it anything. A disk that is full, read-only or slow only makes the
backlog grow; rows that the ring had to overwrite meanwhile are counted. When the loop has ended or died it writes what is left and
ends. Everything it knows stands in the ring's status page and, twice a second, in the log itself.
"""

import contextlib
import os
import signal
import sys
import time
from pathlib import Path

from mip_rt.log import block_format
from mip_rt.log.block_format import Kind
from mip_rt.log.fault_file import FaultFile
from mip_rt.log.recording_files import AppendFile, make_room, number_of, recorded_files
from mip_rt.log.ring_format import Counter, Status
from mip_rt.log.ring_source import RingSource

POLL_S, BUSY_POLL_S = 0.05, 0.005  # between looks at the ring; where a block has come since the last one
BLOCK_ROWS = 200  # most rows in a block: 1 s; fewer where the ring is small
BLOCKS_AT_ONCE = 10  # after a backlog, before it looks at anything else
RETRY_S = 1.0  # after the disk refused
GIVE_UP_S = 5.0  # the loop has ended and the disk still refuses
HEADER_AT, HEADER_EVERY = (0, 2), 64  # blocks of a file before which the header stands: early twice, then now and then
MOMENTARY = (Status.PROCESS, Status.HEARTBEAT_NS, Status.NEEDED, Status.DONE)  # not worth a place in the log
MARGIN = 20  # rows to leave to the loop after an overrun


class Recorder:
    """Drains one ring into the ring of files; the settings are the description's `recording`.

    Args:
        ring: path of the ring's file.
    """

    def __init__(self, ring: Path):
        self.source = RingSource(ring)
        self.settings = self.source.description["recording"]
        self.folder = Path(self.settings["folder"])
        self.status = [0] * len(Status)
        self.status[Status.PROCESS] = os.getpid()
        self.position = 0  # next tick to read
        self._block_rows = max(1, min(BLOCK_ROWS, self.source.rows // 8))
        self._file = None
        self._pending = []  # blocks that the disk has not taken yet
        self._sequence = self._blocks_in_file = self._next_state = self._faults_seen = 0
        self._fault_files = []
        self._next_flush = self._retry_at = time.monotonic()
        self._unsynced = False

    def run(self) -> None:
        """Until the loop has ended and everything is written, or the disk refuses for too long after that."""
        writer, ended_at = self.source.counters()[Counter.WRITER], None
        while True:
            counters, before = self.source.counters(), self.position
            ended = bool(counters[Counter.FINISHED]) or os.getppid() != writer
            now = time.monotonic()
            if ended and ended_at is None:
                ended_at = now
                if not counters[Counter.FINISHED]:
                    self._fault_files.append(FaultFile(self, 0, self.source.committed(), "loop-died"))
            if counters[Counter.FAULTS] > self._faults_seen:
                self._faults_seen = counters[Counter.FAULTS]
                code = self.source.description.get("codes", {}).get("fault", {}).get(str(counters[Counter.FAULT]), "unknown")
                self._fault_files.append(FaultFile(self, counters[Counter.FAULT], counters[Counter.FAULT_TICK], code))
            self._drain(now, ended)
            self._fault_files = [file for file in self._fault_files if file.advance(now, ended)]
            idle = self.position >= self.source.committed() and not self._pending and not self._fault_files
            if ended and (idle or now - ended_at > GIVE_UP_S):
                break
            self._publish()
            moved = self.position - before
            if moved < BLOCKS_AT_ONCE * self._block_rows:
                time.sleep(BUSY_POLL_S if moved >= self._block_rows or self._fault_files else POLL_S)
        self._finish("the loop has ended" if counters[Counter.FINISHED] else "the loop's process died")

    def _drain(self, now: float, ended: bool) -> None:
        """Reads, packs and writes what is due; a refused write is tried again later, while the ring holds what comes."""
        if now < self._retry_at:
            return
        try:
            self._write_pending()
            for _ in range(BLOCKS_AT_ONCE):
                if self.source.committed() - self.position < self._block_rows:
                    break
                self._read_block()
                self._write_pending()
                self._publish()
            if now >= self._next_flush or ended:
                self._next_flush = now + self.settings["flush_s"]
                self._read_block()
                self._read_states()
                if self._pending or self._unsynced:
                    self._pack_json(Kind.STATUS, self.report())
                self._write_pending()
                self._sync()
        except OSError as error:
            self.refused(error)
            self._retry_at = now + RETRY_S

    def _read_block(self) -> None:
        first, oldest = self.position, self.source.oldest()
        if first < oldest:
            first = min(oldest + MARGIN, self.source.committed())
            self.status[Status.DROPPED] += first - self.position
        last = min(first + self._block_rows, self.source.committed())
        payload, whole, self.position = self.source.take(first, last) if last > first else (b"", 0, first)
        self.status[Status.TORN] += self.position - first - whole
        if whole:
            self._pending.append(self.pack(Kind.ROWS, payload, first, whole))

    def _read_states(self) -> None:
        for number, tick, payload in self.source.states(self._next_state):
            self._pending.append(self.pack(Kind.STATE, payload, tick))
            self._next_state = number + 1
            self.status[Status.STATES] += 1

    def pack(self, kind: Kind, payload: bytes, first: int = 0, rows: int = 0) -> tuple[int, bytes]:
        """(rows, block) with the next sequence number."""
        self._sequence += 1
        return rows, block_format.pack(kind, payload, self._sequence - 1, self.settings["compression"], first, rows)

    def _pack_json(self, kind: Kind, content: dict) -> None:
        self._sequence += 1
        self._pending.append((0, block_format.pack_json(kind, content, self._sequence - 1)))

    def _write_pending(self) -> None:
        while self._pending:
            rows, block = self._pending[0]
            self._make_file(len(block))
            self._append(block)
            self.status[Status.RECORDED] += rows
            del self._pending[0]

    def _append(self, block: bytes) -> None:
        self._file.append(block)
        self._unsynced = True
        self._blocks_in_file += 1
        self.status[Status.BLOCKS] += 1
        self.status[Status.BYTES] += len(block)

    def _make_file(self, size: int) -> None:
        """A file with room for a block of this size, with a header not far away."""
        if self._file is not None and self._file.size + size > self.settings["file_bytes"]:
            self._close_file("continues in the next file")
        if self._file is None:
            limit = self.settings["files"] * self.settings["file_bytes"]
            self.status[Status.FILES_REMOVED] += make_room(self.folder, limit, self.settings["file_bytes"])
            files = recorded_files(self.folder)
            number = number_of(files[-1]) + 1 if files else 1
            self._file = AppendFile(self.folder / self.settings["run_folder"] / f"{number:08d}{block_format.SUFFIX}")
            self._blocks_in_file = 0
        if self._blocks_in_file in HEADER_AT or self._blocks_in_file % HEADER_EVERY == 0:
            self._append(self.header())

    def header(self) -> bytes:
        """A HEADER block; it has no place in the sequence, because it says nothing new."""
        return block_format.pack_json(Kind.HEADER, self.source.description, 0)

    def _sync(self) -> None:
        if self._file is None or not self._unsynced:
            return
        begin = time.monotonic_ns()
        self._file.sync()
        self._unsynced = False
        self.status[Status.SYNC_MAX_NS] = max(self.status[Status.SYNC_MAX_NS], time.monotonic_ns() - begin)

    def _close_file(self, reason: str) -> None:
        file, self._file = self._file, None
        try:
            file.append(block_format.pack_json(Kind.END, {"reason": reason, **self.report()}, self._sequence))
            file.sync()
        finally:
            self._unsynced = False
            file.close()

    def refused(self, error: OSError) -> None:
        """Counts a write that the disk refused."""
        self.status[Status.ERRORS] += 1
        self.status[Status.ERRNO] = error.errno or 0

    def report(self) -> dict:
        """Counters and clocks, as they stand in STATUS and END blocks."""
        self._measure_backlog()
        counters = {name.lower(): self.status[number] for name, number in Status.__members__.items() if number not in MOMENTARY}
        return {"monotonic_ns": time.monotonic_ns(), "realtime_ns": time.time_ns(), **counters}

    def _measure_backlog(self) -> int:
        status = self.status
        status[Status.BACKLOG] = self.source.committed() - self.position + sum(rows for rows, _ in self._pending)
        status[Status.BACKLOG_MAX] = max(status[Status.BACKLOG_MAX], status[Status.BACKLOG])
        return status[Status.BACKLOG]

    def _publish(self) -> None:
        status = self.status
        self._measure_backlog()
        status[Status.NEEDED] = min([self.position, *(file.needed for file in self._fault_files)])
        status[Status.HEARTBEAT_NS] = time.monotonic_ns()
        self.source.publish(status)

    def _finish(self, reason: str) -> None:
        self.status[Status.DROPPED] += self._measure_backlog()
        for file in self._fault_files:
            file.abandon()
            self.status[Status.FAULTS_LOST] += 1
        self._pending, self.position = [], self.source.committed()
        try:
            if self._file is not None:
                self._close_file(reason)
        except OSError as error:
            self.refused(error)
        self.status[Status.DONE] = 1
        self._publish()


def be_unimportant() -> None:
    """Ordinary scheduling whatever was inherited, nice 10, disk only when nobody else wants it, and first to go when memory is short."""
    import ctypes

    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.setpriority(os.PRIO_PROCESS, 0, max(10, os.getpriority(os.PRIO_PROCESS, 0)))
    ioprio_set = {"x86_64": 251, "aarch64": 30, "armv7l": 314, "i686": 289, "riscv64": 30}.get(os.uname().machine)
    if ioprio_set is not None:
        ctypes.CDLL(None).syscall(ioprio_set, 1, 0, 3 << 13)  # IOPRIO_WHO_PROCESS, this one, IOPRIO_CLASS_IDLE
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")


def main(ring: str) -> None:
    """The process. Signals that end the loop do not end the recorder: it ends when the loop has, and everything is written."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    be_unimportant()
    Recorder(Path(ring)).run()


if __name__ == "__main__":
    main(sys.argv[1])
