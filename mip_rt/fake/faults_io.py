"""Faults of encoders, motor outputs, battery and remote. See `faults` for the table."""

import errno
import os

import numpy as np

from mip_rt.fake.descriptors import READS_FAIL, WRITES_FAIL, opened, replace
from mip_rt.hardware.gpio import SET_VALUES_V1, SET_VALUES_V2

TEXTS = {"word": b"garbage\n", "empty": b"", "huge": b"9" * 40 + b"\n", "negative": b"-5\n", "binary": b"\xff\x00\xfe\n"}


# -- encoders ----------------------------------------------------------------------------------------------------------
def shift_counts(injector, wheel: int, counts: int) -> None:
    """The shown count of a wheel differs by so much more, for good."""
    offsets = injector.count_offset
    if not offsets:
        offsets.update(dict.fromkeys(range(len(injector.bench.world.counts)), 0))
        injector.taps.add(
            injector.bench.kernel.motor_wiring, "show_encoders", lambda call, shown: call(shown + np.array([offsets[i] for i in range(len(shown))]))
        )
    offsets[wheel] += counts


def _count(injector, wheel: int) -> int:
    return int(injector.bench.world.counts[wheel])


def encoder_stuck(injector, fault):
    """The count that the wheel had; afterwards it goes on from there, as a line that is plugged in again."""
    shift_counts(injector, 0, 0)
    wheel = fault.p.wheel - 1
    held = _count(injector, wheel)

    def show(call, counts):
        fault.hits += 1
        shown = counts.copy()
        shown[wheel] = held
        return call(shown)

    remove = injector.taps.add(injector.bench.kernel.motor_wiring, "show_encoders", show)

    def undo():
        remove()
        shift_counts(injector, wheel, held - _count(injector, wheel))

    return undo


def encoder_jump(injector, fault):
    """Once."""
    fault.hits += 1
    shift_counts(injector, fault.p.wheel - 1, fault.p.counts)


def encoder_sign(injector, fault):
    """Mirrored about the count that the wheel had."""
    shift_counts(injector, 0, 0)
    wheel = fault.p.wheel - 1
    centre = _count(injector, wheel)

    def show(call, counts):
        fault.hits += 1
        shown = counts.copy()
        shown[wheel] = 2 * centre - shown[wheel]
        return call(shown)

    remove = injector.taps.add(injector.bench.kernel.motor_wiring, "show_encoders", show)

    def undo():
        remove()
        shift_counts(injector, wheel, 2 * (centre - _count(injector, wheel)))

    return undo


def encoder_wrap(injector, fault):
    """To `margin` counts before 2^32."""
    fault.hits += 1
    wheel = fault.p.wheel - 1
    shift_counts(injector, wheel, 0)
    shown = _count(injector, wheel) + injector.count_offset[wheel]
    shift_counts(injector, wheel, (1 << 32) - fault.p.margin - shown)


def encoder_error(injector, fault):
    """EIO."""
    fault.hits += 1
    return replace(opened(injector.bench.kernel.motor_wiring.count_file(fault.p.wheel - 1).path, (os.O_RDONLY,)), READS_FAIL, os.O_RDONLY)


def encoder_garbage(injector, fault):
    """The file's content is replaced after each count."""
    wiring = injector.bench.kernel.motor_wiring
    file, text = wiring.count_file(fault.p.wheel - 1), TEXTS[fault.p.text]

    def show(call, counts):
        wiring.forget_shown()  # an empty file has no page to write to until it is made longer
        call(counts)
        fault.hits += 1
        file.put(text)

    remove = injector.taps.add(wiring, "show_encoders", show)

    def undo():
        remove()
        wiring.forget_shown()

    return undo


