"""One sample of a dry run on virtual time, compiled, while nobody watches or disturbs the boundary: the guard looks, the drivers see the duties, the world
moves, the counters show it, the chip takes it, its edge is in the line's buffer.

Each plant has the whole as its `sample`, made of `begin`, its own motion and `end`. Whatever is unusual is left to `fake.kernel`, which has the same in parts.
"""

import numpy as np

from mip_rt import guard_words
from mip_rt.compiled import njit, records_at, span
from mip_rt.fake import edges, pins, usual_chip
from mip_rt.hardware.compiled_io import MOST

UNUSUAL, MOVED, NO_ROOM, EDGE = range(-2, 2)  # nothing was done; all but the chip's part; all, but the edge found no room; all
FALLING = 2

PARTS = np.dtype(
    [
        ("words", "u8"),  # the guard's
        ("guard_timeout", "i8"),
        ("level", "u8"),  # of the enable line
        ("pins", "u8"),
        ("duty", "u8"),
        ("counts", "u8"),
        ("parameters", "u8"),
        ("state", "u8"),
        ("truth", "u8"),
        ("chip", "u8"),
        ("packet", "u8"),
        ("raw", "u8"),
    ],
    align=True,
)  # addresses

_time_left = njit(guard_words.time_left)


@njit
def begin(parts, due_ns):
    """The guard's look and what the motor drivers see; -1 where the guard moves its line, otherwise whether they are enabled.

    Args:
        parts: record of PARTS; the duties lie at `duty` afterwards.
    """
    words = records_at(parts.words, guard_words.WORDS_BYTES // 4, np.uint32)
    wanted = 1 if _time_left(words, parts.guard_timeout, due_ns) >= 0 else 0
    level = records_at(parts.level, 1, np.uint8)[0]
    if level != wanted:
        return -1
    duty = records_at(parts.duty, MOST, np.float64)
    if level == 0:
        for i in range(MOST):
            duty[i] = 0.0
    else:
        pins.see_duties(records_at(parts.pins, 1, pins.PINS)[0], duty)
    return wanted


@njit
def end(parts, line_at, due_ns):
    """Counters, chip and edge: MOVED, NO_ROOM or EDGE. line_at: address of the interrupt line's edges.LINE."""
    pins.show(records_at(parts.pins, 1, pins.PINS)[0], records_at(parts.counts, MOST, np.int64))
    if not usual_chip.sample(parts.chip, parts.packet, parts.raw):
        return np.int64(MOVED)
    found = edges.push_event(records_at(line_at, 1, edges.LINE)[0], due_ns, FALLING)
    return np.int64(EDGE if found == 1 else NO_ROOM)


def parts(guard, wiring, world, chip) -> np.ndarray:
    """(1,) PARTS of one bench, whose parts must outlive it."""
    made = np.zeros(1, PARTS)
    made[0] = (
        guard.memory[guard_words.WORDS_AT], guard.timeout, wiring.level_at, wiring.pins_at, span(world.duty)[0], span(world.counts)[0],
        span(world.parameters)[0], span(world.state)[0], span(world.truth)[0], span(chip.shared)[0], span(world.packet)[0], span(world.raw)[0],
    )  # fmt: skip
    return made
