"""Puts a whole dry run together: a temporary root, the chips, the tree, the world, the operator, and the kernel that connects them."""

from dataclasses import dataclass
from pathlib import Path

from mip_rt import guard_client, robots
from mip_rt.fake.entrance import Entrance
from mip_rt.fake.i2c_bus import FakeI2cBus
from mip_rt.fake.injection import Injector
from mip_rt.fake.kernel import FakeKernel
from mip_rt.fake.machine import Machine
from mip_rt.fake.mpu9250 import FakeMpu9250, stand_in_image, stand_in_sha256
from mip_rt.fake.operator import Operator
from mip_rt.fake.remote import FakeRemote
from mip_rt.fake.usual_sample import FALLING
from mip_rt.fake.virtual_guard import VirtualGuard
from mip_rt.fake.wiring import Wiring
from mip_rt.fake.world import World
from mip_rt.hardware.boards import GPIO


@dataclass
class Bench:
    """A running dry run's parts.

    Attributes:
        guard: holds the motor-enable line.
        config_path: the file that the user configured the run from; None for the shipped one.
        injector: fake.injection.Injector of the scenario's faults.
    """

    kernel: FakeKernel
    machine: Machine
    guard: guard_client.GuardClient
    world: World
    remote: FakeRemote
    folder: Path
    image_path: Path
    image_sha256: str
    config_path: Path | None = None
    injector: Injector | None = None

    def close(self) -> None:
        """Releases everything and removes the temporary folder."""
        self.injector.close()
        if self.kernel.entrance is not None:
            self.kernel.entrance.close()
        self.remote.close()
        self.guard.close()
        self.machine.close()


def build(config, scenario, seed: int, real_time: bool, machine: Machine | None = None, guard=None, config_path=None) -> Bench:
    """A dry run of this configuration and scenario.

    Args:
        config_path: the file of the configuration, where faults may touch it.
        machine, guard: where they had to exist before numba was loaded: the board, and on real time the guard's process on it.
    """
    machine = machine or Machine(config)
    folder, pins = machine.folder, machine.pins
    robots.setup(config.robot)  # loads the compiled code of robot and world, which takes a second: the clock starts after that
    world = World(config, seed)
    kernel = FakeKernel(folder, real_time)
    remote = FakeRemote()
    kernel.sysfs, kernel.gpio = machine.sysfs, machine.gpio
    if real_time:
        guard = guard or guard_client.start(config, machine)
    else:
        guard = kernel.guard = VirtualGuard(kernel, (GPIO[pins.enable[0]], pins.enable[1]), config.limits.guard_timeout_s)
    kernel.chip = FakeMpu9250(kernel.monotonic_ns)
    kernel.bus = FakeI2cBus(kernel.chip, config.imu.address, kernel.charge if real_time else None, compiled=not real_time)
    kernel.world = world
    kernel.imu_line = (GPIO[pins.imu_interrupt[0]], pins.imu_interrupt[1])
    kernel.motor_wiring = Wiring(config, pins, kernel.sysfs, kernel.gpio)
    button = (GPIO[pins.arm_button[0]], pins.arm_button[1])
    image = folder / "dmp-stand-in.bin"
    image.write_bytes(stand_in_image())
    bench = Bench(kernel, machine, guard, world, remote, folder, image, stand_in_sha256(), config_path)
    if not real_time:
        world.attach(guard, kernel.motor_wiring, kernel.chip)
        kernel.attach_usual()
    bench.injector = Injector(bench, seed)
    kernel.taps = bench.injector.taps
    kernel.operator = Operator(
        scenario, config.remote.levels, world, remote.send, lambda now_ns: kernel.gpio.push_edge(*button, now_ns, FALLING), bench.injector
    )
    if real_time:  # on virtual time nobody could follow, and a run must depend on its seed alone
        kernel.entrance = Entrance(folder / "entrance", kernel.operator, remote.send_bytes)
    return bench
