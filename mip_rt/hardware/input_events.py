"""Edges of an input line, with the kernel's timestamps."""

import os
from functools import partial

import numpy as np

from mip_rt.compiled import direct
from mip_rt.hardware.gpio import EDGES, EVENT_V1, EVENT_V2, INPUT, request_lines
from mip_rt.hardware.line_events import BUFFERED, STATE, take


class InputEvents:
    """Edges of one input line.

    Attributes:
        fd: becomes readable with each edge.
        state: (1,) line_events.STATE.
    """

    def __init__(self, kernel, address: str, offset: int, edge: str, consumer: str):
        self.fd, version = request_lines(kernel, address, (offset,), INPUT | EDGES[edge], consumer, buffered=BUFFERED)
        os.set_blocking(self.fd, False)
        self.state = np.zeros(1, STATE)
        size = (EVENT_V2 if version == 2 else EVENT_V1).size
        self.state["fd"], self.state["event_bytes"], self.state["room"] = self.fd, size, size * BUFFERED
        self._take = partial(direct(take), self.state.ctypes.data)

    @property
    def missed(self) -> int:
        """Edges that the kernel's buffer dropped."""
        return int(self.state["missed"][0])

    def take(self) -> int:
        """Reads all that is waiting into `state`.

        Returns:
            How many events there were, the dropped ones included.

        Raises:
            OSError: the kernel refuses.
        """
        count = self._take()
        if count < 0:
            raise OSError(-count, os.strerror(-count))
        return count

    def read(self):
        """(timestamp_ns, edge id, number of edges) of all that is waiting, the newest's; None where nothing is."""
        count = self.take()
        return (int(self.state["timestamp_ns"][0]), int(self.state["edge"][0]), count) if count else None

    def forget(self) -> None:
        """Reads all that is waiting; neither that nor what the buffer has dropped until the next event counts as missed."""
        while self.take():
            pass
        self.state["sequence"] = -1

    def close(self) -> None:
        """Releases the line."""
        os.close(self.fd)
