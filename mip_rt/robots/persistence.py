"""What one tick leaves to the next: the bytes that a state row of the log holds, and from which a replay can resume.

A full state is kept once a second in a row of its own, not in the frame of every tick: with four estimators it is 10 kB, more than
five times the frame itself, which would make 2 MB/s on a robot whose log goes to an SD card. A replay that starts at a state row loses at
most one second at the beginning of a ring that has turned, and every state row within the replayed span is one more thing that must
come out equal. Scratch, such as the Jacobians, is left out: a step writes it before it reads it.
"""

import hashlib

import numpy as np

from mip_rt.errors import LogError


class Persistence:
    """The persistent memory of a robot as a fixed sequence of buffers.

    Args:
        state: (1,) records.
        slots: (n,) records, one an estimator.
        state_kept: bytes at the beginning of the state that persist.
        kept: likewise of each slot.
        estimate: range of those bytes that holds the estimate (float64): a slot in which it is NaN resets itself at its next step.

    Attributes:
        parts: memoryviews of that memory, in order; the same objects for ever, so using them allocates nothing.
        size: their bytes together.
        layout: hash (16 hex digits) of the fields in them; a state row fits only where it is the same.
    """

    def __init__(self, state, slots, state_kept: int, kept: int, estimate: slice):
        state, slots = np.asarray(state), np.asarray(slots)
        raw = slots.view(np.uint8).reshape(len(slots), -1)
        self.parts = (memoryview(state.view(np.uint8)[:state_kept]), *(memoryview(record[:kept]) for record in raw))
        self.size = sum(len(part) for part in self.parts)
        self.layout = hashlib.sha256(f"{state.dtype.descr} {slots.dtype.descr} {state_kept} {kept}".encode()).hexdigest()[:16]
        self._kept, self._estimate = kept, estimate

    def present(self) -> bytes:
        """The present state."""
        return b"".join(self.parts)

    def restore(self, row: bytes, slots=None) -> None:
        """Makes the state in a state row of the same layout the present one.

        Args:
            slots: for each estimator the slot that it had in the row, or None where it was not there; by default they are the same.

        Raises:
            LogError: the row has not the size of such a state.
        """
        common = len(self.parts[0])
        count, rest = divmod(len(row) - common, self._kept)
        slots = list(range(len(self.parts) - 1)) if slots is None else slots
        if rest or count < 1 or any(slot is not None and slot >= count for slot in slots):
            raise LogError(f"a state row has {len(row)} bytes, this robot's state has {self.size}.", code="log_state")
        self.parts[0][:] = row[:common]
        for part, slot in zip(self.parts[1:], slots):
            at = common + (slot or 0) * self._kept
            part[:] = row[at : at + self._kept]
            if slot is None:
                np.frombuffer(part, np.uint8)[self._estimate].view("<f8")[:] = np.nan
