"""The usual read of the IMU, compiled: one packet waits, the bus obeys, the packet is good. Everything else is its driver's business.

In Python the same took 7,000 ARM instructions a tick.
"""

import sys

import numpy as np

from mip_rt.compiled import entry, njit, records_at
from mip_rt.hardware import packet_check
from mip_rt.hardware import mpu9250_registers as r
from mip_rt.hardware.imu_status import IMU_BAD_NORM, IMU_FROZEN, IMU_OK
from mip_rt.hardware.transfers import transfer

ONE_PACKET = r.PACKET_BYTES if sys.byteorder == "big" else r.PACKET_BYTES << 8  # the big-endian count as this machine reads it
OTHER_COUNT = 0  # answer of `usual`: not one packet waits, or this driver has no usual read

READ = np.dtype(
    [
        ("function", "u8"),  # see transfers.Entry; 0: no usual read
        ("bus", "u8"),
        ("count", "u8"),  # handle of the transfer that brings the FIFO's count
        ("fifo", "u8"),  # handle of that which brings one packet
        ("count_at", "u8"),  # address of the count's two bytes
        ("packet_at", "u8"),
        ("check_at", "u8"),  # of a packet_check.STATE
    ],
    align=True,
)


@njit
def usual(read_at):
    """IMU_OK, IMU_BAD_NORM or IMU_FROZEN where one packet was read; OTHER_COUNT; or minus the errno where the bus refuses.

    Args:
        read_at: address of one READ.
    """
    read = records_at(read_at, 1, READ)[0]
    if read.function == 0:
        return np.int64(OTHER_COUNT)
    refused = transfer(read.function, read.bus, read.count)
    if refused != 0:
        return np.int64(-refused)
    if records_at(read.count_at, 1, np.uint16)[0] != ONE_PACKET:
        return np.int64(OTHER_COUNT)
    refused = transfer(read.function, read.bus, read.fifo)
    if refused != 0:
        return np.int64(-refused)
    found = packet_check.check(np.uintp(read.check_at), np.uintp(read.packet_at))
    if found == packet_check.GOOD:
        return np.int64(IMU_OK)
    return np.int64(IMU_FROZEN if found == packet_check.FROZEN else IMU_BAD_NORM)


@entry("uintp")
def read_usual(read_at):
    """`usual`, for callers in Python."""
    return usual(read_at)
