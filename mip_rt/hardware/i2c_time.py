"""How long transfers take on the wire: nine bits a byte (eight and the acknowledgement), start, stop, repeated start.

Source: UM10204, the I2C bus specification. What the kernel needs around them comes on top, and is measured by `mip-rt bench board`.
"""

from mip_rt.hardware import mpu9250_registers as r

FAST_HZ, STANDARD_HZ = 400_000, 100_000
RAW_PACKET = 15  # INT_STATUS, accelerometer, temperature, gyro


def write_bits(length: int) -> int:
    """Of a write of `length` data bytes to a register: address, register, data."""
    return 9 * (2 + length) + 2


def read_bits(length: int) -> int:
    """Of a combined read of `length` bytes from a register: address, register, address again, data."""
    return 9 * (3 + length) + 3


def tick_bits(attitude: str = "dmp") -> int:
    """Of a tick: FIFO count and one packet of the DMP, or one burst of the raw registers."""
    return read_bits(2) + read_bits(r.PACKET_BYTES) if attitude == "dmp" else read_bits(RAW_PACKET)
