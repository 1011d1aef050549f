"""GPIO lines by the character device: how they are requested, and outputs that fall when the process dies.

The second version of the ABI (Linux 5.10 and later) is used, the first where the second is refused. A line is named by the address of
its bank and its offset, because chip numbers and labels are not stable.

Source: include/uapi/linux/gpio.h.
"""

import errno
import os
import struct
from pathlib import Path

from mip_rt.errors import GpioError
from mip_rt.hardware.sysfs import find_by_address

GET_LINE_V2, SET_VALUES_V2, GET_VALUES_V2 = 0xC250B407, 0xC010B40F, 0xC010B40E
GET_LINEHANDLE_V1, GET_LINEEVENT_V1, SET_VALUES_V1, GET_VALUES_V1 = 0xC16CB403, 0xC030B404, 0xC040B409, 0xC040B408
INPUT, OUTPUT, EDGE_RISING, EDGE_FALLING = 0x4, 0x8, 0x10, 0x20
EDGES = {"rising": EDGE_RISING, "falling": EDGE_FALLING, "both": EDGE_RISING | EDGE_FALLING}
EVENT_V2 = struct.Struct("<QIIII24x")
EVENT_V1 = struct.Struct("<QIxxxx")
_VALUES = struct.Struct("<QQ")


def find_chip(kernel, address: str) -> Path:
    """/dev/gpiochipK of the bank at this device address; GpioError where there is none."""
    entry = find_by_address(kernel.path("sys/bus/gpio/devices"), "gpiochip*", address)
    if entry is None:
        raise GpioError(f"no GPIO chip at {address}.", "Is this the right board? Run mip-rt doctor.", "gpio_chip")
    return kernel.path("dev", entry.name)


def _request_v2(kernel, chip_fd, offsets, flags, consumer, values, buffered):
    request = bytearray(592)
    struct.pack_into(f"<{len(offsets)}I", request, 0, *offsets)
    request[256 : 256 + len(consumer)] = consumer
    if flags & OUTPUT:
        struct.pack_into("<QI", request, 288, flags, 1)
        struct.pack_into("<IIQQ", request, 320, 2, 0, values, (1 << len(offsets)) - 1)
    else:
        struct.pack_into("<QI", request, 288, flags, 0)
    struct.pack_into("<II", request, 560, len(offsets), buffered)
    kernel.ioctl(chip_fd, GET_LINE_V2, request)
    return struct.unpack_from("<i", request, 588)[0]


def _request_v1(kernel, chip_fd, offsets, flags, consumer, values):
    if flags & INPUT:
        request = bytearray(48)
        struct.pack_into("<III", request, 0, offsets[0], 1, (flags >> 4) & 3)
        request[12 : 12 + len(consumer)] = consumer
        kernel.ioctl(chip_fd, GET_LINEEVENT_V1, request)
        return struct.unpack_from("<i", request, 44)[0]
    request = bytearray(364)
    struct.pack_into(f"<{len(offsets)}I", request, 0, *offsets)
    struct.pack_into("<I", request, 256, 2)
    for i in range(len(offsets)):
        request[260 + i] = (values >> i) & 1
    request[324 : 324 + len(consumer)] = consumer
    struct.pack_into("<I", request, 356, len(offsets))
    kernel.ioctl(chip_fd, GET_LINEHANDLE_V1, request)
    return struct.unpack_from("<i", request, 360)[0]


def request_lines(kernel, address, offsets, flags, consumer, values=0, buffered=0):
    """(fd, version of the interface) of lines of one bank; of their events the kernel keeps `buffered`.

    Raises:
        GpioError: there is no such bank, or it does not give the lines.
    """
    path = find_chip(kernel, address)
    try:
        chip = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except OSError as error:
        raise GpioError(f"{path} cannot be opened: {error.strerror}.", "Join the group gpio.", "gpio_open") from error
    try:
        try:
            return _request_v2(kernel, chip, offsets, flags, consumer.encode()[:31], values, buffered), 2
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTTY):
                raise
            return _request_v1(kernel, chip, offsets, flags, consumer.encode()[:31], values), 1
    except OSError as error:
        holder = "Another program or kernel driver holds the line." if error.errno == errno.EBUSY else "See mip-rt doctor."
        raise GpioError(f"lines {list(offsets)} of {path} cannot be requested: {error.strerror}.", holder, "gpio_request") from error
    finally:
        os.close(chip)


class OutputLines:
    """Output lines of one bank; when the last descriptor closes, also by a crash, they become inputs (pulled down: off)."""

    def __init__(self, kernel, address: str, offsets, initial: int, consumer: str):
        self._kernel, self._count = kernel, len(offsets)
        self.fd, self._version = request_lines(kernel, address, tuple(offsets), OUTPUT, consumer, initial)
        self.values = initial

    def set(self, values: int, mask: int) -> None:
        """Drives the lines whose bit is set in mask; OSError where the kernel refuses."""
        merged = self.values & ~mask | values & mask
        if self._version == 2:
            self._kernel.ioctl(self.fd, SET_VALUES_V2, bytearray(_VALUES.pack(values, mask)))
        else:
            self._kernel.ioctl(self.fd, SET_VALUES_V1, bytearray((merged >> i) & 1 for i in range(self._count)).ljust(64, b"\0"))
        self.values = merged

    def close(self) -> None:
        """Releases the lines."""
        os.close(self.fd)
