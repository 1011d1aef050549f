"""A sysfs tree in a temporary folder: everything of a board that drivers look for, where each generation of kernels has it.

The files are ordinary files, so drivers read and write them with ordinary system calls. Those of the hot path are also mapped here: the
world reads duties and writes counts without system calls. An ordinary file keeps what a shorter write leaves behind, so a
duty is read up to its newline; a count's file is cut to its exact length.
"""

import dataclasses
import ctypes
import mmap
import os
import shutil
from pathlib import Path

from mip_rt.fake.generations import GENERATIONS
from mip_rt.hardware.boards import GPIO

I2C_2 = "4819c000"
IMU_DRIVER = "inv-mpu6050-i2c"


def address_of(mapping: mmap.mmap) -> int:
    """Where a mapping begins."""
    return ctypes.addressof(ctypes.c_char.from_buffer(mapping))


class MappedFile:
    """A small file that the fake writes or reads through a mapping.

    Attributes:
        address: of the mapping; at least 4096 bytes.
        fd: open on the file.
    """

    def __init__(self, path: Path, content: bytes):
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        self.fd = os.open(path, os.O_RDWR)
        os.ftruncate(self.fd, 4096)
        self._map = mmap.mmap(self.fd, 4096)
        os.ftruncate(self.fd, len(content))
        self.address = address_of(self._map)

    def put(self, content: bytes) -> None:
        """Replaces the content."""
        os.ftruncate(self.fd, len(content))
        self._map[: len(content)] = content

    def number(self) -> int:
        """The number before the first newline."""
        content = self._map[:24]
        return int(content[: content.find(b"\n")])

    def close(self) -> None:
        """Unmaps."""
        self._map.close()
        os.close(self.fd)


