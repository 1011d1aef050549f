"""What can be wrong with a board before a robot balances, as data: for doctor's dry run, where each has its line and its cure.

They act on the fakes of the kernel boundary only: files, chips, wires, other programs, the person's robot. Those of a running robot are in `faults`.
"""

import errno
import os
import shutil
from typing import NamedTuple

from mip_rt.fake.board_files import PADS, pads_text
from mip_rt.hardware import mpu9250_registers as r

PADS_FILE = "sys/kernel/debug/pinctrl/44e10800.pinmux-pinctrl-single/pins"


class Ailment(NamedTuple):
    """One.

    Attributes:
        line: "layer.check" that must say so.
        verdict: "warn" or "fail".
        meaning: one sentence.
        apply: callable(Board): what is done to the fakes.
        person: only with --interactive.
    """

    line: str
    verdict: str
    meaning: str
    apply: object
    person: bool = False


class Sick:
    """The parts that ailments act upon.

    Args:
        bench: fake.bench.Bench.
        hands: fake.hands.Hands.
        commands: fake.board_files.Commands.
        wire: fake.patient.Wire.
    """

    def __init__(self, bench, hands, commands, wire):
        self.bench, self.hands, self.commands, self.wire = bench, hands, commands, wire
        self.kernel, self.root = bench.kernel, bench.folder

    def write(self, name: str, text: str) -> None:
        """A file of the board."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def overlay(self, name: str) -> None:
        """U-Boot has loaded this one, too."""
        self.write(f"proc/device-tree/chosen/overlays/{name}", "")

    def refuse(self, number: int) -> None:
        """Every transfer of the bus ends with this error."""

        def before(messages):
            if number == errno.ETIMEDOUT:
                self.kernel.wait_until(self.kernel.monotonic_ns() + 1_000_000_000)
            raise OSError(number, os.strerror(number))

        self.kernel.bus.before = before

    def pads(self, **changes) -> None:
        """Other pad registers: offset as x9a0=value."""
        self.write(PADS_FILE, pads_text({**PADS, **{int(name[1:], 16): value for name, value in changes.items()}}))


def _driver(sick):
    drivers = sick.root / "sys/bus/i2c/drivers/inv-mpu6050-i2c"
    drivers.mkdir(parents=True)
    device = sick.root / "sys/bus/i2c/devices/2-0068"
    device.mkdir(parents=True)
    (device / "driver").symlink_to(drivers)


def _packets(change):
    def apply(sick):
        sick.bench.injector.taps.add(sick.kernel.chip, "sample", lambda call, packet, raw: call(change(bytes(packet)), raw))

    return apply


def _overflow(sick):
    sick.bench.injector.taps.add(sick.kernel.chip, "sample", lambda call, packet, raw: [call(packet, raw) for _ in range(40)][-1])


def _misaligned(sick):
    def sample(call, packet, raw):
        sick.kernel.chip.fifo += b"\0" * 5
        return call(packet, raw)

    sick.bench.injector.taps.add(sick.kernel.chip, "sample", sample)


def _half_rate(sick):
    turn = [0]

    def sample(call, packet, raw):
        turn[0] += 1
        return call(packet, raw) if turn[0] % 2 else False

    sick.bench.injector.taps.add(sick.kernel.chip, "sample", sample)


def _no_edges(sick):
    line = tuple(sick.kernel.imu_line)
    sick.bench.injector.taps.add(
        sick.kernel.gpio, "push_edge", lambda call, address, offset, *rest: False if (address, offset) == line else call(address, offset, *rest)
    )


def _memory(sick):
    chip = sick.kernel.chip
    whole = chip._store

    def store(register, value):
        whole(register, value)
        chip.memory[700] = 0x5A

    chip._store = store


def _unclocked(sick):
    wiring = sick.kernel.motor_wiring

    def service(call):
        wiring.count_file(0).put(b"0\n")
        return call()

    sick.bench.injector.taps.add(sick.kernel.sysfs, "service", service)


def _take_line(sick):
    from mip_rt.hardware.devices import interrupt_line

    sick.taken = interrupt_line(sick.kernel, sick.bench.machine.pins)


def _period(sick):
    def service(call):
        call()
        for period in sick.root.glob("sys/class/pwm/pwmchip*/pwm*/period"):
            period.write_text("1000000\n")

    sick.bench.injector.taps.add(sick.kernel.sysfs, "service", service)


def _remove(pattern):
    def apply(sick):
        for path in sick.root.glob(pattern):
            path.unlink() if path.is_symlink() or path.is_file() else shutil.rmtree(path)

    return apply


def _thread(sick):
    sick.write("sys/kernel/realtime", "1\n")
    sick.write("proc/71/comm", "irq/71-4819c000.i2c\n")
    sick.write("proc/71/stat", "71 (irq/71-4819c000.) S 2 " + "0 " * 35 + "0 30 1 0 0\n")


def _battery(raw):
    def apply(sick):
        sick.bench.injector.taps.add(sick.kernel.motor_wiring, "show_battery", lambda call, shown: call(raw))
        sick.kernel.motor_wiring.battery_file.put(b"%d\n" % raw)

    return apply


def _bytes(data):
    def apply(sick):
        send = sick.bench.remote.send_bytes
        sick.bench.remote.send_bytes = lambda frame: send(data)

    return apply


AILMENTS = {
    # -- the traps of a new board
    "kernel-driver": Ailment("i2c.driver", "fail", "the kernel's driver holds the IMU (every Blue from 5.10 on)", _driver),
    "blue-without-pwm": Ailment("motors.pwm", "fail", "no PWM chip is enabled (mainline device trees of the Blue)", _remove("sys/class/pwm/pwmchip*")),
    "e1-pad": Ailment("board.pads", "fail", "channel A of E1 is on the wrong pad (mainline device trees of the Blue)", lambda s: s.pads(x9a0=0x27)),
    "overlay-eqep0": Ailment("board.overlay", "fail", "the stock overlay BB-EQEP0 is loaded", lambda s: s.overlay("BB-EQEP0")),
    "overlay-eqep2": Ailment("board.overlay", "fail", "the stock overlay BB-EQEP2 is loaded", lambda s: s.overlay("BB-EQEP2")),
    "counter-unclocked": Ailment("encoders.wheel1", "fail", "a counter keeps nothing: no clock, or a ceiling of 0", _unclocked),
    "bus-100-khz": Ailment("i2c.clock", "fail", "the bus runs at 100 kHz", lambda s: setattr(s.wire, "hz", 100_000)),
    "gpio-missing": Ailment("board.gpio", "fail", "a GPIO bank is not there", _remove("sys/bus/gpio/devices/gpiochip2")),
    "debian-13": Ailment("software.compiler", "fail", "numba is not installed (Debian 13 on 32-bit ARM)",
                         lambda s: setattr(s.commands, "probe", (1, "ModuleNotFoundError: No module named 'numba'\n"))),
    "llvm-abort": Ailment("software.compiler", "fail", "LLVM aborts the process",
                          lambda s: setattr(s.commands, "probe", (-6, "LLVM ERROR: Symbol not found: __sync_fetch_and_add_4\n"))),
    "dmp-rate": Ailment("imu.interrupt", "fail", "the DMP delivers at half its rate", _half_rate),
    # -- board and system
    "other-board": Ailment("board.model", "fail", "this is no BeagleBone", lambda s: s.write("proc/device-tree/model", "Raspberry Pi 4\0")),
    "old-kernel": Ailment("board.kernel", "fail", "a kernel of 4.9", lambda s: s.write("proc/sys/kernel/osrelease", "4.9.82-ti-r102\n")),
    "debian-kernel": Ailment("board.kernel", "fail", "Debian's own kernel", lambda s: s.write("proc/sys/kernel/osrelease", "6.1.0-50-rt-armmp\n")),
    "no-overlay": Ailment("board.overlays", "warn", "the project's overlay is not loaded", _remove("proc/device-tree/chosen/overlays/*")),
    "imu-pad": Ailment("board.pads", "fail", "the interrupt's pad belongs to eQEP 0", lambda s: s.pads(x9ac=0x31)),
    "robot-runs": Ailment("services.mip-rt", "fail", "the robot's own service runs", lambda s: s.commands.active.add("mip-rt.service")),
    "robotcontrol": Ailment("services.robotcontrol", "fail", "the old library's service runs", lambda s: s.commands.active.add("robotcontrol.service")),
    "getty": Ailment("services.getty", "warn", "a login waits on the remote's port", lambda s: s.commands.active.add("serial-getty@ttyS5.service")),
    "governor": Ailment("realtime.governor", "warn", "the CPU changes its frequency",
                        lambda s: s.write("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "ondemand\n")),
    "irq-thread": Ailment("realtime.irq-i2c", "warn", "the bus's interrupt thread runs below the loop", _thread),
    # -- bus and IMU
    "no-bus": Ailment("i2c.device", "fail", "there is no /dev/i2c-2", _remove("dev/i2c-2")),
    **{name: Ailment("i2c.answer", "fail", f"every transfer ends with error {number}", lambda s, n=number: s.refuse(n)) for name, number in (
        ("bus-nack", errno.EREMOTEIO), ("bus-timeout", errno.ETIMEDOUT), ("bus-error", errno.EIO), ("bus-arbitration", errno.EAGAIN), ("bus-busy", errno.EBUSY))},
    "wrong-chip": Ailment("i2c.answer", "fail", "an MPU-6050 is on the board", lambda s: (setattr(s.kernel.chip, "_identity", 0x68), s.kernel.chip._power_on())),
    "line-taken": Ailment("imu.line", "fail", "somebody else has the interrupt line", _take_line),
    "no-image": Ailment("imu.image", "fail", "the DMP's image is missing", lambda s: os.unlink(s.bench.image_path)),
    "wrong-image": Ailment("imu.image", "fail", "another image", lambda s: s.bench.image_path.write_bytes(b"\1" * r.DMP_IMAGE_BYTES)),
    "dmp-memory": Ailment("imu.start", "fail", "the DMP's memory does not keep what is written", _memory),
    "no-interrupts": Ailment("imu.interrupt", "fail", "the interrupt does not reach the processor", _no_edges),
    "fifo-misaligned": Ailment("imu.fifo", "fail", "stray bytes in the FIFO", _misaligned),
    "fifo-overflow": Ailment("imu.fifo", "warn", "the FIFO runs over", _overflow),
    "imu-zeros": Ailment("imu.measures", "fail", "accelerometer and gyro read zeros", _packets(lambda packet: packet[:16] + bytes(16))),
    "imu-scale": Ailment("imu.measures", "fail", "the accelerometer shows half of gravity",
                         _packets(lambda packet: packet[:16] + b"".join((int.from_bytes(packet[a:a + 2], "big", signed=True) // 2).to_bytes(2, "big", signed=True)
                                                                       for a in (16, 18, 20)) + packet[22:])),
    # -- encoders, motors, battery, remote
    "no-encoder": Ailment("encoders.wheel1", "fail", "no counter at all", _remove("sys/bus/counter/devices/*")),
    "pwm-period": Ailment("motors.pwm", "fail", "another program has set another PWM period", _period),
    "no-adc": Ailment("power.adc_missing", "fail", "the ADC is not enabled", _remove("sys/bus/iio/devices/*")),
    "no-battery": Ailment("power.battery", "fail", "no battery is connected", _battery(3)),
    "low-battery": Ailment("power.battery", "fail", "the battery is empty", _battery(1290)),
    "wrong-baud": Ailment("remote.frames", "fail", "the remote's baud rate is wrong", _bytes(b"\xf8\x80\xfe\x11")),
    "remote-silent": Ailment("remote.frames", "warn", "nothing comes from the remote", _bytes(b"")),
    # -- what only a person can find
    "dead-channel": Ailment("encoders.turn1", "fail", "a channel of encoder 1 is not connected", lambda s: s.hands.dead_channels.add(0), True),
    "encoder-sign": Ailment("encoders.turn2", "fail", "encoder 2 counts the other way", lambda s: s.hands.encoder_signs.__setitem__(1, -s.hands.encoder_signs[1]), True),
    "encoder-counts": Ailment("encoders.turn1", "warn", "another gear", lambda s: setattr(s.hands, "counts_per_turn", s.hands.counts_per_turn * 2), True),
    "motor-sign": Ailment("motors.output1", "fail", "motor 1 turns the other way", lambda s: s.hands.drives.__setitem__(0, (0, -1)), True),
    "motors-swapped": Ailment("motors.output1", "fail", "motors 1 and 2 are exchanged",
                              lambda s: s.hands.drives.__setitem__(slice(0, 2), [(1, 1), (0, 1)]), True),
    "motor-dead": Ailment("motors.output1", "fail", "motor 1 does not turn", lambda s: s.hands.drives.__setitem__(0, (0, 0)), True),
}  # fmt: skip
