"""The IMU's bus: device, kernel driver in the way, answer, clock measured by transfer time, what a tick costs."""

import os
import statistics

from mip_rt.doctor.report import fail, ok
from mip_rt.hardware import i2c_time
from mip_rt.hardware import mpu9250_registers as r
from mip_rt.hardware.bus_errors import explain

SAMPLES = 20
SHORT, LONG = 1, 30  # bytes of the two reads whose difference gives the clock
SLOW_HZ = 300_000
PERIOD_S = 0.005


def examine(patient):
    """Yields the layer's Checks."""
    settings = patient.config.imu
    device = patient.kernel.path(f"dev/i2c-{settings.bus}")
    if not device.exists():
        yield fail("device", f"there is no /dev/i2c-{settings.bus}.", "Enable I2C2 (the project's overlay) and load i2c-dev; see imu.bus.")
        return
    if not os.access(device, os.R_OK | os.W_OK):
        yield fail("device", f"/dev/i2c-{settings.bus} cannot be opened by this user.", "Install the udev rules (tools/install); join the groups i2c and gpio.")
        return
    yield ok("device", f"/dev/i2c-{settings.bus} can be opened.")
    name = f"{settings.bus}-{settings.address:04x}"
    driver = patient.kernel.path(f"sys/bus/i2c/devices/{name}/driver")
    if os.path.lexists(driver):
        module = os.path.basename(os.path.realpath(driver))
        yield fail("driver", f"the kernel's {module} holds the IMU and its interrupt.",
                   f"echo {name} | sudo tee /sys/bus/i2c/drivers/{module}/unbind; for good: blacklist inv_mpu6050_i2c in /etc/modprobe.d (tools/install does it).")  # fmt: skip
    else:
        yield ok("driver", "no kernel driver holds the IMU.")
    try:
        bus = patient.kernel.open_i2c(settings.bus)
    except OSError as error:
        yield fail("answer", f"the bus cannot be opened: {error.strerror}.", "Join the groups i2c and gpio.")
        return
    try:
        yield from _ask(patient, bus, settings)
    finally:
        bus.close()


def _read(bus, address, register, length) -> bytes:
    from smbus2 import i2c_msg

    reply = i2c_msg.read(address, length)
    bus.i2c_rdwr(i2c_msg.write(address, [register]), reply)
    return bytes(reply)


def _ask(patient, bus, settings):
    try:
        identity = _read(bus, settings.address, r.WHO_AM_I, 1)[0]
    except OSError as error:
        words, cure = explain(error)
        yield fail("answer", f"address 0x{settings.address:02x} on bus {settings.bus}: {words}.{_elsewhere(patient, settings)}", cure)
        return
    chip, usable = r.CHIPS.get(identity, ("unknown chip", False))
    if usable:
        yield ok("answer", f"WHO_AM_I at 0x{settings.address:02x} is 0x{identity:02x}: {chip}.")
    else:
        yield fail("answer", f"WHO_AM_I is 0x{identity:02x} ({chip}), not an MPU-9250, MPU-9255 or MPU-6500.", "Use another IMU, or check imu.address.")
    try:
        clock_hz = _clock_hz(patient.kernel, bus, settings.address)
    except OSError as error:
        words, cure = explain(error)
        yield fail("clock", f"a read of {LONG} bytes failed: {words}.", cure)
        return
    patient.notes["bus_hz"] = clock_hz
    attitude = settings.attitude
    cost_s = i2c_time.tick_bits(attitude) / clock_hz
    words = (
        f"a tick's transfers take {i2c_time.tick_bits(attitude) / i2c_time.FAST_HZ * 1e3:.2f} ms of the wire at 400 kHz, "
        f"{cost_s * 1e3:.2f} ms at the measured clock: {cost_s / PERIOD_S:.0%} of a tick "
        f"(DMP {i2c_time.tick_bits('dmp') / clock_hz * 1e3:.2f} ms, raw registers {i2c_time.tick_bits('onboard') / clock_hz * 1e3:.2f} ms)"
    )
    if clock_hz < SLOW_HZ:
        yield fail("clock", f"the bus runs at {clock_hz / 1e3:.0f} kHz; {words}.",
                   "Set I2C2 to 400 kHz: the project's overlay does (or BB-I2C2-FAST-00A0 in /boot/uEnv.txt); reboot.")  # fmt: skip
    else:
        yield ok("clock", f"{clock_hz / 1e3:.0f} kHz, measured; {words}.")


def _elsewhere(patient, settings) -> str:
    for other in (1, 2):
        if other == settings.bus or not patient.kernel.path(f"dev/i2c-{other}").exists():
            continue
        try:
            bus = patient.kernel.open_i2c(other)
        except OSError:
            continue
        try:
            _read(bus, settings.address, r.WHO_AM_I, 1)
            return f" On bus {other} a chip answers: imu.bus may be wrong."
        except OSError:
            pass
        finally:
            bus.close()
    return ""


def _clock_hz(kernel, bus, address) -> float:
    """The difference between a long and a short read has no overhead of the kernel in it, only bytes of nine bits."""
    spent = {SHORT: [], LONG: []}
    for _ in range(SAMPLES):
        for length, times in spent.items():
            begin = kernel.monotonic_ns()
            _read(bus, address, r.ACCEL_XOUT_H, length)
            times.append(kernel.monotonic_ns() - begin)
    short, long = (min(statistics.median(times), sorted(times)[len(times) // 4]) for times in spent.values())
    return 9 * (LONG - SHORT) / max(long - short, 1) * 1e9
