"""Encoders, PWM, motors, GPIO, battery and serial port against the fake tree, in every kernel generation that the fakes know."""

import itertools
import math
import os
from types import SimpleNamespace

import pytest
from board import PERIOD, DirectEnable, Kernel, started_motors, write

from mip_rt.errors import EncoderError, GpioError, HardwareError, MotorError, RemoteError
from mip_rt.fake.gpio import FakeGpio
from mip_rt.fake.remote import FakeRemote
from mip_rt.fake.sysfs import FakeSysfs, MappedFile
from mip_rt.hardware.battery import Battery
from mip_rt.hardware.boards import BOARDS, EHRPWM, GPIO, board
from mip_rt.hardware.encoders import Encoder
from mip_rt.hardware.gpio import OutputLines
from mip_rt.hardware.input_events import InputEvents
from mip_rt.hardware.motors import Motors
from mip_rt.hardware.serial_port import SerialPort

pytestmark = pytest.mark.armhf


@pytest.fixture(params=itertools.product((1, 2), ("counter", "tieqep"), ("pwmchipK/pwmN", "pwm-K:N")), ids=str)
def kernel(request, tmp_path):
    abi, encoder, naming = request.param
    return Kernel(tmp_path, abi, encoder_interface=encoder, pwm_naming=naming)


@pytest.fixture
def newest(tmp_path):
    return Kernel(tmp_path)


def seen(kernel, channel=1):
    """(duty, line A, line B, enable) of a motor output, as its driver sees them."""
    pin = BOARDS["beaglebone-black-cape"].motors[channel]
    lines = [kernel.gpio.line_value(GPIO[bank], offset) for bank, offset in (pin.a, pin.b, (0, 20))]
    return (kernel.sysfs.duty_ns(*pin.pwm), *lines)


def test_encoder_unwraps_in_both_directions(kernel):
    encoder = Encoder(kernel, "48302180")
    encoder.start()
    total = 0
    for step in (5, -12, 2**30, 2**30, 2**30, 2**30, -(2**31) + 1, -(2**30), -(2**30), -(2**30) - 7):
        total += step
        kernel.sysfs.set_count(1, total)
        assert encoder.read() == total
    assert encoder.errors == 0
    encoder.close()


def test_encoder_start_sets_the_full_range(newest):
    encoder = Encoder(newest, "48300180")
    encoder.start()
    folder = newest.root / "sys/bus/counter/devices/counter2/count0"
    assert (folder / "ceiling").read_text().strip() == "4294967295"
    assert (folder / "function").read_text().strip() == "quadrature x4" and (folder / "enable").read_text().strip() == "1"


def test_encoder_keeps_its_last_count_when_reading_fails(newest):
    encoder = Encoder(newest, "48300180")
    encoder.start()
    newest.sysfs.set_count(0, 123)
    assert encoder.read() == 123
    newest.sysfs.counts[0].put(b"nonsense\n")
    assert encoder.read() == 123 and encoder.errors == 1


def test_missing_encoder_has_a_cure(newest):
    with pytest.raises(EncoderError, match="48309999") as caught:
        Encoder(newest, "48309999")
    assert "overlay" in caught.value.cure


def test_motors_start_off(kernel):
    motors = started_motors(kernel)
    assert [seen(kernel, channel)[0] for channel in (1, 3, 4)] == [0, 0, 0] and seen(kernel)[3] == 0
    assert kernel.sysfs.violations == [] and not motors.enabled


def test_motors_drive_forward_backward_and_stop(kernel):
    motors = started_motors(kernel)
    assert motors.enable() and write(motors, 12345, 777, 0)
    assert [seen(kernel, channel)[:3] for channel in (1, 3, 4)] == [(12345, 1, 0), (777, 0, 1), (0, 0, 0)]  # output 3 is reversed
    assert write(motors, 5, -7, PERIOD * 2)  # shorter numbers over longer ones, and a clipped one
    assert [seen(kernel, channel)[0] for channel in (1, 3, 4)] == [5, 7, PERIOD]
    motors.off()
    assert [seen(kernel, channel)[0] for channel in (1, 3, 4)] == [0, 0, 0] and seen(kernel)[3] == 0
    kernel.sysfs.service()
    assert kernel.sysfs.violations == []


