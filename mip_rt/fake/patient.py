"""A dry run's board for doctor and calibrate: the chips and the world of every dry run, on virtual time, with the rest of a board around them."""

from contextlib import contextmanager

from mip_rt.config import scenario as scenarios
from mip_rt.errors import ConfigError
from mip_rt.fake import bench as fake_bench
from mip_rt.fake.ailments import AILMENTS, Sick
from mip_rt.fake.board_files import Commands, furnish
from mip_rt.fake.hands import Hands
from mip_rt.hardware import i2c_time


class Wire:
    """Lets the bus take the time that its clock makes it take.

    Attributes:
        hz: the clock.
    """

    def __init__(self, kernel):
        self._kernel, self.hz = kernel, i2c_time.FAST_HZ

    def transfer(self, call, *messages):
        """A filter in front of the bus."""
        bits = 1  # start, stop and repeated starts
        for message in messages:
            bits += 9 * (1 + message.len) + 1
        try:
            return call(*messages)
        finally:
            self._kernel.wait_until(self._kernel.monotonic_ns() + round(bits / self.hz * 1e9))


@contextmanager
def opened(config, ailments=()):
    """(fake.bench.Bench, fake.hands.Hands), everything released afterwards.

    Raises:
        ConfigError: no such ailment.
    """
    from mip_rt.config.suggestion import nearest

    for name in ailments:
        if name not in AILMENTS:
            raise ConfigError(f"there is no fault {name!r}{nearest(name, AILMENTS)}.", "mip-rt doctor --dry-run --fault list shows them.", "arguments")
    bench = fake_bench.build(config, scenarios.load("hold"), 1, False)
    try:
        kernel = bench.kernel
        furnish(bench.folder, bench.machine.pins)
        kernel.command = commands = Commands()
        wire = Wire(kernel)
        bench.injector.taps.add(kernel.bus, "i2c_rdwr", wire.transfer)
        hands = Hands(bench, config)
        sick = Sick(bench, hands, commands, wire)
        for name in ailments:
            AILMENTS[name].apply(sick)
        yield bench, hands
    finally:
        bench.close()
