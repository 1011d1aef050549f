"""Pin tables against the hardware's documents, truth tables against models of the bridges, and nine boards in nine trees."""

import itertools
import os
from pathlib import Path
from types import SimpleNamespace

import pytest
from board import PERIOD, DirectEnable, Kernel, started_motors, write
from helpers import DryRun, make_config

from mip_rt.errors import ConfigError, GpioError, HardwareError, MotorError
from mip_rt.fake.generations import GENERATIONS
from mip_rt.hardware import board_table, boards
from mip_rt.hardware.boards import BOARDS, EHRPWM, GPIO
from mip_rt.hardware.encoders import Encoder
from mip_rt.hardware.leds import Leds
from mip_rt.hardware.motors import Motors
from mip_rt.supervisor import State

MC33926 = [name for name in BOARDS if "mc33926" in name]
THREE = ("beaglebone-blue", "beaglebone-black-cape", "beaglebone-black-mc33926")

# Legacy GPIO numbers (32 bank + offset) as librobotcontrol, the cape's and the Blue's documents have them: PWM, A, B, polarity.
CAPE = {1: ("1A", 60, 31, 1), 2: ("1B", 48, 81, -1), 3: ("2A", 73, 72, -1), 4: ("2B", 70, 71, 1)}
BLUE = {1: ("1A", 64, 31, 1), 2: ("1B", 48, 10, -1), 3: ("2A", 73, 72, -1), 4: ("2B", 70, 71, 1)}
S1 = {number: (*CAPE[number][:3], 1) for number in (1, 2, 3)}
S2 = {1: ("1A", "1B"), 2: ("2A", "2B"), 3: ("0A", "0B")}
S3 = {number: (pwm, None, b, 1) for number, (pwm, _, b, _) in S1.items()}


def legacy(line):
    return None if line is None else 32 * line[0] + line[1]


def pwm(channel):
    return f"{EHRPWM.index(channel[0])}{'AB'[channel[1]]}"


@pytest.mark.parametrize(("name", "table"), list(zip(BOARDS, (BLUE, CAPE, S1, S2, S3))))
def test_tables_hold_what_the_documents_say(name, table):
    """Prevents a wrong pin: on the robot that is a motor that turns the wrong way or a line that fights another output."""
    pins = BOARDS[name]
    if name.endswith("s2"):
        assert {n: tuple(map(pwm, p.channels)) for n, p in pins.motors.items()} == table
    else:
        assert {n: (pwm(p.pwm), legacy(p.a), legacy(p.b), p.polarity) for n, p in pins.motors.items()} == table
    lines = (pins.enable, pins.imu_interrupt, pins.arm_button, pins.mode_button, pins.leds["red"].line, pins.leds["green"].line)
    assert tuple(map(legacy, lines)) == (20, 117, 69, 68, 66, 67)
    assert pins.encoders == ("48300180", "48302180", "48304180") and pins.uart == "481aa000"
    assert (pins.adc["battery"].channel, pins.adc["battery"].ratio) == (6, 11.0)


def test_shipped_dividers_are_those_of_the_shipped_boards():
    """Prevents a battery that reads 0.1 V off because configuration and board disagree."""
    for robot in ("mbbr", "edumip"):
        config = make_config(robot)
        battery = BOARDS[config.board].adc["battery"]
        assert (battery.channel, battery.ratio, battery.offset_v) == (config.battery.adc_channel, config.battery.ratio, config.battery.offset_v)


# -- truth tables ----------------------------------------------------------------------------------------------------
def tb6612(standby, in1, in2, pwm_level):
    """Outputs by the data sheet's control table; None is high impedance."""
    if not standby or (in1, in2) == (0, 0):
        return None, None
    if (in1, in2) == (1, 1) or not pwm_level:
        return 0, 0
    return in1, in2


def mc33926(enable, d1, d2, in1, in2):
    """Outputs by the data sheet's truth table."""
    return (None, None) if not enable or d1 or not d2 else (in1, in2)


