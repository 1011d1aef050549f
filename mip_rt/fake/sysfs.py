"""A sysfs tree in a temporary folder: eQEP counters, PWM chips, ADC and GPIO chips of a board, with realistic resolved paths.

The files are ordinary files, so drivers read and write them with ordinary system calls. Those of the hot path are also mapped here: the
world reads duties and writes counts without system calls. An ordinary file keeps what a shorter write leaves behind, so a
duty is read up to its newline; a count's file is cut to its exact length.
"""

import ctypes
import mmap
import os
from pathlib import Path

from mip_rt.hardware.boards import EHRPWM, GPIO

BUS = "sys/devices/platform/ocp"
PWM_CHIP_NUMBERS = {EHRPWM[0]: 1, EHRPWM[1]: 4, EHRPWM[2]: 7}  # running sums with the eCAPs between, as seen on 4.14
GPIO_CHIP_NUMBERS = {GPIO[0]: 3, GPIO[1]: 0, GPIO[2]: 1, GPIO[3]: 2}  # rotated, as on 5.15
COUNTER_NUMBERS = (2, 0, 1)  # probe order is nobody's promise


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
        encoder_interface: "counter" or "tieqep".
        pwm_naming: "pwmchipK/pwmN" or "pwm-K:N".

    Attributes:
        violations: sentences about writes that a real driver would have refused.
    """

    def __init__(self, root: Path, board, encoder_interface="counter", pwm_naming="pwmchipK/pwmN"):
        self.root, self.violations = Path(root), []
        self._encoder_interface, self._pwm_naming = encoder_interface, pwm_naming
        self.counts = [self._encoder(i, address) for i, address in enumerate(board.encoders)]
        self._chips = {}
        self._duties = {}
        for address in EHRPWM[1:]:
            self._pwm_chip(address)
        self._adc()
        for bank, address in enumerate(GPIO):
            self._gpio_chip(bank, address)

    def _folder(self, path: str, link_from: str) -> Path:
        folder = self.root / path
        folder.mkdir(parents=True, exist_ok=True)
        link = self.root / link_from
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(folder)
        return folder

    def _encoder(self, index: int, address: str) -> MappedFile:
        if self._encoder_interface == "tieqep":
            folder = self.root / f"{BUS}/{address[:-3]}000.epwmss/{address}.eqep"
            folder.mkdir(parents=True)
            for name, value in (("enabled", "0\n"), ("mode", "0\n"), ("period", "1000000000\n")):
                (folder / name).write_text(value)
            return MappedFile(folder / "position", b"0\n")
        number = COUNTER_NUMBERS[index]
        base = f"{BUS}/48000000.interconnect/{address[:-3]}000.target-module/{address}.counter/counter{number}"
        folder = self._folder(base, f"sys/bus/counter/devices/counter{number}") / "count0"
        folder.mkdir()
        for name, value in (("ceiling", "0\n"), ("enable", "0\n"), ("function", "increase\n")):
            (folder / name).write_text(value)
        return MappedFile(folder / "count", b"0\n")

    def _pwm_chip(self, address: str) -> None:
        number = PWM_CHIP_NUMBERS[address]
        base = f"{BUS}/48000000.interconnect/{address[:-3]}000.target-module/{address}.pwm/pwm/pwmchip{number}"
        chip = self._folder(base, f"sys/class/pwm/pwmchip{number}")
        (chip / "export").write_text("")
        (chip / "unexport").write_text("")
        (chip / "npwm").write_text("2\n")
        self._chips[address] = chip

    def service(self) -> None:
        """Answers requests that ordinary files cannot answer themselves: exports, and rules between attributes."""
        for address, chip in self._chips.items():
            for line in (chip / "export").read_text().split():
                self._export(address, chip, int(line))
            (chip / "export").write_text("")
            periods = set()
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
                if on:
                    periods.add(period)
            if len(periods) > 1:
                self.violations.append(f"{address}: two periods on one chip: {sorted(periods)}")

    def _channel_folder(self, address: str, channel: int) -> Path:
        chip = self._chips[address]
        if self._pwm_naming == "pwm-K:N":
            return self.root / f"sys/class/pwm/pwm-{PWM_CHIP_NUMBERS[address]}:{channel}"
        return chip / f"pwm{channel}"

    def _export(self, address: str, chip: Path, channel: int) -> None:
        folder = self._channel_folder(address, channel)
        if folder.is_dir() or channel not in (0, 1):
            return
        folder.mkdir()
        for name, value in (("period", "0\n"), ("polarity", "normal\n"), ("enable", "0\n")):
            (folder / name).write_text(value)
        self._duties[address, channel] = MappedFile(folder / "duty_cycle", b"0\n")

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
        return self._encoder_interface == "tieqep"

    def set_count(self, index: int, value: int) -> None:
        """Shows a count at an encoder: unsigned 32 bits for the counter subsystem, signed for tieqep."""
        raw = value & 0xFFFFFFFF
        if self.counts_are_signed and raw >= 1 << 31:
            raw -= 1 << 32
        self.counts[index].put(b"%d\n" % raw)

    def _adc(self) -> None:
        folder = self._folder(f"{BUS}/44e0d000.tscadc/TI-am335x-adc.1.auto/iio:device1", "sys/bus/iio/devices/iio:device1")
        (folder / "name").write_text("TI-am335x-adc.1.auto\n")
        self.adc = [MappedFile(folder / f"in_voltage{channel}_raw", b"0\n") for channel in range(8)]

    def set_adc(self, channel: int, raw: int) -> None:
        """Shows a reading at an ADC channel."""
        self.adc[channel].put(b"%d\n" % raw)

    def _gpio_chip(self, bank: int, address: str) -> None:
        number = GPIO_CHIP_NUMBERS[address]
        self._folder(f"{BUS}/{address}.gpio/gpiochip{number}", f"sys/bus/gpio/devices/gpiochip{number}")
        (self.root / "dev").mkdir(exist_ok=True)
        (self.root / f"dev/gpiochip{number}").write_text(address)

    def close(self) -> None:
        """Unmaps all files."""
        for mapped in (*self.counts, *self._duties.values(), *self.adc):
            mapped.close()