def test_reversal_takes_the_pulse_away_first(newest):
    motors = started_motors(newest)
    motors.enable()
    write(motors, 40000, 0, 0)
    order = []
    whole = newest.gpio.ioctl

    def watch(fd, request, argument, mutate=True):
        order.append(seen(newest)[0])
        return whole(fd, request, argument, mutate)

    newest.ioctl = watch
    write(motors, -40000, 0, 0)
    assert order and set(order) == {0} and seen(newest) == (40000, 0, 1, 1)


def test_equal_duties_are_not_written_again(newest):
    motors = started_motors(newest)
    motors.enable()
    write(motors, 100, 200, 300)
    files = [channel.folder / "duty_cycle" for channel in motors._pwm]
    for file in files:
        file.write_text("untouched\n")
    write(motors, 100, 201, 300)
    assert [file.read_text()[:9] for file in files] == ["untouched", "201\nuched", "untouched"]


def test_off_does_every_part_whatever_fails(newest):
    motors = started_motors(newest)
    motors.enable()
    write(motors, 100, 200, 300)
    os.close(motors._pwm[0].fd)
    motors.off()
    assert motors.errors == 1 and seen(newest, 3)[0] == 0 and seen(newest, 4)[0] == 0 and seen(newest)[3] == 0
    motors._pwm[0]._fd = -1


def test_closing_the_descriptors_drops_the_enable_line(newest):
    motors = started_motors(newest)
    motors.enable()
    assert seen(newest)[3] == 1
    motors._enable.lines.close()  # as the kernel does when its holder dies
    assert seen(newest)[3] == 0


def test_missing_pwm_chip_has_a_cure(tmp_path):
    kernel = Kernel(tmp_path)
    (tmp_path / "sys/class/pwm/pwmchip7").unlink()
    with pytest.raises(MotorError, match=EHRPWM[2]) as caught:
        Motors(kernel, BOARDS["beaglebone-black-cape"], (1, 3, 4), PERIOD, DirectEnable(kernel))
    assert "overlay" in caught.value.cure


def test_events_are_drained_to_the_newest(kernel):
    line = InputEvents(kernel, GPIO[3], 21, "falling", "test")
    assert line.read() is None
    for k in range(3):
        kernel.gpio.push_edge(GPIO[3], 21, 1000 + k, 2)
    assert line.read() == (1002, 2, 3) and line.read() is None
    line.close()
    assert kernel.gpio.push_edge(GPIO[3], 21, 2000, 2) is False


def test_dropped_events_are_counted_by_sequence(newest):
    line = InputEvents(newest, GPIO[3], 21, "falling", "test")
    newest.gpio.push_edge(GPIO[3], 21, 1, 2)
    line.read()
    newest.gpio.events_of(GPIO[3], 21).sequence += 4  # the kernel's buffer ran over
    newest.gpio.push_edge(GPIO[3], 21, 9, 2)
    assert line.read() == (9, 2, 5) and line.missed == 4


def test_what_was_before_the_beginning_is_not_missed(newest):
    """The interrupts of the bring-up, more than the kernel's buffer holds, would make the first tick the hundredth."""
    line = InputEvents(newest, GPIO[3], 21, "falling", "test")
    for moment in (1, 2, 3):
        newest.gpio.push_edge(GPIO[3], 21, moment, 2)
    line.forget()
    newest.gpio.events_of(GPIO[3], 21).sequence += 90
    newest.gpio.push_edge(GPIO[3], 21, 9, 2)
    assert line.read() == (9, 2, 1) and line.missed == 0
    newest.gpio.events_of(GPIO[3], 21).sequence += 1
    newest.gpio.push_edge(GPIO[3], 21, 10, 2)
    assert line.read() == (10, 2, 2) and line.missed == 1


def test_a_taken_line_is_refused_with_a_cure(kernel):
    first = OutputLines(kernel, GPIO[0], (20,), 0, "one")
    with pytest.raises(GpioError) as caught:
        OutputLines(kernel, GPIO[0], (20,), 0, "two")
    assert "Another program" in caught.value.cure
    first.close()
    OutputLines(kernel, GPIO[0], (20,), 1, "two")
    assert kernel.gpio.line_value(GPIO[0], 20) == 1


