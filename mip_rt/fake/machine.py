"""A board without a robot: a temporary root with its sysfs tree and GPIO chips. All of a dry run that can exist before numba is loaded."""

import shutil
import tempfile
from pathlib import Path

from mip_rt.config.robots import ROBOTS
from mip_rt.fake.gpio import FakeGpio
from mip_rt.fake.sysfs import FakeSysfs
from mip_rt.hardware.boards import board


class Machine:
    """One board.

    Attributes:
        pins: hardware.boards.Board.
        folder: the root, in memory, as the real tree is.
        sysfs, gpio: what lies below it.
    """

    def __init__(self, config):
        shared = Path("/dev/shm")
        self.folder = Path(tempfile.mkdtemp(prefix="mip-rt-", dir=shared if shared.is_dir() else None))
        self.pins = board(ROBOTS[config.robot]["board"].default if config.board == "auto" else config.board, None)
        self.sysfs = FakeSysfs(self.folder, self.pins, config.dry_run.kernel)
        self.gpio = FakeGpio(self.folder, self.sysfs.generation.gpio_abi, self.sysfs.held)

    def close(self) -> None:
        """Removes the tree."""
        self.sysfs.close()
        self.gpio.close()
        shutil.rmtree(self.folder, ignore_errors=True)
