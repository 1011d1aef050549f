"""GPIO events of the character device, read by compiled code.

Source: include/uapi/linux/gpio.h (gpio_v2_line_event, gpioevent_data).
"""

import errno

import numpy as np

from mip_rt.compiled import entry, records_at
from mip_rt.hardware import system_calls

BUFFERED = 64  # events that the kernel keeps, and that one read takes
_LONGEST = 48  # bytes of an event of the second version
_NOTHING = -errno.EAGAIN
_WORDS = _LONGEST // 4

STATE = np.dtype(
    [
        ("fd", "i8"),
        ("event_bytes", "i8"),  # bytes of an event: which version of the interface
        ("room", "i8"),  # bytes that one read may bring
        ("timestamp_ns", "i8"),  # of the newest event
        ("edge", "i8"),  # its kind
        ("count", "i8"),  # events since the last read that found any, the dropped ones included
        ("sequence", "i8"),  # the kernel's number of the newest event (version 2); -1: what was dropped until the next one does not count
        ("missed", "i8"),  # events that the kernel's buffer dropped
        ("events", "u4", (BUFFERED * _WORDS,)),
    ],
    align=True,
)


@entry("uintp")
def take(state_at):
    """Reads all that is waiting; returns `count`, 0 where nothing is, or minus the errno.

    Args:
        state_at: address of one STATE.
    """
    s = records_at(state_at, 1, STATE)[0]
    found = system_calls.read(s.fd, s.events.ctypes.data, s.room)
    if found < s.event_bytes:
        return np.int64(0 if found >= 0 or found == _NOTHING else found)
    count = found // s.event_bytes
    at = (count - 1) * (s.event_bytes // 4)
    s.timestamp_ns = np.int64(s.events[at]) | np.int64(s.events[at + 1]) << 32
    s.edge = s.events[at + 2]
    if s.event_bytes == _LONGEST:
        sequence = np.int64(s.events[at + 4])
        dropped = (sequence - s.sequence - count) & 0xFFFFFFFF
        known = s.sequence >= 0
        s.sequence = sequence
        if known and dropped < 0x80000000:
            s.missed += dropped
            count += dropped
    s.count = count
    return np.int64(count)


@entry("uintp", "uintp", "float64")
def wait(state_at, polled_at, timeout_s):
    """Waits for events and takes them: as `take`, 0 also after the timeout.

    Args:
        polled_at: address of one system_calls.POLLED, for the call's own use.
    """
    if system_calls.wait_readable(polled_at, records_at(state_at, 1, STATE)[0].fd, timeout_s):
        return take(state_at)
    return np.int64(0)
