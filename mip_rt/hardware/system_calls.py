"""System calls from compiled code: the C library's functions by name, so that the compiled code can be kept on disk.

In Python a system call costs thousands of ARM instructions besides the kernel's own (arguments, buffers, results, each an object); here it costs
some fifty. As in the kernel's own interface, a result below zero is minus the errno. None of them lets other Python threads run; mip-rt has none.
"""

import numpy as np

from mip_rt.compiled import JIT_DISABLED, entry, external, njit, records_at

POLLIN = 0x1
EINTR = 4
POLLED = np.dtype([("fd", "i4"), ("events", "i2"), ("revents", "i2")])  # struct pollfd

if JIT_DISABLED:
    import ctypes

    _LIBRARY = ctypes.CDLL(None, use_errno=True)
    _ERRNO = ctypes.CDLL(None)["__errno_location"]
    _ERRNO.restype = ctypes.c_void_p

    def _called(name, *arguments):
        function = getattr(_LIBRARY, name)
        function.restype = ctypes.c_int if name in ("ioctl", "poll") else ctypes.c_ssize_t
        found = function(*arguments)
        return found if found >= 0 else -ctypes.get_errno()

    def result(found):
        """See below."""
        return found if found >= 0 else -ctypes.c_int.from_address(_ERRNO()).value

    def pread(fd, address, length):
        """See below."""
        return _called("pread", int(fd), ctypes.c_void_p(int(address)), ctypes.c_size_t(int(length)), ctypes.c_long(0))

    def pwrite(fd, address, length):
        """See below."""
        return _called("pwrite", int(fd), ctypes.c_void_p(int(address)), ctypes.c_size_t(int(length)), ctypes.c_long(0))

    def read(fd, address, length):
        """See below."""
        return _called("read", int(fd), ctypes.c_void_p(int(address)), ctypes.c_size_t(int(length)))

    def ioctl(fd, request, address):
        """See below."""
        return _called("ioctl", int(fd), ctypes.c_ulong(int(request)), ctypes.c_void_p(int(address)))

    def _poll(address, count, timeout_ms):
        return _called("poll", ctypes.c_void_p(int(address)), ctypes.c_ulong(count), int(timeout_ms))

else:
    _C_PREAD = external("pread", "intp(int32, uintp, uintp, intp)")
    _C_PWRITE = external("pwrite", "intp(int32, uintp, uintp, intp)")
    _C_READ = external("read", "intp(int32, uintp, uintp)")
    _C_IOCTL = external("ioctl", "int32(int32, uintp, uintp)")
    _C_POLL = external("poll", "int32(uintp, uintp, int32)")
    _C_ERRNO = external("__errno_location", "uintp()")

    @njit
    def result(found):
        """What a function of the C library returned, or minus its errno."""
        return found if found >= 0 else -np.intp(records_at(_C_ERRNO(), 1, np.int32)[0])

    @njit
    def pread(fd, address, length):
        """Bytes read from offset 0 to an address."""
        return result(_C_PREAD(np.int32(fd), np.uintp(address), np.uintp(length), np.intp(0)))

    @njit
    def pwrite(fd, address, length):
        """Bytes written to offset 0."""
        return result(_C_PWRITE(np.int32(fd), np.uintp(address), np.uintp(length), np.intp(0)))

    @njit
    def read(fd, address, length):
        """Bytes read to an address."""
        return result(_C_READ(np.int32(fd), np.uintp(address), np.uintp(length)))

    @njit
    def ioctl(fd, request, address):
        """0 or more; the argument is the address of its structure."""
        return result(np.intp(_C_IOCTL(np.int32(fd), np.uintp(request), np.uintp(address))))

    @njit
    def _poll(address, count, timeout_ms):
        return result(np.intp(_C_POLL(np.uintp(address), np.uintp(count), np.int32(timeout_ms))))


@njit
def wait_readable(polled_at, fd, timeout_s):
    """True as soon as fd can be read (or its other end is gone), False after the timeout. A signal does not end the wait.

    Args:
        polled_at: address of one POLLED, for the call's own use.
    """
    polled = records_at(polled_at, 1, POLLED)[0]
    polled.fd = fd
    polled.events = POLLIN
    ready = -EINTR
    while ready == -EINTR:
        ready = _poll(polled_at, 1, int(timeout_s * 1000.0))
    return ready > 0


@entry("int64", "uintp", "uintp")
def transfer(fd, request, address):
    """0, or the errno: an ioctl on a structure that is already in memory."""
    found = ioctl(fd, request, address)
    return np.int64(0) if found >= 0 else np.int64(-found)

