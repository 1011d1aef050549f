"""Counts a turn and signs of the encoders, from turns of each wheel by hand."""

from mip_rt.errors import MipRtError
from mip_rt.hardware.encoders import Encoder

TURNS = 5
MOVED = 20  # counts a turn
DISAGREEMENT = 0.02  # of the wheels among each other
LARGEST_CHANGE = 0.5  # against the configuration


def measure(patient) -> dict:
    """Figures for the part "encoders": one number for all wheels.

    Raises:
        MipRtError: a wheel did not count, the wheels disagree, or the number is far from the configuration's.
    """
    config = patient.config
    counts = []
    for wheel, channel in enumerate(config.encoders.channels):
        encoder = Encoder(patient.kernel, patient.pins.encoders[channel - 1])
        try:
            encoder.start()
            before = encoder.read()
            patient.person.do(f"Mark wheel {wheel + 1}, then turn it by hand {TURNS} whole turns in its positive sense, back to the mark.", ("turn", wheel, TURNS))
            counts.append(encoder.read() - before)
        finally:
            encoder.close()
        if abs(counts[-1]) < MOVED * TURNS:
            raise MipRtError(f"wheel {wheel + 1} moved by {counts[-1]} counts in {TURNS} turns.", "Run mip-rt doctor --interactive: a channel may be dead.", "calibrate_encoders")
    per_turn = [abs(count) / TURNS for count in counts]
    mean = sum(per_turn) / len(per_turn)
    apart = max(abs(value / mean - 1.0) for value in per_turn)
    if apart > DISAGREEMENT:
        shown = ", ".join(f"{value:.1f}" for value in per_turn)
        raise MipRtError(f"the wheels disagree: {shown} counts a turn.", "Turn each by exactly the same number of whole turns; or one loses counts.", "calibrate_encoders")
    wanted = config.encoders.counts_per_turn
    if abs(mean / wanted - 1.0) > LARGEST_CHANGE:
        raise MipRtError(f"{mean:.1f} counts a turn are far from encoders.counts_per_turn, {wanted}.",
                         "Were it whole turns? A channel that is dead halves the counts; another gear belongs into the configuration.", "calibrate_encoders")  # fmt: skip
    return {"counts_per_turn": round(mean), "signs": [1 if count > 0 else -1 for count in counts], "by_wheel": [round(value, 2) for value in per_turn],
            "disagreement": round(apart, 5)}  # fmt: skip


def in_words(found: dict) -> str:
    """What was found."""
    return f"{found['counts_per_turn']} counts a turn (by wheel {', '.join(f'{value:g}' for value in found['by_wheel'])}), signs {found['signs']}"
