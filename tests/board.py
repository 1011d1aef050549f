"""A board's fakes as a kernel without a world, and motors on it: for tests of drivers alone."""

import numpy as np

from mip_rt.compiled import JIT_DISABLED
from mip_rt.fake.gpio import FakeGpio
from mip_rt.fake.sysfs import FakeSysfs
from mip_rt.hardware.boards import BOARDS, GPIO
from mip_rt.hardware.gpio import OutputLines
from mip_rt.hardware.motors import Motors

PERIOD = 50000
ROW = np.dtype([("duty_ns", "<i8", (3,)), ("applied_ns", "<i8", (3,))], align=True)


class Kernel:
    """The fakes as a kernel without a world; closed after the test by a fixture of `conftest.py`."""

    made = []

    def __init__(self, root, abi=2, name="beaglebone-black-cape", **tree):
        self.root = root
        self.sysfs = FakeSysfs(root, BOARDS[name], **tree)
        self.gpio = FakeGpio(root, abi, self.sysfs.held)
        self.ioctl = self.gpio.ioctl
        self.made.append(self)

    def path(self, *parts):
        return self.root.joinpath(*parts)

    def sleep(self, seconds):
        self.sysfs.service()

    @classmethod
    def close_all(cls):
        """Some dozen descriptors each: without this a whole run of the tests would have thousands open."""
        while cls.made:
            kernel = cls.made.pop()
            kernel.gpio.close()
            kernel.sysfs.close()


class DirectEnable:
    """The enable line without a guard; what the guard does has tests of its own."""

    def __init__(self, kernel):
        self.lines = OutputLines(kernel, GPIO[0], (20,), 0, "test")

    def set(self, on):
        self.lines.set(int(on), 1)


def started_motors(kernel, name="beaglebone-black-cape", channels=(1, 3, 4)):
    motors = Motors(kernel, BOARDS[name], channels, PERIOD, DirectEnable(kernel))
    motors.start()
    kernel.sysfs.service()
    rows = np.zeros(1, ROW)
    motors.attach(rows.view(np.recarray) if JIT_DISABLED else rows)
    return motors


def write(motors, *pulses) -> bool:
    """Three signed pulses in ns, as the loop has them written."""
    motors._rows["duty_ns"][0] = pulses
    return motors.write(0)
