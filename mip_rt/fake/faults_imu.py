"""Faults of the IMU: its bus, its interrupt line, its FIFO, and what it measures. See `faults` for the table."""

import ctypes
import errno
import math
import struct

from mip_rt.fake.i2c_bus import I2C_READ
from mip_rt.hardware import mpu9250_registers as r

_AXES = {"x": 0, "y": 2, "z": 4}
_ACCELEROMETER, _GYRO = 16, 22  # places in the packet
_ONES = b"\xff" * r.PACKET_BYTES
_QUATERNION = struct.Struct(">4i")


# -- I2C ---------------------------------------------------------------------------------------------------------------
def _refuse(injector, fault, number: int, wait_s: float = 0.0):
    def transfer(call, *messages):
        if not fault.strikes():
            return call(*messages)
        if wait_s:
            injector.stall(wait_s)
        raise OSError(number, "injected")

    return injector.taps.add(injector.bench.kernel.bus, "i2c_rdwr", transfer)


def i2c_nack(injector, fault):
    """EREMOTEIO."""
    return _refuse(injector, fault, errno.EREMOTEIO)


def i2c_error(injector, fault):
    """EIO, EAGAIN or EBUSY."""
    return _refuse(injector, fault, getattr(errno, fault.p.error))


def i2c_timeout(injector, fault):
    """ETIMEDOUT after a wait; i2c-omap waits a whole second."""
    return _refuse(injector, fault, errno.ETIMEDOUT, fault.p.wait_s)


def i2c_lost_once(injector, fault):
    """The next few transfers fail; then the filter takes itself away."""

    def transfer(call, *messages):
        fault.hits += 1
        if fault.hits >= fault.p.count:
            remove()
        raise OSError(errno.EREMOTEIO, "injected")

    remove = injector.taps.add(injector.bench.kernel.bus, "i2c_rdwr", transfer)


def _damage(injector, fault, change):
    def transfer(call, *messages):
        call(*messages)
        if not fault.strikes():
            return
        for message in messages:
            if message.flags & I2C_READ:
                data = bytearray(ctypes.string_at(message.buf, message.len))
                change(data)
                ctypes.memmove(message.buf, bytes(data), len(data))

    return injector.taps.add(injector.bench.kernel.bus, "i2c_rdwr", transfer)