def outputs(kernel, name, number):
    """(outputs, share of time) in both parts of a PWM period."""
    pins = BOARDS[name]
    pin = pins.motors[number]
    high = kernel.sysfs.duty_ns(*pin.pwm) / PERIOD
    enable = kernel.gpio.line_value(GPIO[pins.enable[0]], pins.enable[1])
    a, b = (line and kernel.gpio.line_value(GPIO[line[0]], line[1]) for line in (pin.a, pin.b))
    if pins.driver == "tb6612":
        return [(tb6612(enable, a, b, level), share) for level, share in ((1, high), (0, 1 - high))]
    if pins.driver == "mc33926-s1":
        return [(mc33926(enable, 0, level, a, b), share) for level, share in ((1, high), (0, 1 - high))]
    if pins.driver == "mc33926-s3":
        return [(mc33926(enable, 0, 1, level, b), share) for level, share in ((1, high), (0, 1 - high))]
    back = kernel.sysfs.duty_ns(*pin.pwm_back) / PERIOD
    assert min(high, back) == 0.0  # never both
    return [(mc33926(enable, 0, 1, 1, 0), high), (mc33926(enable, 0, 1, 0, 1), back), (mc33926(enable, 0, 1, 0, 0), 1 - high - back)]


def effect(kernel, name, number):
    """(mean drive, "brake", "coast" or "off" for the rest of the period), signed as the board's polarity has it."""
    drive, rest = 0.0, "none"
    for (out1, out2), share in outputs(kernel, name, number):
        if share <= 1e-12:
            continue
        if out1 is None:
            rest = "coast"
        elif out1 == out2:
            rest = "brake"
        else:
            drive += share * (out1 - out2)
    return round(drive * BOARDS[name].motors[number].polarity, 9), rest


@pytest.mark.parametrize("name", list(BOARDS))
def test_truth_tables(tmp_path, name):
    """Prevents a bridge that turns backwards, brakes where the model says coast, or turns at a command of 0: by each chip's own table."""
    kernel = Kernel(tmp_path, name=name)
    motors = started_motors(kernel, name, (1, 2, 3))
    assert {effect(kernel, name, n)[0] for n in (1, 2, 3)} == {0.0}
    assert motors.enable() and {effect(kernel, name, n)[0] for n in (1, 2, 3)} == {0.0}
    rest = BOARDS[name].bridge.off_time
    pulses = [(10000, -20000, 0), (-10000, 20000, 5000), (-1, 0, -PERIOD), (0, 0, 0), (PERIOD, -PERIOD, 1), (-PERIOD, PERIOD, -1)]
    for wanted in pulses:
        assert write(motors, *wanted)
        for number, pulse in zip((1, 2, 3), wanted):
            assert effect(kernel, name, number) == (pytest.approx(pulse / PERIOD), "none" if abs(pulse) == PERIOD else effect(kernel, name, number)[1])
            if 0 < abs(pulse) < PERIOD:
                assert effect(kernel, name, number)[1] == rest
    motors.off()
    for line in (BOARDS[name].enable,):
        assert kernel.gpio.line_value(GPIO[line[0]], line[1]) == 0
    assert {effect(kernel, name, n) for n in (1, 2, 3)} <= {(0.0, "coast")}
    assert motors.enable() and {effect(kernel, name, n)[0] for n in (1, 2, 3)} == {0.0}  # also after a backward pulse
    motors.close()
    kernel.sysfs.service()
    assert kernel.sysfs.violations == []


@pytest.mark.parametrize("name", list(BOARDS))
def test_switching_off_never_drives_even_while_the_enable_line_is_still_high(tmp_path, name):
    """Prevents the mirrored wiring (S3) from turning a backward motor at full power until the guard has dropped the line."""
    kernel = Kernel(tmp_path, name=name)
    motors = started_motors(kernel, name, (1, 2, 3))
    motors.enable()
    write(motors, -10000, 10000, -40000)
    motors._enable.set = lambda on: None  # a guard that has not come to it yet
    motors.off()
    assert [effect(kernel, name, n)[0] for n in (1, 2, 3)] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("first", [30000, -30000])
@pytest.mark.parametrize("name", list(BOARDS))
def test_a_reversal_never_drives_the_old_way_while_the_lines_change(tmp_path, name, first):
    """Prevents a kick in the wrong direction: between the two writes of a reversal the bridge rests or drives the new way."""
    kernel = Kernel(tmp_path, name=name)
    motors = started_motors(kernel, name, (1, 2, 3))
    motors.enable()
    write(motors, first, first, first)
    seen, whole = [], kernel.gpio.ioctl

    def watch(*arguments):
        seen.append(effect(kernel, name, 1)[0])
        answer = whole(*arguments)
        seen.append(effect(kernel, name, 1)[0])
        return answer

    kernel.ioctl = watch
    write(motors, -first, -first, -first)
    assert all(drive * first <= 0 for drive in seen) and effect(kernel, name, 1)[0] * first < 0
    assert len(seen) > 0 or BOARDS[name].bridge.scheme == "two-pwm"


