"""Whether a packet of the DMP can be believed: a quaternion of length 1, and not the same bytes for the tenth time. Compiled.

In Python these few lines are 4,000 ARM instructions a tick, compiled they are 300.
"""

import numpy as np

from mip_rt.compiled import entry, records_at

WORDS = 8  # of 32 bits in a packet
FROZEN_AFTER = 10  # equal packets in a row
NORM_TOLERANCE = 0.01
GOOD, BAD_NORM, FROZEN = range(3)

STATE = np.dtype([("last", "u4", (WORDS,)), ("equal", "i8")], align=True)

_ONE = float(1 << 30)  # of the quaternion's words
_LEAST, _MOST = ((1.0 - NORM_TOLERANCE) * _ONE) ** 2, ((1.0 + NORM_TOLERANCE) * _ONE) ** 2


@entry("uintp", "uintp")
def check(state_at, packet_at):
    """GOOD, BAD_NORM or FROZEN.

    Args:
        state_at: address of one STATE: the last packet of right length, and how many equal ones followed it.
        packet_at: address of 32 bytes that begin with four big-endian words (w, x, y, z) of 2^-30.
    """
    packet = records_at(packet_at, 4 * WORDS, np.uint8)
    squares = 0.0
    for k in range(0, 16, 4):
        value = np.int32(np.int32(packet[k]) << 24 | np.int32(packet[k + 1]) << 16 | np.int32(packet[k + 2]) << 8 | np.int32(packet[k + 3]))
        squares += float(value) * float(value)
    if not _LEAST <= squares <= _MOST:
        return BAD_NORM
    words = records_at(packet_at, WORDS, np.uint32)
    s = records_at(state_at, 1, STATE)[0]
    different = np.uint32(0)
    for k in range(WORDS):
        different |= words[k] ^ s.last[k]
        s.last[k] = words[k]
    s.equal = s.equal + 1 if different == 0 else 0
    return FROZEN if s.equal >= FROZEN_AFTER - 1 else GOOD
