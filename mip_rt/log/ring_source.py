"""The recorder's view of the ring: copies of whole rows and kept states out of a mapping that the loop goes on writing. Needs no numpy."""

import mmap
import struct
from pathlib import Path

from mip_rt.errors import LogError
from mip_rt.log import ring_format
from mip_rt.log.ring_format import STATE_MARK, Counter, Status

_COUNTERS = struct.Struct(f"<{len(Counter)}q")
_STATUS = struct.Struct(f"<{len(Status)}q")
_Q = struct.Struct("<q")


class RingSource:
    """Reads the ring of a running loop; writes nothing but the status page.

    Attributes:
        description: the log's description.
        geometry: where the ring's parts lie.
        rows, row_bytes: of the ring.

    Raises:
        LogError: the file is not a ring of this version.
    """

    def __init__(self, path: Path):
        with open(path, "r+b") as file:
            self._map = mmap.mmap(file.fileno(), 0)
        found = ring_format.unpack_header(self._map)
        if found is None:
            raise LogError(f"{path} is not a ring of version {ring_format.VERSION}.", code="log_magic")
        self.geometry, self.description = found
        self.rows, self.row_bytes = self.geometry.rows, self.geometry.row_bytes

    def counters(self) -> tuple[int, ...]:
        """The counters page, by Counter."""
        return _COUNTERS.unpack_from(self._map, self.geometry.counters_at)

    def committed(self) -> int:
        """Newest committed tick + 1."""
        return _Q.unpack_from(self._map, self.geometry.counters_at)[0]

    def oldest(self) -> int:
        """The oldest tick that is certainly not being overwritten."""
        return max(0, self.committed() - self.rows + 1)

    def take(self, first: int, last: int) -> tuple[bytes, int, int]:
        """Copies ticks first to last - 1, at most up to the ring's end.

        Returns:
            (bytes of the rows that are whole, their number, tick to go on from).
        """
        index = first % self.rows
        count = min(last - first, self.rows - index)
        size, begin = self.row_bytes, self.geometry.rows_at + index * self.row_bytes
        copy = self._map[begin : begin + count * size]
        oldest = self.oldest()
        whole = [
            first + i >= oldest and _Q.unpack_from(copy, i * size)[0] == first + i + 1 for i in range(count)
        ]  # fmt: skip
        if not all(whole):
            copy = b"".join(copy[i * size : (i + 1) * size] for i in range(count) if whole[i])
        return copy, sum(whole), first + count

    def states(self, number: int) -> list[tuple[int, int, bytes]]:
        """The kept states from the `number`th on, as (number, tick, bytes), as far as the ring still has them whole."""
        geometry, found = self.geometry, []
        newest = self.counters()[Counter.STATES]
        for number in range(max(number, newest - geometry.state_rows), newest):
            at = geometry.states_at + number % geometry.state_rows * geometry.slot_bytes
            sequence, tick = STATE_MARK.unpack_from(self._map, at)
            payload = self._map[at + STATE_MARK.size : at + STATE_MARK.size + geometry.state_bytes]
            if sequence == tick + 1 and STATE_MARK.unpack_from(self._map, at)[0] == sequence:
                found.append((number, tick, payload))
        return found

    def status(self) -> tuple[int, ...]:
        """The status page, by Status."""
        return _STATUS.unpack_from(self._map, self.geometry.status_at)

    def publish(self, status: list[int]) -> None:
        """Stores the status page."""
        _STATUS.pack_into(self._map, self.geometry.status_at, *status)
