"""The guard's process in a dry run on real time: the same program as on the robot, on the GPIO lines of the dry run's folder."""

import sys
from pathlib import Path

from mip_rt import guard
from mip_rt.fake.gpio import FakeGpio
from mip_rt.hardware.kernel import Kernel


class GuardKernel(Kernel):
    """The kernel as a guard meets it: a root, and GPIO lines.

    Args:
        root: the dry run's folder.
    """

    def __init__(self, root):
        super().__init__()
        self.root = Path(root)
        self.ioctl = FakeGpio(self.root).ioctl


if __name__ == "__main__":
    sys.exit(guard.main(GuardKernel(sys.argv[1]), sys.argv[2:]))