@pytest.mark.parametrize("name", MC33926)
def test_a_driver_is_not_given_a_faster_pwm_than_it_takes(tmp_path, name):
    """Prevents 25 kHz on an MC33926, which takes 20 kHz."""
    kernel = Kernel(tmp_path, name=name)
    with pytest.raises(MotorError, match="20 kHz") as caught:
        Motors(kernel, BOARDS[name], (1, 2, 3), 40000, DirectEnable(kernel))
    assert caught.value.code == "pwm_too_fast"
    with pytest.raises(ConfigError, match="motor.pwm_frequency_hz"):
        make_config(board=name, motors__channels="[1, 2, 3]", motor__pwm_frequency_hz="25 kHz")


def test_an_output_that_the_board_does_not_have_is_named(tmp_path):
    """Prevents a KeyError: a bare board has three outputs, the cape four."""
    with pytest.raises(ConfigError, match="motor output 4"):
        make_config(board="beaglebone-black-mc33926")
    kernel = Kernel(tmp_path)
    with pytest.raises(MotorError, match="it has 1, 2, 3") as caught:
        Motors(kernel, BOARDS["beaglebone-black-mc33926"], (1, 3, 4), PERIOD, DirectEnable(kernel))
    assert caught.value.code == "motor_output"


# -- tables as files -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gpio3_21", "gpio4_1", "imu_interrupt: 'gpio4_1' is no line"),
        ("gpio3_21", "gpio2_5", "arm_button: the pin serves imu_interrupt already"),
        ("line: gpio2_2", "line: gpio2_9", "leds: red: the pin serves motors: 3 already"),
        ("line: gpio2_2", "line: gpio0_20", "leds: red: the pin serves enable already"),
        ("ehrpwm1A", "ehrpwm1C", "motors: 1: pwm: 'ehrpwm1C' is no PWM"),
        ("polarity: -1", "polarity: 2", "polarity is 1 or -1"),
        ("driver: tb6612", "driver: l298", "driver: 'l298' is none of"),
        ("driver: tb6612", "driver: mc33926-s2", "has pwm_back beside pwm, not a, b"),
        ("uart: uart5", "uart: uart9", "is none of uart0 to uart5"),
        ("uart: uart5", "usrt: uart5", "'usrt' is no key of a board"),
        ("mode_button: gpio2_4", "", "'mode_button' is missing"),
        ("motors:", "motors: [", "is not valid"),
    ],
)
def test_a_wrong_table_is_refused_with_its_key(old, new, words):
    """Prevents a typing error in a table from becoming a pin."""
    text = (Path(boards.__file__).parents[2] / "config/boards/beaglebone-blue.yaml").read_text()
    with pytest.raises(ConfigError, match=words) as caught:
        board_table.parse(text.replace(old, new, 1), "trial")
    assert caught.value.code == "board_table"


# -- nine trees ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("generation", "name"), list(itertools.product(GENERATIONS, THREE)))
def test_every_board_is_found_on_every_kernel(tmp_path, generation, name):
    """Prevents a driver that relies on a number: every chip is found by its address, in trees whose numbers all differ."""
    kernel = Kernel(tmp_path, GENERATIONS[generation].gpio_abi, name=name, generation=generation)
    assert boards.board("auto", kernel) is BOARDS[name] and boards.loaded_overlays(kernel) == (BOARDS[name].overlay,)
    assert boards.serial_device("auto", BOARDS[name], kernel) == str(tmp_path / "dev/ttyS5")
    for index, address in enumerate(BOARDS[name].encoders):
        encoder = Encoder(kernel, address)
        encoder.start()
        kernel.sysfs.set_count(index, 10 + index)
        assert encoder.read() == 10 + index and encoder.interface == GENERATIONS[generation].encoders
        encoder.close()


