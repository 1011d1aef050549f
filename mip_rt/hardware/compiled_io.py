"""Reading counters and writing pulses through open sysfs files, compiled.

In Python a read of one counter (call, bytes, int, wrap) is 4,700 ARM instructions and a write of one pulse 8,000; in compiled code they are a
few hundred.

Source: sysfs attributes are read and written whole from offset 0 (Documentation/filesystems/sysfs.rst).
"""

import numpy as np

from mip_rt.compiled import JIT_DISABLED, direct, entry, njit
from mip_rt.hardware.system_calls import pread, pwrite

MOST = 4  # encoders or motors
TEXT = 24  # bytes of an attribute: a 64-bit number and its newline
WRAP = 1 << 32  # eQEP counters have 32 bits
HALF = 1 << 31

COUNTERS = np.dtype(
    [
        ("number", "i8"),
        ("fd", "i8", (MOST,)),
        ("raw", "i8", (MOST,)),  # as last read
        ("count", "i8", (MOST,)),  # unwrapped
        ("errors", "i8", (MOST,)),  # reads that failed; the last count is then repeated
        ("failing", "i8", (MOST,)),  # 1: the last read failed
        ("text", "u1", (TEXT,)),
    ],
    align=True,
)
PULSES = np.dtype(
    [
        ("number", "i8"),
        ("fd", "i8", (2 * MOST,)),  # of two PWM a motor, that of the other direction stands MOST further
        ("two", "i8"),  # 1: two PWM a motor, and no direction lines
        ("period_ns", "i8"),
        ("sign", "i8", (MOST,)),  # direction that the lines stand at: -1, 1, or 0 when not known
        ("mirrored", "i8", (MOST,)),  # 1: the motor turns while the PWM is low, and rests where it is always high
        ("written_ns", "i8", (2 * MOST,)),  # pulse that the kernel has, -1 when not known
        ("text", "u1", (TEXT,)),
    ],
    align=True,
)

_TENTH, _TENTH_SHIFT = np.uint64(0xCCCCCCCD), np.uint64(35)  # n / 10 of 32 bits, exactly: a division is a call on 32-bit ARM, and numba makes it one of 64 bits

REFUSED = -1  # write_pulses: the kernel refused a write


def records(dtype, number: int):
    """(1,) of COUNTERS or PULSES for so many files, none of them open yet, as the compiled functions want it."""
    made = np.zeros(1, dtype)
    made["number"], made["fd"] = number, -1
    return made.view(np.recarray) if JIT_DISABLED else made


def write_types(frame_dtype) -> tuple:
    """Types of the arguments of `write_pulses` for the rows of one robot."""
    return PULSES, frame_dtype, "int64"


def writer_for(frame_dtype):
    """`write_pulses` for the rows of one robot, compiled."""
    return direct(write_pulses, *write_types(frame_dtype))


@njit
def number(text, length):
    """(number, 1) of decimal text up to a newline, or (0, 0) where it is none."""
    at = 0
    negative = length > 0 and text[0] == 45
    if negative:
        at = 1
    value = np.int64(0)
    digits = 0
    while at < length and digits < 19 and 48 <= text[at] <= 57:
        value = value * 10 + (text[at] - 48)
        at += 1
        digits += 1
    if digits == 0 or digits > 18 or (at < length and text[at] != 10):
        return np.int64(0), 0
    return (-value if negative else value), 1


@njit
def decimal(value, text):
    """Writes a number and a newline into `text`; returns how many bytes."""
    rest = np.uint32(abs(value))
    digits = 1
    power = np.uint32(10)
    while digits < 10 and rest >= power:
        power = np.uint32(power * np.uint32(10))
        digits += 1
    length = digits + 2 if value < 0 else digits + 1
    text[0] = 45  # the minus sign; a first digit overwrites it
    text[length - 1] = 10
    for k in range(length - 2, length - 2 - digits, -1):
        tenth = np.uint32(np.uint64(rest) * _TENTH >> _TENTH_SHIFT)
        text[k] = 48 + (rest - tenth * np.uint32(10))
        rest = tenth
    return length


@njit
def _read(c, i):
    value, good = number(c.text, pread(c.fd[i], c.text.ctypes.data, TEXT))
    if good == 1:
        moved = (value - c.raw[i] + HALF) % WRAP - HALF
        c.count[i] += moved
        c.raw[i] = value
        c.failing[i] = 0
    else:
        c.errors[i] += 1
        c.failing[i] = 1
    return c.count[i]


@entry(COUNTERS, "int64")
def read_counter(counters, i):
    """Reads counter `i` alone; returns its unwrapped count."""
    return _read(counters[0], i)


@njit
def read_all(c):
    """Reads all counters, unwrapped; one that cannot be read keeps its last count. c: record of COUNTERS."""
    for i in range(c.number):
        _read(c, i)


@njit
def _write(p, i, pulse):
    if pulse == p.written_ns[i]:
        return True
    length = decimal(pulse, p.text)
    if pwrite(p.fd[i], p.text.ctypes.data, length) != length:
        p.written_ns[i] = -1
        return False
    p.written_ns[i] = pulse
    return True


@njit
def _drive(p, i, pulse):
    """The pulse of the present direction; False where the kernel refuses."""
    size = min(abs(pulse), p.period_ns)
    if p.two == 0:
        return _write(p, i, p.period_ns - size if p.mirrored[i] == 1 else size)
    if pulse > 0:  # the side that ends goes first: never are both on
        return _write(p, i + MOST, np.int64(0)) and _write(p, i, size)
    return _write(p, i, np.int64(0)) and _write(p, i + MOST, size)


@njit
def write_pulses(pulses, rows, index):
    """Writes rows[index].duty_ns; only changes reach the kernel. At a reversal the old pulse is taken away first.

    Args:
        pulses: (1,) PULSES.
        rows: (n,) frames.

    Returns:
        0, rows[index].applied_ns then holds the pulses; or REFUSED; or the bits of the motors whose direction must be turned (and
        `sign` set) before this function is called again.
    """
    p = pulses[0]
    row = rows[index]
    turn = 0
    for i in range(p.number):
        pulse = row.duty_ns[i]
        if p.two == 0 and pulse != 0 and (p.sign[i] == 0 or (pulse > 0) != (p.sign[i] > 0)):
            turn |= 1 << i
            pulse = np.int64(0)
        if not _drive(p, i, pulse):
            return REFUSED
    if turn == 0:
        for i in range(p.number):
            row.applied_ns[i] = row.duty_ns[i]
    return turn
