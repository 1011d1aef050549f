"""A fault file: the rows around a fault, taken from the ring while it still has them, kept until the user removes the file. Needs no numpy."""

import time

from mip_rt.log import block_format
from mip_rt.log.block_format import SUFFIX, Kind
from mip_rt.log.recording_files import AppendFile, fault_files, sync_folder
from mip_rt.log.ring_format import Status

ROWS_AT_ONCE = 100  # one block a look, so that ordinary recording goes on
RETRY_S = 1.0


class FaultFile:
    """One fault: waits for what follows it, then writes block after block.

    Args:
        recorder: whose ring, settings and counters are used.
        number: fault code.
        tick: the first tick after the fault.
        code: the fault's name.

    Attributes:
        needed: oldest tick that is still to be read.
    """

    def __init__(self, recorder, number: int, tick: int, code: str):
        self._recorder, self._tick, self._code, self._number = recorder, tick, code, number
        settings = recorder.settings
        self._last = tick + round(settings["fault_after_s"] * settings["rate_hz"])
        self.needed = max(0, tick - round(settings["fault_before_s"] * settings["rate_hz"]))
        self._begin = self.needed
        self._patience_s = settings["fault_after_s"]
        self._seen, self._seen_at = -1, 0.0
        self._retry_at = 0.0
        self._file = None
        self._sequence = 0
        name = f"fault-{time.strftime('%Y%m%d-%H%M%S')}-{code}-{recorder.source.description['run'][:6]}-{tick}{SUFFIX}"
        self._path = recorder.folder / name

    def advance(self, now: float, ended: bool) -> bool:
        """One step; False when there is no more to do."""
        recorder = self._recorder
        committed = recorder.source.committed()
        if committed != self._seen:
            self._seen, self._seen_at = committed, now
        quiet = ended or now - self._seen_at > self._patience_s  # nothing follows: the loop, or the IMU, has stopped
        if now < self._retry_at or committed < self._last and not quiet:
            return True
        try:
            if self._file is None:
                if committed <= max(self._begin, recorder.source.oldest()):
                    return False  # the loop ended before its first tick
                if len(fault_files(recorder.folder)) >= recorder.settings["fault_files"]:
                    recorder.status[Status.FAULTS_REFUSED] += 1
                    return False
                self._start()
            if self._write_rows(min(self._last, committed)):
                return True
            self._end()
            recorder.status[Status.FAULTS_KEPT] += 1
            return False
        except OSError as error:
            recorder.refused(error)
            self._retry_at = now + RETRY_S
            self.abandon()
            if recorder.source.oldest() > self._tick:  # the ring has moved on: what led to the fault is gone
                recorder.status[Status.FAULTS_LOST] += 1
                return False
            return True

    def _start(self) -> None:
        self._file = AppendFile(self._path.with_suffix(".unfinished"))
        self._sequence = 0
        self.needed = self._begin
        self._file.append(self._recorder.header())

    def _append(self, kind: Kind, payload: bytes, first: int, rows: int = 0) -> None:
        level = self._recorder.settings["compression"]
        self._file.append(block_format.pack(kind, payload, self._sequence, level, first, rows))
        self._sequence += 1

    def _write_rows(self, last: int) -> bool:
        """One block; False where there are no more rows."""
        source = self._recorder.source
        self.needed = max(self.needed, source.oldest())
        if self.needed >= last:
            return False
        first = self.needed
        payload, whole, self.needed = source.take(first, min(first + ROWS_AT_ONCE, last))
        if whole:
            self._append(Kind.ROWS, payload, first, whole)
        return True

    def _end(self) -> None:
        for _, tick, payload in self._recorder.source.states(0):
            if self._begin - 1 <= tick < self._last:
                self._append(Kind.STATE, payload, tick)
        self._file.append(self._recorder.header())
        reason = {"reason": f"fault {self._code}", "fault": self._number, "tick": self._tick, **self._recorder.report()}
        self._file.append(block_format.pack_json(Kind.END, reason, self._sequence))
        self._file.sync()
        self._file.close()
        self._file.path.rename(self._path)
        sync_folder(self._path.parent)
        self._file = None

    def abandon(self) -> None:
        """Removes what was begun."""
        if self._file is None:
            return
        self._file.close()
        try:
            self._file.path.unlink()
        except OSError:
            pass
        self._file = None
