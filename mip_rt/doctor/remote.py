"""The remote: opens its port, listens, shows frames and which bytes move."""

from mip_rt.doctor.report import fail, ok, warn
from mip_rt.hardware.serial_port import SerialPort
from mip_rt.remote.fourjoy import FRAME, FourJoyDecoder

LISTEN_S = 2.0
LOOK_S = 0.02
NAMES = ("0x00", "x", "y", "unused", "0x04", "buttons", "start/select")
MOST_BYTES = 4096


def examine(patient):
    """Yields the layer's Checks."""
    settings = patient.config.remote
    port = SerialPort(patient.remote_device or settings.device, settings.baud)  # a refusal has its own sentence and cure
    try:
        if patient.person is not None:
            patient.person.do("Connect the phone, move the stick in circles and press buttons until the next line.", ("stick",))
        data = listen(patient.kernel, port)
    finally:
        port.close()
    if not data:
        yield warn("frames", f"nothing arrived in {LISTEN_S:g} s at {settings.baud} baud.",
                   "Is the phone connected (the HC-06's light stays on)? An HC-06 as sold has 9600 baud: remote.baud. RX and TX exchanged?")  # fmt: skip
        return
    decoder = FourJoyDecoder()
    frames = decoder.feed(data)
    if not frames:
        yield fail("frames", f"{len(data)} bytes arrived, no 4joy frame among them: {data[:16].hex(' ')} ...",
                   "The baud rate is wrong (remote.baud), or the app is another one: a 4joy frame has 7 bytes, 00 first and 04 fifth.")  # fmt: skip
        return
    sentence = f"{frames} frames in {LISTEN_S:g} s, {decoder.dropped_bytes} bytes dropped; {moving(data, decoder.dropped_bytes)}; stick {decoder.x:+.2f} {decoder.y:+.2f}"
    if decoder.dropped_bytes > 2 * FRAME:
        yield warn("frames", sentence + ".", "Frames are torn: another program reads the port (a login?), or the radio is weak.")
    else:
        yield ok("frames", sentence + ".")


def listen(kernel, port) -> bytes:
    """What arrives within LISTEN_S."""
    data, end_ns = bytearray(), kernel.monotonic_ns() + round(LISTEN_S * 1e9)
    port.read()  # what lay there
    while kernel.monotonic_ns() < end_ns and len(data) < MOST_BYTES:
        kernel.sleep(LOOK_S)
        data += port.read()
    return bytes(data)


def moving(data: bytes, start: int) -> str:
    """Which of a frame's bytes changed, with their ranges."""
    at = next((i for i in range(min(start, len(data)), min(start + FRAME, len(data))) if data[i] == 0x00 and data[i + 4 : i + 5] == b"\x04"), start)
    columns = [data[at + i :: FRAME] for i in range(FRAME)]
    found = [f"byte {i} ({NAMES[i]}) {min(column)} to {max(column)}" for i, column in enumerate(columns) if len(set(column)) > 1]
    return "moving: " + ", ".join(found) if found else "no byte moves"
