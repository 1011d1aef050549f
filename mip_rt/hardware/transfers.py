"""A bus's prepared transfers, made by compiled code: a call of the function whose address the bus tells.

The real bus tells the address of a compiled function that makes the system call. A bus without one (fakes, a bus that measures) is reached
through a callback into Python, so the code above is the same.
"""

import ctypes
import errno

from mip_rt.compiled import JIT_DISABLED, callback, numba
from mip_rt.hardware import system_calls

I2C_RDWR = 0x0707  # include/uapi/linux/i2c-dev.h
_FUNCTION = ctypes.CFUNCTYPE(ctypes.c_ssize_t, ctypes.c_size_t, ctypes.c_size_t)


@callback(numba.intp(numba.uintp, numba.uintp))
def _i2c_transfer(fd, address):
    """0, or the errno: one I2C_RDWR with the structure at this address."""
    return numba.intp(system_calls.transfer(fd, I2C_RDWR, address))


class Entry:
    """Where compiled code makes the transfers of one bus: function(bus, handle) returns 0 or the errno.

    Args:
        bus: with `transfer(prepared)`; where it also has `fd`, a prepared transfer is the address of the kernel's structure.

    Attributes:
        function, bus: address and first argument, machine words.
    """

    def __init__(self, bus):
        self._transfer_of, self._prepared, self._trouble = bus, [], None
        if not JIT_DISABLED and hasattr(bus, "fd"):
            self.function, self.bus, self._callback = _i2c_transfer.address, bus.fd, None
        else:
            self._callback = _FUNCTION(self._call)
            self.function, self.bus = ctypes.cast(self._callback, ctypes.c_void_p).value, 0

    def handle(self, prepared) -> int:
        """Second argument for this transfer."""
        if self._callback is None:
            return prepared
        self._prepared.append(prepared)
        return len(self._prepared) - 1

    def _call(self, _, handle: int) -> int:
        try:
            return self._transfer_of.transfer(self._prepared[handle])
        except BaseException as trouble:  # it cannot pass through compiled code
            self._trouble = trouble
            return errno.EIO

    def check(self) -> None:
        """Raises what a transfer in Python has raised."""
        if self._trouble is not None:
            trouble, self._trouble = self._trouble, None
            raise trouble
