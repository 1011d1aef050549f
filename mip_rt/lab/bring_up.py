"""Randomised bring-ups: a fault at a random transfer of the IMU's start, of every kind that the bus knows, then a clean retry.

Promised of each: it ends within a bound of (virtual) time, either well or with an ImuError that names the step and has a cure; whatever was opened is
closed again; the next attempt, without the fault, succeeds; the motors' enable line is never high.
"""

import errno
import random
from collections import Counter

from mip_rt.config import default_path, load
from mip_rt.errors import MipRtError
from mip_rt.fake.gpio import FakeGpio
from mip_rt.fake.i2c_bus import FakeI2cBus
from mip_rt.fake.machine import Machine
from mip_rt.fake.mpu9250 import FakeMpu9250, stand_in_image, stand_in_sha256
from mip_rt.fake.virtual_guard import VirtualGuard
from mip_rt.guard_words import NEWEST
from mip_rt.hardware.boards import GPIO
from mip_rt.hardware.devices import open_devices
from mip_rt.hardware.kernel import Kernel

ERRORS = (errno.EREMOTEIO, errno.ETIMEDOUT, errno.EIO, errno.EAGAIN, errno.EBUSY)
TIMEOUT_NS = 1_000_000_000  # i2c-omap's, for each transfer that times out
BOUND_S = 60.0
TRANSFERS = 900  # a clean start has so many, roughly; the fault begins at one of them
FIRST = 25  # before the image


class BringUpKernel(Kernel):
    """Clock, bus and lines of one board without a world; faults strike the bus."""

    def __init__(self, machine):
        self.root, self._machine = machine.folder, machine
        self.now_ns = 1_000_000_000
        self.chip = FakeMpu9250(self.monotonic_ns)
        self.bus = FakeI2cBus(self.chip)
        self.gpio = FakeGpio(machine.folder)
        self.guard = None

    def monotonic_ns(self) -> int:
        """Virtual."""
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        """Passes virtual time; sysfs and the guard go on."""
        self.now_ns += round(seconds * 1e9)
        self._machine.sysfs.service()
        self.guard.step(self.now_ns)

    def ioctl(self, fd, request, argument, mutate=True):
        """GPIO only."""
        return self.gpio.ioctl(fd, request, argument, mutate)

    def open_i2c(self, bus: int):
        """The bus with the chip."""
        return self.bus


class Trouble:
    """One fault of the bus: begins at a transfer, lasts for some, and refuses, breaks what is read, or takes the chip's power away."""

    def __init__(self, source: random.Random, kernel):
        self.kernel = kernel
        # Reset, identification and configuration have few transfers, loading the image most of all: both halves get their share.
        self.begin = source.randrange(source.choice((FIRST, TRANSFERS)))
        self.length = source.choice((1, 2, 3, 5, 1 << 30))
        self.kind = source.choice(("error", "error", "flip", "power"))
        self.number = source.choice(ERRORS)
        self.source, self.count, self.hits = source, 0, 0

    def __call__(self, messages) -> None:
        """Before each transfer."""
        self.count += 1
        if not self.begin < self.count <= self.begin + self.length:
            return
        self.hits += 1
        if self.kind == "error":
            if self.number == errno.ETIMEDOUT:
                self.kernel.now_ns += TIMEOUT_NS
            raise OSError(self.number, errno.errorcode[self.number])
        if self.kind == "power":
            self.kernel.chip._power_on()
        else:
            at = self.source.randrange(len(self.kernel.chip.memory))
            self.kernel.chip.memory[at] ^= 1 << self.source.randrange(8)
            self.kernel.chip.registers[self.source.randrange(0x19, 0x75)] ^= 1 << self.source.randrange(8)


def one(seed: int) -> dict:
    """One bring-up: {"outcome": "well" or the error's code, "step", "seconds", "broken": sentences of broken promises}."""
    config = load(default_path("mbbr"))
    machine = Machine(config)
    try:
        kernel = BringUpKernel(machine)
        pins = machine.pins
        line = (GPIO[pins.enable[0]], pins.enable[1])
        kernel.guard = guard = VirtualGuard(kernel, line, config.limits.guard_timeout_s)
        image = machine.folder / "dmp-stand-in.bin"
        image.write_bytes(stand_in_image())
        arguments = (kernel, config, guard, None, (image, stand_in_sha256()))
        kernel.bus.before = trouble = Trouble(random.Random(seed), kernel)
        result = {"seed": seed, "outcome": "well", "step": "", "broken": [], "kind": trouble.kind}
        begin_ns = kernel.now_ns
        try:
            devices = open_devices(*arguments)
            if trouble.kind == "power" and not kernel.chip.dmp_runs:
                result["broken"].append("the start says well, the DMP does not run")
            devices.close()
        except MipRtError as error:
            result["outcome"], result["step"] = error.code, error.sentence.partition("step '")[2].partition("'")[0]
            if not result["step"] or not error.cure:
                result["broken"].append(f"no step or no cure: {error.sentence}")
        except Exception as error:  # noqa: BLE001  (anything else is what this looks for)
            result["broken"].append(f"{type(error).__name__}: {error}")
        result["seconds"], result["hits"] = (kernel.now_ns - begin_ns) * 1e-9, trouble.hits
        if result["seconds"] > BOUND_S:
            result["broken"].append(f"it took {result['seconds']:.0f} s")
        if kernel.gpio.line_value(*line):
            result["broken"].append("the enable line is high")
        kernel.bus.before = None
        try:
            open_devices(*arguments).close()
        except MipRtError as error:
            result["broken"].append(f"the clean retry failed: {error}")
        if kernel.gpio.line_value(*line) or guard.memory[NEWEST] & 1:
            result["broken"].append("the enable line was asked to be high")
        return result
    finally:
        machine.close()


def run(count: int, progress=None) -> list[dict]:
    """`count` bring-ups, seeds from 1."""
    results = []
    for seed in range(1, count + 1):
        results.append(one(seed))
        if progress and (seed % 20 == 0 or seed == count):
            progress(seed, count, "bring-ups")
    return results


def render(results: list[dict]) -> None:
    """Prints the table."""
    hit = [result for result in results if result["hits"]]
    print(f"{len(results)} bring-ups, the fault struck in {len(hit)}; longest {max(result['seconds'] for result in results):.1f} s (virtual)")
    print("| outcome | step | times |\n|---|---|---|")
    for (outcome, step), times in sorted(Counter((r["outcome"], "DMP feature" if r["step"].startswith("DMP feature") else r["step"]) for r in results).items()):
        print(f"| {outcome} | {step} | {times} |")
    for result in results:
        for sentence in result["broken"]:
            print(f"seed {result['seed']} ({result['kind']}): {sentence}")
