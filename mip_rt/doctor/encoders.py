"""Encoders: interface, range, clock; with a person, counts and sign by a turn of each wheel by hand."""

from mip_rt.doctor.patient import as_check
from mip_rt.doctor.report import fail, ok, warn
from mip_rt.errors import EncoderError
from mip_rt.hardware.encoders import Encoder

MOVED = 4  # counts: E1 with channel A on the wrong pad only toggles within one
COUNTS_TOLERANCE = 0.1


def examine(patient):
    """Yields the layer's Checks."""
    config, working = patient.config, []
    for wheel, channel in enumerate(config.encoders.channels):
        address = patient.pins.encoders[channel - 1]
        name = f"wheel{wheel + 1}"
        try:
            encoder = Encoder(patient.kernel, address)
            encoder.start()
        except EncoderError as error:
            yield as_check(name, error)
            continue
        if encoder.reads_back(patient.kernel):
            yield ok(name, f"eQEP {channel - 1} at {address} ({encoder.interface}) counts are written and read back.")
            working.append((wheel, channel, encoder))
        else:
            yield fail(name, f"eQEP {channel - 1} at {address} does not keep a count that is written: no clock, or a ceiling of 0.",
                       "Use a kernel of 6.10 or later, or let PWM of the same subsystem run (the project's overlay enables ehrpwm0, too).")  # fmt: skip
            encoder.close()
    try:
        if patient.person is not None:
            for wheel, channel, encoder in working:
                yield _by_hand(patient, wheel, channel, encoder)
    finally:
        for _, _, encoder in working:
            encoder.close()


def _by_hand(patient, wheel: int, channel: int, encoder):
    name = f"turn{wheel + 1}"
    expected = patient.config.encoders.counts_per_turn
    before = encoder.read()
    patient.person.do(f"Motors are off. Turn wheel {wheel + 1} by hand one whole turn in its positive sense.", ("turn", wheel, 1.0))
    counts = encoder.read() - before
    sign = patient.config.encoders.signs[wheel]
    patient.notes.setdefault("hand_counts", {})[wheel] = counts
    if abs(counts) <= MOVED:
        return fail(name, f"wheel {wheel + 1} was turned, eQEP {channel - 1} moved by {counts} counts.",
                    "A channel is not connected: check the plug; on a Blue, E1 needs the project's overlay (channel A is on the wrong pad there).")  # fmt: skip
    if (counts > 0) != (sign > 0):
        return fail(name, f"a positive turn gave {counts:+d} counts, but encoders.signs says {sign:+d} for wheel {wheel + 1}.",
                    f"Change the sign of wheel {wheel + 1} in encoders.signs, or exchange its channels A and B.")  # fmt: skip
    if abs(abs(counts) / expected - 1.0) > COUNTS_TOLERANCE:
        return warn(name, f"one turn gave {abs(counts)} counts, encoders.counts_per_turn says {expected}.",
                    "Measure it over ten turns: mip-rt calibrate encoders.")  # fmt: skip
    return ok(name, f"one positive turn gave {counts:+d} counts ({expected} expected), the sign fits.")
