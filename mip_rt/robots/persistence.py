"""What one tick leaves to the next: the bytes that a state row of the log holds, and from which a replay can resume.

A full state is kept once a second in a row of its own, not in the frame of every tick: with four estimators it is 10 kB, more than
three times the frame itself, and 2 MB/s on a robot whose log goes to an SD card. A replay that starts at a state row loses at
most one second at the beginning of a ring that has turned, and every state row within the replayed span is one more thing that must
come out equal. Scratch, such as the Jacobians, is left out: a step writes it before it reads it.
"""

import hashlib

import numpy as np

from mip_rt.errors import LogError


class Persistence:
    """The persistent memory of a robot as a fixed sequence of buffers.

    Args:
        pieces: (name, record array, bytes at the beginning of each record that persist).

    Attributes:
        parts: memoryviews of that memory, in order; the same objects for ever, so using them allocates nothing.
        size: their bytes together.
        layout: hash (16 hex digits) of the fields in them; a state row fits only where it is the same.
    """

    def __init__(self, *pieces):
        parts, description = [], []
        for name, array, kept in pieces:
            raw = np.asarray(array).view(np.uint8).reshape(len(array), -1)
            parts += [memoryview(record[:kept]) for record in raw]
            description.append(f"{name} {len(array)} {kept} {array.dtype.descr}")
        self.parts = tuple(parts)
        self.size = sum(len(part) for part in parts)
        self.layout = hashlib.sha256("\n".join(description).encode()).hexdigest()[:16]

    def kept(self) -> bytes:
        """The present state."""
        return b"".join(self.parts)

    def restore(self, kept: bytes) -> None:
        """Makes `kept`, of the same layout, the present state.

        Raises:
            LogError: it is not of this size.
        """
        if len(kept) != self.size:
            raise LogError(f"a state row has {len(kept)} bytes, this robot's state has {self.size}.", code="log_state")
        at = 0
        for part in self.parts:
            part[:] = kept[at : at + len(part)]
            at += len(part)