@pytest.mark.parametrize(
    ("generation", "name"), [*itertools.product(GENERATIONS, THREE), ("5.10-ti", MC33926[1]), ("6.12-bone", MC33926[2])]
)
def test_every_board_starts_runs_and_stops_on_every_kernel(tmp_path, generation, name):
    """Prevents a release that balances on one image only: discovery, start, run and stop in the nine trees, and in two further wirings."""
    channels = "[1, 2, 3]" if "mc33926" in name else "[1, 3, 4]"
    config = make_config(board=name, motors__channels=channels, dry_run__kernel=generation, estimator__shadows="[]")
    with DryRun(tmp_path, config) as dry:
        kernel, devices, pins = dry.bench.kernel, dry.session.devices, dry.bench.machine.pins
        assert pins is BOARDS[name] and kernel.sysfs.generation == GENERATIONS[generation]
        dry.until(lambda: dry.state is State.BALANCING)
        seconds = dry.until(lambda: dry.row["tick"] > 900)
        assert seconds > 0.5 and dry.state is State.BALANCING and dry.motors_on() and devices.motors.errors == 0
        assert all(counter.errors == 0 for counter in devices.encoders) and devices.battery_v == pytest.approx(7.9, abs=0.5)
        assert lamps(kernel, pins) == {"red": 0, "green": 1}
        dry.session.run(0.1, SimpleNamespace(requested=True), None, False)
        assert lamps(kernel, pins) == {"red": 0, "green": 0}
        assert kernel.gpio.line_value(GPIO[pins.enable[0]], pins.enable[1]) == 0 and not dry.motors_on()
        kernel.sysfs.service()
        assert kernel.sysfs.violations == []


def lamps(kernel, pins):
    found = {}
    for colour, led in pins.leds.items():
        file = kernel.root / "sys/class/leds" / led.name / "brightness"
        found[colour] = int(file.read_text()) if file.exists() else kernel.gpio.line_value(GPIO[led.line[0]], led.line[1])
    return found


@pytest.mark.parametrize("generation", GENERATIONS)
def test_stock_trees_hold_the_traps(tmp_path, generation):
    """Prevents fakes that are kinder than an image is: without the overlay there is no PWM, or the IMU belongs to the kernel."""
    blue, black = (
        Kernel(tmp_path / name, name=name, generation=generation, stock=True) for name in ("beaglebone-blue", "beaglebone-black-cape")
    )
    bound = os.path.realpath(blue.path("sys/bus/i2c/devices/2-0068/driver")).endswith("inv-mpu6050-i2c")
    assert bound is (generation != "4.19-ti") and boards.board("auto", black).name == "beaglebone-black-cape"
    for kernel in (blue, black):
        if kernel is blue and generation != "6.12-bone":
            started_motors(kernel, "beaglebone-blue")
        else:
            with pytest.raises(MotorError, match="overlay"):
                started_motors(kernel)
    if bound:
        with pytest.raises(GpioError, match="busy") as caught:
            from mip_rt.hardware.input_events import InputEvents

            InputEvents(blue, GPIO[3], 21, "falling", "test")
        assert caught.value.cure
    with pytest.raises(HardwareError, match="481aa000"):
        boards.serial_device("auto", BOARDS["beaglebone-black-cape"], black)


def test_another_overlay_means_another_board(tmp_path):
    """Prevents `board: auto` from taking a bare board for one with a cape."""
    kernel = Kernel(tmp_path, name="beaglebone-black-mc33926-s2")
    assert boards.board("auto", kernel).name == "beaglebone-black-mc33926-s2"


# -- lamps -----------------------------------------------------------------------------------------------------------
def test_lamps_that_are_taken_are_noted_and_nothing_else(tmp_path):
    """Prevents a robot that does not start for want of a lamp."""
    kernel = Kernel(tmp_path)
    kernel.gpio._held = {(GPIO[2], 2)}
    leds = Leds(kernel, BOARDS["beaglebone-black-cape"].leds)
    assert len(leds.problems) == 1 and "red" in leds.problems[0]
    leds.show(True)
    assert lamps(kernel, BOARDS["beaglebone-black-cape"]) == {"red": 0, "green": 1} and leds.errors == 0
    leds.close()


def test_a_lamp_that_fails_later_never_raises(tmp_path):
    """Prevents an exception in the loop's slack work."""
    kernel = Kernel(tmp_path, name="beaglebone-blue")
    leds = Leds(kernel, BOARDS["beaglebone-blue"].leds)
    leds.show(False)
    assert lamps(kernel, BOARDS["beaglebone-blue"]) == {"red": 1, "green": 0}
    os.close(leds._lamps["red"]._fd)
    leds.show(True)
    leds.show(True)
    assert leds.errors == 1
    leds.close()
    assert leds.errors == 2
