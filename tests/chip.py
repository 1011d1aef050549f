"""The register-level IMU as a driver's kernel, on virtual time."""

from mip_rt.fake.i2c_bus import FakeI2cBus
from mip_rt.fake.mpu9250 import FakeMpu9250


class Clock:
    """Virtual time and the bus, as the driver's kernel."""

    def __init__(self, **chip):
        self.now = 0
        self.slept = 0.0
        self.chip = FakeMpu9250(lambda: self.now, **chip)
        self.bus = FakeI2cBus(self.chip)

    def sleep(self, seconds):
        self.now += round(seconds * 1e9)
        self.slept += seconds

    def open_i2c(self, bus):
        return self.bus