def i2c_bit_flips(injector, fault):
    """Flips bits of each read."""

    def change(data):
        for _ in range(fault.p.bits):
            at = fault.random.randrange(8 * len(data))
            data[at // 8] ^= 1 << at % 8

    return _damage(injector, fault, change)


def i2c_short_read(injector, fault):
    """From a random byte on the bus is released: ones."""

    def change(data):
        at = fault.random.randrange(len(data))
        data[at:] = b"\xff" * (len(data) - at)

    return _damage(injector, fault, change)


# -- interrupt line ----------------------------------------------------------------------------------------------------
def _edges(injector, on_edge):
    line = tuple(injector.bench.kernel.imu_line)

    def push(call, address, offset, timestamp_ns, edge):
        if (address, offset) != line:
            return call(address, offset, timestamp_ns, edge)
        return on_edge(lambda later_ns=0: call(address, offset, timestamp_ns + later_ns, edge), timestamp_ns)

    return injector.taps.add(injector.bench.kernel.gpio, "push_edge", push)


def interrupt_lost(injector, fault):
    """The edge does not arrive."""
    return _edges(injector, lambda push, _: False if fault.strikes() else push())


interrupt_lost_some = interrupt_lost


def interrupt_doubled(injector, fault):
    """Another edge 20 microseconds later."""

    def on_edge(push, _):
        pushed = push()
        if fault.strikes():
            push(20_000)
        return pushed

    return _edges(injector, on_edge)


def interrupt_late(injector, fault):
    """The edge has its right timestamp, but the loop hears of it later."""

    def on_edge(push, timestamp_ns):
        if fault.strikes():
            injector.bench.kernel.wait_until(timestamp_ns + round(fault.p.delay_s * 1e9))
        return push()

    return _edges(injector, on_edge)


# -- FIFO --------------------------------------------------------------------------------------------------------------
def fifo_overflow(injector, fault):
    """Old packets fill the FIFO: 31 of them, the next sample is the 32nd."""
    fault.hits += 1
    injector.bench.kernel.chip.fifo[:] = bytes(injector.bench.world.packet) * (r.FIFO_BYTES // r.PACKET_BYTES - 1)


def fifo_misaligned(injector, fault):
    """Stray bytes, as after a reset in the middle of a packet."""
    fault.hits += 1
    injector.bench.kernel.chip.fifo += fault.random.randbytes(fault.p.bytes)


# -- what the chip measures --------------------------------------------------------------------------------------------
def _packets(injector, change):
    """`change(packet)` returns another packet, or the same; without the DMP the registers become what the packet's words become."""
    chip = injector.bench.kernel.chip

    def sample(call, packet, raw):
        changed = bytes(change(packet))
        if not chip.dmp_runs:
            raw = changed[_ACCELEROMETER:_GYRO] + bytes(raw[6:8]) + changed[_GYRO : _GYRO + 6]
        return call(changed, raw)

    return injector.taps.add(chip, "sample", sample)


def imu_silent(injector, fault):
    """Neither interrupt nor packet."""

    def sample(call, packet, raw):
        fault.hits += 1
        return False

    return injector.taps.add(injector.bench.kernel.chip, "sample", sample)


def imu_dropped(injector, fault):
    """The interrupt comes, its packet is not in the FIFO."""
    chip = injector.bench.kernel.chip

    def sample(call, packet, raw):
        before = len(chip.fifo)
        fell = call(packet, raw)
        if fault.strikes():
            del chip.fifo[before:]
            chip.registers[r.INT_STATUS] &= ~r.INT_RAW_READY
        return fell

    return injector.taps.add(chip, "sample", sample)


imu_dropped_some = imu_dropped


def imu_frozen(injector, fault):
    """The packet of the first moment."""
    first = []

    def change(packet):
        if not first:
            first.append(bytes(packet))
        fault.hits += 1
        return first[0]

    return _packets(injector, change)


def quaternion_zero(injector, fault):
    """Four zeros."""
    return _packets(injector, lambda packet: b"\0" * 16 + bytes(packet[16:]) if fault.strikes() else packet)


def quaternion_ones(injector, fault):
    """32 bytes of 0xff."""
    return _packets(injector, lambda packet: _ONES if fault.strikes() else packet)


def packet_noise(injector, fault):
    """32 random bytes."""
    return _packets(injector, lambda packet: fault.random.randbytes(r.PACKET_BYTES) if fault.strikes() else packet)


def attitude_jump(injector, fault):
    """The quaternion is turned about a random level axis; its norm stays 1."""
    half = 0.5 * fault.p.angle_rad

    def change(packet):
        if not fault.strikes():
            return packet
        a, b, c, d = _QUATERNION.unpack_from(packet)
        heading = fault.random.uniform(0.0, 2.0 * math.pi)
        w, x, y = math.cos(half), math.sin(half) * math.cos(heading), math.sin(half) * math.sin(heading)
        turned = (a * w - b * x - c * y, a * x + b * w - d * y, a * y + c * w + d * x, b * y - c * x + d * w)
        limit = (1 << 31) - 1
        return _QUATERNION.pack(*(max(-limit, min(limit, round(v))) for v in turned)) + bytes(packet[16:])

    return _packets(injector, change)


def _word(packet, at: int, counts: float) -> bytes:
    changed = bytearray(packet)
    (value,) = struct.unpack_from(">h", changed, at)
    struct.pack_into(">h", changed, at, max(-32768, min(32767, value + round(counts))))
    return bytes(changed)


def _gyro_counts(injector, fault) -> float:
    return fault.p.size_rad_s * float(injector.bench.world.parameters[0].gyro_count_per_rad_s)


def _accelerometer_counts(injector, fault) -> float:
    return fault.p.size_m_s2 * float(injector.bench.world.parameters[0].accel_count_per_m_s2)


def gyro_spike(injector, fault):
    """Single rates."""
    at, counts = _GYRO + _AXES[fault.p.axis], _gyro_counts(injector, fault)
    return _packets(injector, lambda packet: _word(packet, at, counts) if fault.strikes() else packet)


def gyro_bias(injector, fault):
    """All rates."""
    fault.hits += 1
    at, counts = _GYRO + _AXES[fault.p.axis], _gyro_counts(injector, fault)
    return _packets(injector, lambda packet: _word(packet, at, counts))


def accel_spike(injector, fault):
    """Single accelerations."""
    at, counts = _ACCELEROMETER + _AXES[fault.p.axis], _accelerometer_counts(injector, fault)
    return _packets(injector, lambda packet: _word(packet, at, counts) if fault.strikes() else packet)


def accel_bias(injector, fault):
    """All accelerations."""
    fault.hits += 1
    at, counts = _ACCELEROMETER + _AXES[fault.p.axis], _accelerometer_counts(injector, fault)
    return _packets(injector, lambda packet: _word(packet, at, counts))
