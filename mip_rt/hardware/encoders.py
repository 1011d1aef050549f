"""eQEP encoders through the counter subsystem (Linux 5.5 and later) or the vendor's tieqep driver (4.x).

Source: drivers/counter/ti-eqep.c, vendor drivers/misc/tieqep.c; the start sequence writes the ceiling first, because the
mainline driver begins with a ceiling of 0, at which nothing counts.
"""

import os
from functools import partial

from mip_rt.compiled import direct, span
from mip_rt.errors import EncoderError
from mip_rt.hardware import compiled_io, sysfs

WRAP = compiled_io.WRAP
TIEQEP_FOLDERS = "sys/devices/platform/ocp"


class Encoder:
    """One quadrature counter, unwrapped to a signed count of any size.

    Args:
        kernel: hardware.kernel.Kernel.
        address: device address, such as "48300180".
        bank: compiled_io.COUNTERS that the counters of one robot share, so that the loop reads them in one call; None: one of its own.
        index: place in the bank.

    Attributes:
        interface: "counter" or "tieqep".
        path: the count's file.
    """

    def __init__(self, kernel, address: str, bank=None, index: int = 0):
        self._bank, self._index = compiled_io.records(compiled_io.COUNTERS, 1) if bank is None else bank, index
        self._read = partial(direct(compiled_io.read_counter), *span(self._bank))
        counter = sysfs.find_by_address(kernel.path("sys/bus/counter/devices"), "counter*", address)
        if counter is not None:
            self.interface, self._folder = "counter", counter / "count0"
            self.path = self._folder / "count"
        else:
            found = sorted(kernel.path(TIEQEP_FOLDERS).glob(f"**/{address}.eqep"))
            if not found:
                raise EncoderError(
                    f"no eQEP counter at {address}.",
                    "Load the project's overlay; on Debian's own kernel there is no eQEP driver: use a BeagleBoard kernel.",
                    "encoder_missing",
                )
            self.interface, self._folder = "tieqep", found[0]
            self.path = self._folder / "position"
        self._fd = -1

    @property
    def errors(self) -> int:
        """Reads that failed; the last count is then repeated."""
        return int(self._bank["errors"][0, self._index])

    @property
    def failing(self) -> bool:
        """The last read failed."""
        return bool(self._bank["failing"][0, self._index])

    def start(self) -> None:
        """Full range, quadrature, zero, on.

        Raises:
            EncoderError: an attribute is missing or refuses.
        """
        try:
            if self.interface == "counter":
                sysfs.write(self._folder / "enable", "0\n")
                sysfs.write(self._folder / "ceiling", f"{WRAP - 1}\n")
                sysfs.write(self._folder / "function", "quadrature x4\n")
                sysfs.write(self.path, "0\n")
                sysfs.write(self._folder / "enable", "1\n")
            else:
                sysfs.write(self._folder / "mode", "0\n")
                sysfs.write(self.path, "0\n")
                sysfs.write(self._folder / "enabled", "1\n")
            self._fd = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC)
            raw = int(os.pread(self._fd, 24, 0).split()[0])
        except (OSError, ValueError, IndexError) as error:
            raise EncoderError(
                f"the counter {self._folder} does not take its settings: {error}.",
                "Check permissions (group gpio) and the overlay.",
                "encoder_setup",
            ) from error
        for name, value in (("fd", self._fd), ("raw", raw), ("count", 0), ("failing", 0)):
            self._bank[name][0, self._index] = value

    def reads_back(self, kernel, probe: int = 5) -> bool:
        """A count that is written can be read: the counter is clocked and its range is open. Leaves it at 0; before the loop only.

        Source: ti-eqep before Linux 6.10 relies on somebody else's clock, and begins with a ceiling of 0.
        """
        try:
            sysfs.write(self.path, f"{probe}\n")
            kernel.sleep(0.002)
            found = int(sysfs.read(self.path).split()[0])
            sysfs.write(self.path, "0\n")
        except (OSError, ValueError, IndexError):
            return False
        for name in ("raw", "count"):
            self._bank[name][0, self._index] = 0
        return abs(found - probe) <= 2  # somebody may touch the wheel

    def read(self) -> int:
        """The unwrapped count; the last one where reading failed. Never raises."""
        return self._read(self._index)

    def close(self) -> None:
        """Closes the file; the counter goes on."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = self._bank["fd"][0, self._index] = -1