# -- motors ------------------------------------------------------------------------------------------------------------
def pwm_refused(injector, fault):
    """The duty file's descriptor answers every write with the error; the driver's last duty stays in force, as in the chip."""
    fault.hits += 1
    file = injector.bench.kernel.motor_wiring.duty_file(fault.p.wheel - 1)
    return replace(opened(file.path, (os.O_WRONLY,)) if file else [], WRITES_FAIL[fault.p.error], os.O_WRONLY)


def direction_refused(injector, fault):
    """EIO for every output line but the enable line."""
    kernel = injector.bench.kernel
    enable_line = kernel.motor_wiring.enable_line

    def ioctl(call, fd, request, argument, mutate=True):
        if request in (SET_VALUES_V1, SET_VALUES_V2) and not kernel.gpio.drives(fd, *enable_line):
            fault.hits += 1
            raise OSError(errno.EIO, "injected")
        return call(fd, request, argument, mutate)

    return injector.taps.add(kernel.gpio, "ioctl", ioctl)


# -- battery -----------------------------------------------------------------------------------------------------------
def _show_battery(injector, show):
    """`show(call)` shows something else than the world's reading, now and whenever that would be shown."""
    wiring = injector.bench.kernel.motor_wiring
    remove = injector.taps.add(wiring, "show_battery", lambda call, raw: show(call))
    wiring.show_battery(0)

    def undo():
        remove()
        wiring.show_battery(injector.bench.world.battery_raw)

    return undo


def adc_value(injector, fault):
    """Another reading."""
    fault.hits += 1
    return _show_battery(injector, lambda call: call(fault.p.raw))


def adc_garbage(injector, fault):
    """Another text."""
    fault.hits += 1
    file = injector.bench.kernel.motor_wiring.battery_file
    return _show_battery(injector, lambda call: file.put(TEXTS[fault.p.text]))


def adc_error(injector, fault):
    """EIO."""
    fault.hits += 1
    return replace(opened(injector.bench.kernel.motor_wiring.battery_file.path, (os.O_RDONLY,)), READS_FAIL, os.O_RDONLY)


# -- remote ------------------------------------------------------------------------------------------------------------
def _serial(injector, send):
    """`send(call, data)` in the place of sending data."""
    return injector.taps.add(injector.bench.remote, "send_bytes", send)


def serial_lost(injector, fault):
    """Whole frames."""
    return _serial(injector, lambda call, data: None if fault.strikes() else call(data))


def serial_silent(injector, fault):
    """All of them; the pty stays open."""

    def send(call, data):
        fault.hits += 1

    return _serial(injector, send)


def serial_split(injector, fault):
    """A random part of what waits is sent, the rest waits; nothing is lost."""
    waiting = bytearray()

    def send(call, data):
        waiting.extend(data)
        fault.hits += 1
        count = fault.random.randint(0, len(waiting))
        call(bytes(waiting[:count]))
        del waiting[:count]

    remove = _serial(injector, send)

    def undo():
        remove()
        injector.bench.remote.send_bytes(bytes(waiting))

    return undo


def serial_bits(injector, fault):
    """One bit of a frame."""

    def send(call, data):
        if data and fault.strikes():  # split frames may be empty
            changed = bytearray(data)
            at = fault.random.randrange(8 * len(changed))
            changed[at // 8] ^= 1 << at % 8
            data = bytes(changed)
        call(data)

    return _serial(injector, send)


def serial_garbage(injector, fault):
    """Random bytes in the place of a frame."""
    return _serial(injector, lambda call, data: call(fault.random.randbytes(fault.p.bytes) if fault.strikes() else data))


def serial_replayed(injector, fault):
    """The first frame of its time, whatever the sticks do."""
    first = []

    def send(call, data):
        first.append(data)
        fault.hits += 1
        call(first[0])

    return _serial(injector, send)


def serial_error(injector, fault):
    """EIO, as when the device is unplugged."""
    fault.hits += 1
    return replace(opened(injector.bench.remote.device, (os.O_RDWR,)), READS_FAIL, os.O_RDWR)
