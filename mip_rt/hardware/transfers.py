"""A bus's prepared transfers, made by compiled code: a call of the function whose address the bus tells.

The real bus tells the C library's ioctl. A bus without descriptor (fakes, a bus that measures) is reached through a callback into Python, so the
code above is the same.
"""

import ctypes
import errno

import numpy as np

from mip_rt.compiled import call, njit
from mip_rt.hardware import system_calls

I2C_RDWR = 0x0707  # include/uapi/linux/i2c-dev.h
_FUNCTION = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_size_t, ctypes.c_size_t, ctypes.c_size_t)


class Entry:
    """Where compiled code makes the transfers of one bus: see `transfer`.

    Args:
        bus: with `transfer(prepared)`. Where it also has `fd`, a prepared transfer is the address of the kernel's structure. Where it has
            `shortcut`, it answers (function, bus) of its own, to be used in place of the callback whose address it is told; a prepared transfer
            that such a function may see has a number of its own, `handle`.

    Attributes:
        function: address of an ioctl(bus, I2C_RDWR, handle); what refuses answers -1 and sets errno, or minus another errno.
        bus: its first argument.
    """

    def __init__(self, bus):
        self._bus, self._prepared, self._trouble = bus, {}, None
        if hasattr(bus, "fd"):
            self.function, self.bus = ctypes.cast(ctypes.CDLL(None).ioctl, ctypes.c_void_p).value, bus.fd
            return
        self._callback = _FUNCTION(self._call)
        self.function, self.bus = ctypes.cast(self._callback, ctypes.c_void_p).value, 0
        if hasattr(bus, "shortcut"):
            self.function, self.bus = bus.shortcut(self.function)

    def handle(self, prepared) -> int:
        """Last argument for this transfer."""
        if hasattr(self._bus, "fd"):
            return prepared
        handle = getattr(prepared, "handle", len(self._prepared))
        self._prepared[handle] = prepared
        return handle

    def _call(self, _, __, handle: int) -> int:
        try:
            return -self._bus.transfer(self._prepared[handle])
        except BaseException as trouble:  # it cannot pass through compiled code
            self._trouble = trouble
            return -errno.EIO

    def check(self) -> None:
        """Raises what a transfer in Python has raised."""
        if self._trouble is not None:
            trouble, self._trouble = self._trouble, None
            raise trouble


@njit
def transfer(function, bus, handle):
    """0, or the errno: an Entry's function called."""
    found = call(function, bus, I2C_RDWR, handle)
    if found >= 0:
        return np.intp(0)
    return -system_calls.result(np.intp(found)) if found == -1 else np.intp(-found)
