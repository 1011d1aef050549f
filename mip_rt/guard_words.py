"""What the loop and its guard share: four 32-bit words, each written by one side with one aligned store, and how each side reads the other's.

Times are CLOCK_MONOTONIC in units of 1.024 us, modulo 2^32.
"""

BEAT, REQUEST, GUARD_BEAT, DROPPED = range(4)  # loop, loop, guard, guard
WORDS_BYTES = 16
MASK, HALF = 0xFFFFFFFF, 0x80000000
OK, LINE_DROPPED, LOST = range(3)  # what the loop learns of the guard
# What the loop's side remembers, four 64-bit numbers: address of the shared words, largest age of the guard's own beat in the words' units,
# newest request, status.
WORDS_AT, TIMEOUT, NEWEST, STATUS = range(4)


def stamp(now_ns: int) -> int:
    """A time as it stands in the shared words."""
    return now_ns >> 10 & MASK


def age(now: int, then: int) -> int:
    """Units of 1.024 us from one stamp to another; negative where `then` is later. Right within 36 minutes."""
    difference = now - then & MASK
    return difference - (MASK + 1) if difference & HALF else difference


def beat(words, memory, now_ns):
    """The loop has come so far at this time; returns the status. Also compiled, as part of `inputs.gather`.

    Args:
        words: four unsigned 32-bit words, shared with the guard.
        memory: four 64-bit numbers, see WORDS_AT.
    """
    now = now_ns >> 10 & MASK
    words[BEAT] = now
    if memory[STATUS] != LOST:
        if memory[TIMEOUT] < (now - int(words[GUARD_BEAT]) & MASK) < HALF:
            memory[STATUS] = LOST
        elif words[DROPPED] == memory[NEWEST]:
            memory[STATUS] = LINE_DROPPED
        else:
            memory[STATUS] = OK
    return memory[STATUS]