class FakeSysfs:
    """The tree.

    Args:
        root: stands for "/".
        board: hardware.boards.Board.
        generation: name in fake.generations.GENERATIONS.
        encoder_interface, pwm_naming: others than the generation's.
        stock: as an image has it, before the project's overlay: the traps are in the tree.

    Attributes:
        held: (bank address, offset) of the lines that kernel drivers hold.
        exports: how often a PWM channel was exported or unexported: addresses of their files are good until then.
        violations: sentences about writes that a real driver would have refused.
    """

    def __init__(self, root: Path, board, generation="5.10-ti", encoder_interface=None, pwm_naming=None, stock=False):
        self.root, self.violations, self.held, self.exports = Path(root), [], set(), 0
        kernel = GENERATIONS[generation]
        changes = {"encoders": encoder_interface, "pwm_naming": pwm_naming}
        self.generation = kernel = dataclasses.replace(kernel, **{key: value for key, value in changes.items() if value})
        blue = "Blue" in board.model
        self._device_tree(board, stock)
        self.counts = [] if stock and not blue else [self._encoder(i, address) for i, address in enumerate(board.encoders)]
        self._chips = {}
        self._duties = {}
        if not stock or blue and kernel.blue_has_pwm:
            for address in sorted({channel[0] for pin in board.motors.values() for channel in pin.channels}):
                self._pwm_chip(address)
        self.adc = []
        if not stock or blue:
            self._adc(1 if blue else 0)
        for bank, address in enumerate(GPIO):
            self._gpio_chip(bank, address)
        self._i2c(100_000 if stock and not blue else 400_000, bound=stock and blue and kernel.imu_in_blue_tree)
        if not stock or blue:
            self._folder(f"{kernel.device(board.uart, 'serial')}/tty/ttyS5", "sys/class/tty/ttyS5")
        if blue:
            for led in board.leds.values():
                folder = self._folder(f"sys/devices/platform/leds/leds/{led.name}", f"sys/class/leds/{led.name}")
                (folder / "brightness").write_text("0\n")
                self.held.add((GPIO[led.line[0]], led.line[1]))
        if self.held and stock and kernel.imu_in_blue_tree:
            self.held.add((GPIO[board.imu_interrupt[0]], board.imu_interrupt[1]))

    def _device_tree(self, board, stock: bool) -> None:
        tree = self.root / "proc/device-tree"
        (tree / "chosen/overlays").mkdir(parents=True)
        (tree / "model").write_text(f"TI AM335x {board.model}\0")
        if not stock:
            (tree / "chosen/overlays" / board.overlay).write_text("1\0")
        control = "interconnect@44c00000/segment@200000/target-module@10000/scm@0" if self.generation.interconnect else "l4_wkup@44c00000/scm@210000"
        pinmux = tree / "ocp" / control / "pinmux@800"
        pinmux.mkdir(parents=True)
        (pinmux / "#pinctrl-cells").write_bytes(self.generation.pinctrl_cells.to_bytes(4, "big"))
        release = self.root / "proc/sys/kernel/osrelease"
        release.parent.mkdir(parents=True)
        release.write_text(self.generation.release + "\n")

    def _i2c(self, clock_hz: int, bound: bool) -> None:
        folder = self._folder(f"{self.generation.device(I2C_2, 'i2c')}/i2c-2", "sys/bus/i2c/devices/i2c-2")
        (folder / "of_node").mkdir()
        (folder / "of_node/clock-frequency").write_bytes(clock_hz.to_bytes(4, "big"))
        if bound:
            chip = self._folder(f"{folder.relative_to(self.root)}/2-0068", "sys/bus/i2c/devices/2-0068")
            driver = self.root / "sys/bus/i2c/drivers" / IMU_DRIVER
            driver.mkdir(parents=True)
            (driver / "unbind").write_text("")
            (chip / "driver").symlink_to(driver)

    def _folder(self, path: str, link_from: str) -> Path:
        folder = self.root / path
        folder.mkdir(parents=True, exist_ok=True)
        link = self.root / link_from
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(folder)
        return folder

    def _encoder(self, index: int, address: str) -> MappedFile:
        kernel = self.generation
        if kernel.encoders == "tieqep":
            folder = self.root / dataclasses.replace(kernel, interconnect=False).device(address, "eqep")
            folder.mkdir(parents=True)
            for name, value in (("enabled", "0\n"), ("mode", "0\n"), ("period", "1000000000\n")):
                (folder / name).write_text(value)
            return MappedFile(folder / "position", b"0\n")
        number = kernel.counter_numbers[index]
        base = f"{kernel.device(address, 'counter')}/counter{number}"
        folder = self._folder(base, f"sys/bus/counter/devices/counter{number}") / "count0"
        folder.mkdir()
        for name, value in (("ceiling", "0\n"), ("enable", "0\n"), ("function", "increase\n")):
            (folder / name).write_text(value)
        return MappedFile(folder / "count", b"0\n")

    def _pwm_chip(self, address: str) -> None:
        number = self.generation.pwm_numbers[address]
        chip = self._folder(f"{self.generation.device(address, 'pwm')}/pwm/pwmchip{number}", f"sys/class/pwm/pwmchip{number}")
        (chip / "export").write_text("")
        (chip / "unexport").write_text("")
        (chip / "npwm").write_text("2\n")
        self._chips[address] = chip

    def service(self) -> None:
        """Answers requests that ordinary files cannot answer themselves: exports, and rules between attributes."""
        for address, chip in self._chips.items():
            for line in (chip / "unexport").read_text().split():
                self._unexport(address, int(line))
            (chip / "unexport").write_text("")
            for line in (chip / "export").read_text().split():
                self._export(address, chip, int(line))
            (chip / "export").write_text("")
            periods, running = set(), False
            for channel in (0, 1):
                folder = self._channel_folder(address, channel)
                if not folder.is_dir():
                    continue
                period = int((folder / "period").read_text().split()[0])
                on = (folder / "enable").read_text().startswith("1")
                duty = self._duties[address, channel].number()
                if on and period == 0:
                    self.violations.append(f"{address}:{channel} enabled with period 0")
                if duty > period:
                    self.violations.append(f"{address}:{channel} duty {duty} beyond the period {period}")
                running |= on
                periods |= {period} - {0}  # also the period of a channel that is off blocks another one
            if running and len(periods) > 1:
                self.violations.append(f"{address}: two periods on one chip: {sorted(periods)}")

    def _channel_folder(self, address: str, channel: int) -> Path:
        chip = self._chips[address]
        if self.generation.pwm_naming == "pwm-K:N":
            return self.root / f"sys/class/pwm/pwm-{self.generation.pwm_numbers[address]}:{channel}"
        return chip / f"pwm{channel}"

    def _export(self, address: str, chip: Path, channel: int) -> None:
        folder = self._channel_folder(address, channel)
        if folder.is_dir() or channel not in (0, 1):
            return
        self.exports += 1
        folder.mkdir()
        for name, value in (("period", "0\n"), ("polarity", "normal\n"), ("enable", "0\n")):
            (folder / name).write_text(value)
        self._duties[address, channel] = MappedFile(folder / "duty_cycle", b"0\n")

    def _unexport(self, address: str, channel: int) -> None:
        mapped = self._duties.pop((address, channel), None)
        if mapped is not None:
            self.exports += 1
            mapped.close()
            shutil.rmtree(self._channel_folder(address, channel))

    def duty_ns(self, address: str, channel: int) -> int:
        """What the driver last wrote; 0 before the channel is exported."""
        mapped = self._duties.get((address, channel))
        return mapped.number() if mapped is not None else 0

    def duty_file(self, address: str, channel: int) -> MappedFile | None:
        """The mapped file of a channel, for reading it every sample."""
        return self._duties.get((address, channel))

    @property
    def counts_are_signed(self) -> bool:
        """What a counter's file shows below zero: True for minus signs, False for numbers near 2^32."""
        return self.generation.encoders == "tieqep"

    def set_count(self, index: int, value: int) -> None:
        """Shows a count at an encoder: unsigned 32 bits for the counter subsystem, signed for tieqep."""
        raw = value & 0xFFFFFFFF
        if self.counts_are_signed and raw >= 1 << 31:
            raw -= 1 << 32
        self.counts[index].put(b"%d\n" % raw)

    def _adc(self, number: int) -> None:
        base = self.generation.device("44e0d000", "tscadc")
        folder = self._folder(f"{base}/TI-am335x-adc.{number}.auto/iio:device{number}", f"sys/bus/iio/devices/iio:device{number}")
        (folder / "name").write_text(f"TI-am335x-adc.{number}.auto\n")
        self.adc = [MappedFile(folder / f"in_voltage{channel}_raw", b"0\n") for channel in range(8)]
        for other in range(number):  # on the Blue the barometer comes first
            other_folder = self._folder(f"{self.generation.device(I2C_2, 'i2c')}/i2c-2/2-0076/iio:device{other}", f"sys/bus/iio/devices/iio:device{other}")
            (other_folder / "name").write_text("bmp280\n")

    def set_adc(self, channel: int, raw: int) -> None:
        """Shows a reading at an ADC channel."""
        self.adc[channel].put(b"%d\n" % raw)

    def _gpio_chip(self, bank: int, address: str) -> None:
        number = self.generation.gpio_numbers[address]
        self._folder(f"{self.generation.device(address, 'gpio')}/gpiochip{number}", f"sys/bus/gpio/devices/gpiochip{number}")
        (self.root / "dev").mkdir(exist_ok=True)
        (self.root / f"dev/gpiochip{number}").write_text(address)

    def close(self) -> None:
        """Unmaps all files."""
        for mapped in (*self.counts, *self._duties.values(), *self.adc):
            mapped.close()
