"""What the wires show at every sample, compiled: counts into the mapped counter files, duties out of the mapped PWM files and lines.

The texts lie in memory that sysfs.MappedFile has mapped; the compiled code knows its addresses. A counter's file always has exactly the
length of its text, as sysfs shows it.
"""

import ctypes
import os

import numpy as np

from mip_rt.compiled import JIT_DISABLED, entry, external, njit, records_at
from mip_rt.hardware.compiled_io import MOST, TEXT, WRAP, decimal, number

NEVER = -(1 << 62)  # a count that was not shown yet
SIGN_BIT = 1 << 31

PINS = np.dtype(
    [
        ("wheels", "i8"),
        ("signed", "i8"),  # 1: counters show signed numbers
        ("count_at", "i8", (MOST,)),  # addresses of the texts
        ("count_fd", "i8", (MOST,)),
        ("shown", "i8", (MOST,)),
        ("length", "i8", (MOST,)),  # of the counters' texts
        ("text", "u1", (TEXT,)),
        ("period_ns", "f8"),
        ("sign", "f8", (MOST,)),  # of a wheel's motion where its pin drives forward
        ("duty_at", "i8", (MOST,)),  # addresses of the texts of the PWM
        ("back_at", "i8", (MOST,)),  # of those of the second PWM; 0: there is none
        ("a_at", "i8", (MOST,)),  # addresses of the direction lines' levels; 0: there is none
        ("b_at", "i8", (MOST,)),
    ],
    align=True,
)


def records() -> np.ndarray:
    """(1,) PINS without wires, as the compiled functions want it."""
    made = np.zeros(1, PINS)
    made["shown"], made["length"] = NEVER, -1
    return made.view(np.recarray) if JIT_DISABLED else made


if JIT_DISABLED:

    def _put(address, text, length):
        ctypes.memmove(int(address), text.ctypes.data, length)

    def _cut(fd, length):
        os.ftruncate(fd, length)

else:
    _C_MEMCPY = external("memcpy", "uintp(uintp, uintp, uintp)")
    _C_FTRUNCATE = external("ftruncate", "int32(int32, intp)")

    @njit
    def _put(address, text, length):
        _C_MEMCPY(np.uintp(address), np.uintp(text.ctypes.data), np.uintp(length))

    @njit
    def _cut(fd, length):
        _C_FTRUNCATE(np.int32(fd), np.intp(length))


@njit
def show(p, counts):
    """`show_counts` on a record."""
    for i in range(p.wheels):
        if counts[i] == p.shown[i]:
            continue
        p.shown[i] = counts[i]
        shown = counts[i] % WRAP
        if p.signed == 1 and shown >= SIGN_BIT:
            shown -= WRAP
        length = decimal(shown, p.text)
        if length > p.length[i]:
            _cut(p.count_fd[i], length)
        _put(p.count_at[i], p.text, length)
        if length != p.length[i]:
            _cut(p.count_fd[i], length)
            p.length[i] = length


@entry(PINS, np.dtype("i8"))
def show_counts(pins, counts):
    """Shows counts (wheels,): unsigned 32 bits for the counter subsystem, signed for tieqep. Only changes are written."""
    show(pins[0], counts)


@njit
def _pulse(address):
    return number(records_at(np.uint64(address), TEXT, np.uint8), TEXT)[0]


@njit
def see_duties(p, duty):
    """`read_duties` on a record."""
    for i in range(p.wheels):
        pulse = _pulse(p.duty_at[i])
        if p.back_at[i] != 0:
            duty[i] = p.sign[i] * (pulse - _pulse(p.back_at[i])) / p.period_ns
            continue
        b = np.int64(records_at(np.uint64(p.b_at[i]), 1, np.uint8)[0])
        if p.a_at[i] != 0:
            a = np.int64(records_at(np.uint64(p.a_at[i]), 1, np.uint8)[0])
            duty[i] = (a - b) * p.sign[i] * pulse / p.period_ns
        else:
            duty[i] = p.sign[i] * (pulse / p.period_ns - b)


@entry(PINS, np.dtype("f8"))
def read_duties(pins, duty):
    """Fills duty (wheels,) with the signed duties by wheel: two PWM, two lines and a PWM, or one line and a PWM."""
    see_duties(pins[0], duty)
