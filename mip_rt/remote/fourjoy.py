"""The "4joy" frame: seven bytes without checksum, found again within a few frames after any slip.

    byte 0  0x00       byte 3  unused
    byte 1  x          byte 4  0x04
    byte 2  y (down)   byte 5  buttons: 1 triangle, 2 circle, 4 cross, 8 square
                       byte 6  2 start, 4 select

Axes are signed bytes, -127 to 127 (128, the ancestor's trap, is the negative end). Bytes 0 and 4 also occur as data, so the first lock
wants two frames in a row that fit, and a misfit drops one byte, not seven.

Source: what the robot author's program expects on its UART.
"""

import math

FRAME = 7
TRIANGLE, CIRCLE, CROSS, SQUARE = 1, 2, 4, 8
BUTTONS = {"triangle": TRIANGLE, "circle": CIRCLE, "cross": CROSS, "square": SQUARE}
START, SELECT = 2, 4
LONGEST = 4096  # bytes kept while searching; more cannot be live


def axis(byte: int) -> float:
    """A stick byte as a number in [-1, 1]."""
    signed = byte - 256 if byte >= 128 else byte
    return max(-1.0, signed / 127.0)


def _fits(data, at: int) -> bool:
    return data[at] == 0x00 and data[at + 4] == 0x04 and data[at + 5] <= 0x0F and data[at + 6] in (0, 2, 4, 6)


class FourJoyDecoder:
    """Finds frames in a byte stream.

    Attributes:
        x, y: newest stick position, right and forward positive, within the unit circle.
        buttons, start_select: newest bits.
        frames, dropped_bytes, resyncs: counters.
        locked: the position of the frames in the stream is known.
    """

    def __init__(self):
        self._data = bytearray()
        self.x = self.y = 0.0
        self.buttons = self.start_select = 0
        self.frames = self.dropped_bytes = self.resyncs = 0
        self.locked = False

    def feed(self, data: bytes) -> int:
        """Takes bytes in; returns how many valid frames they completed. The newest frame's contents become the attributes."""
        stream = self._data
        stream += data
        found = at = 0
        while True:
            needed = FRAME if self.locked else 2 * FRAME
            if len(stream) - at < needed:
                break
            if _fits(stream, at) and (self.locked or _fits(stream, at + FRAME)):
                self.locked = True
                self._take(stream, at)
                found += 1
                at += FRAME
                continue
            if self.locked:
                self.locked = False
                self.resyncs += 1
            self.dropped_bytes += 1
            at += 1
        del stream[:at]
        if len(stream) > LONGEST:
            self.dropped_bytes += len(stream) - LONGEST
            del stream[:-LONGEST]
        return found

    def _take(self, stream, at: int) -> None:
        x, y = axis(stream[at + 1]), -axis(stream[at + 2])
        length = math.hypot(x, y)
        if length > 1.0:
            x, y = x / length, y / length
        self.x, self.y = x, y
        self.buttons, self.start_select = stream[at + 5], stream[at + 6]
        self.frames += 1


def frame(x: float, y: float, buttons: int = 0, start_select: int = 0) -> bytes:
    """The seven bytes of a stick position (right, forward) and buttons, as the phone sends them."""
    right = max(-127, min(127, round(x * 127.0))) & 0xFF
    down = max(-127, min(127, round(-y * 127.0))) & 0xFF
    return bytes((0x00, right, down, 0x00, 0x04, buttons, start_select))
