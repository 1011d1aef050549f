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


def time_left(words, timeout, now_ns):
    """The guard looks: how much longer the loop's heartbeat is good for, in the words' units; -1 where the line must be low. Also compiled.

    Args:
        words: four unsigned 32-bit words, shared with the loop.
        timeout: largest age of its heartbeat.
    """
    now = now_ns >> 10 & MASK
    words[GUARD_BEAT] = now
    request = words[REQUEST]  # serial number of the request, and in the lowest bit whether the line is wanted
    if not request & 1 or words[DROPPED] == request:
        return -1
    age_of_beat = now - int(words[BEAT]) & MASK
    if age_of_beat & HALF:  # it is younger than this look
        age_of_beat -= MASK + 1
    if age_of_beat > timeout:
        words[DROPPED] = request
        return -1
    return timeout - age_of_beat