def test_outputs_of_one_request_are_set_by_mask(kernel):
    lines = OutputLines(kernel, GPIO[2], (8, 9), 0b01, "test")
    lines.set(0b10, 0b10)
    assert [kernel.gpio.line_value(GPIO[2], offset) for offset in (8, 9)] == [1, 1]
    lines.set(0b00, 0b01)
    assert [kernel.gpio.line_value(GPIO[2], offset) for offset in (8, 9)] == [0, 1]


@pytest.mark.parametrize(("raw", "volts"), [("1655\n", 7.9), ("0\n", None), ("abc\n", None), ("4095\n", None), ("\n", None)])
def test_battery_reads_volts_or_nothing(newest, raw, volts):
    settings = SimpleNamespace(adc_channel=6, ratio=11.0, offset_v=-0.1, plausible_v=(5.0, 9.0))
    battery = Battery(newest, settings)
    newest.sysfs.adc[6].put(raw.encode())
    if volts is None:
        assert math.isnan(battery.read()) and battery.errors == 1
    else:
        assert battery.read() == pytest.approx(volts, abs=0.01)


def test_missing_adc_has_a_cure(tmp_path):
    with pytest.raises(HardwareError, match="ADC"):
        Battery(SimpleNamespace(path=tmp_path.joinpath), None)


def test_serial_port_reads_all_that_is_there_and_never_raises():
    remote = FakeRemote()
    port = SerialPort(remote.device, 115200)
    assert port.read() == b""
    remote.send_bytes(b"\x00\x01\x02\r\n\x03\x04\xff")
    assert port.read() == b"\x00\x01\x02\r\n\x03\x04\xff"
    remote.close()
    for _ in range(3):
        assert port.read() == b""
    port.close()


def test_serial_port_refusals():
    with pytest.raises(RemoteError, match="/nowhere"):
        SerialPort("/nowhere", 115200)
    with pytest.raises(RemoteError, match="baud"):
        SerialPort("/dev/null", 12345)


def export(kernel, address, channel, period, enable):
    """A channel as another program, or an earlier run, leaves it."""
    chip = kernel.sysfs._chips[address]
    (chip / "export").write_text(str(channel))
    kernel.sysfs.service()
    folder = kernel.sysfs._channel_folder(address, channel)
    (folder / "period").write_text(f"{period}\n")
    (folder / "enable").write_text(f"{enable}\n")


@pytest.mark.parametrize("running", [0, 1])
def test_periods_of_an_earlier_run_are_forgotten(kernel, running):
    """Prevents a robot that refuses to start after its PWM frequency was changed, or after a kill: the chip's channels share a period."""
    for address in EHRPWM[1:]:
        for channel in (0, 1):
            if (address, channel) != (EHRPWM[1], 1):
                export(kernel, address, channel, 40000, running)
    export(kernel, EHRPWM[1], 1, 40000, 0)  # nobody's, but it stands in the way
    motors = started_motors(kernel)
    assert motors.enable() and write(motors, 1000, 1000, 1000)
    kernel.sysfs.service()
    assert kernel.sysfs.violations == [] and [kernel.sysfs.duty_ns(EHRPWM[2], channel) for channel in (0, 1)] == [1000, 1000]


def test_another_programs_running_channel_is_named(kernel):
    """Prevents an EINVAL without explanation where the sibling channel runs with another period."""
    export(kernel, EHRPWM[1], 1, 40000, 1)
    with pytest.raises(MotorError, match="40000") as caught:
        started_motors(kernel)
    assert caught.value.code == "pwm_shared" and caught.value.cure


def test_auto_board_asks_the_device_tree(tmp_path):
    kernel = SimpleNamespace(path=tmp_path.joinpath)
    with pytest.raises(HardwareError, match="no BeagleBone"):
        board("auto", kernel)
    (tmp_path / "proc/device-tree").mkdir(parents=True)
    (tmp_path / "proc/device-tree/model").write_text("TI AM335x BeagleBone Blue\0")
    assert board("auto", kernel).name == "beaglebone-blue"


def test_mapped_file_has_exact_length(tmp_path):
    mapped = MappedFile(tmp_path / "count", b"0\n")
    for text in (b"4294967295\n", b"7\n", b"-12\n"):
        mapped.put(text)
        assert (tmp_path / "count").read_bytes() == text
