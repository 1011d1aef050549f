"""An I2C bus with transfers that are put together once and repeated: what costs in smbus2 is building them.

`i2c_rdwr` of smbus2 copies its messages into a new structure for every call (15,000 ARM instructions); the kernel does not mind being given
the same structure again, with the same buffers, 200 times a second.

Source: include/uapi/linux/i2c-dev.h (I2C_RDWR); smbus2 for the structures.
"""

import ctypes
from functools import partial

import smbus2
from smbus2.smbus2 import I2C_RDWR, i2c_rdwr_ioctl_data

from mip_rt.compiled import direct
from mip_rt.hardware import system_calls


class I2cBus(smbus2.SMBus):
    """smbus2's bus, and prepared transfers.

    Attributes:
        transfer: transfer(prepared) carries out a prepared transfer; returns 0, or the errno where the bus refuses.
    """

    def open(self, bus) -> None:
        """As smbus2's, which also its constructor calls."""
        super().open(bus)
        self._kept = []  # what the prepared transfers point to
        self.transfer = partial(direct(system_calls.transfer), self.fd, I2C_RDWR)

    def prepare(self, *messages) -> int:
        """One combined transfer of these messages, for `transfer`; what is read appears in the messages' own buffers."""
        structure = i2c_rdwr_ioctl_data.create(*messages)
        self._kept.append((structure, messages))
        return ctypes.addressof(structure)
