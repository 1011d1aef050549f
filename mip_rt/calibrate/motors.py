"""Signs of the motors, from short pulses with the wheels in the air, seen by the encoders (whose signs must be right)."""

from mip_rt.doctor.motors import DUTY, PULSE_S, open_bench
from mip_rt.errors import MipRtError
from mip_rt.hardware.encoders import Encoder

MOVED = 10  # counts
OTHERS = 0.2  # share of the motion that another wheel may show
UNEQUAL = 0.4  # the two directions may differ by so much


def measure(patient) -> dict:
    """Figures for the part "motors".

    Raises:
        MipRtError: nobody agreed, nothing or the wrong wheel turned, or one direction is much weaker than the other.
    """
    config = patient.config
    if not patient.person.agrees(f"Each motor will turn twice for {PULSE_S:g} s at {DUTY:.0%} duty. Take the robot off the ground, wheels free, hands away. Type yes to go on."):
        raise MipRtError("you did not agree to motors moving.", "Begin again and type yes.", "calibrate_motors")
    patient.person.act(("lift",))
    bench = open_bench(patient)
    encoders = [Encoder(patient.kernel, patient.pins.encoders[channel - 1]) for channel in config.encoders.channels]
    signs, shown = [], []
    try:
        for encoder in encoders:
            encoder.start()
        for wheel in range(len(encoders)):
            moved = [_pulse(patient, bench, encoders, wheel, duty) for duty in (DUTY, -DUTY)]
            _judge(wheel, moved)
            signs.append(1 if moved[0][wheel] > 0 else -1)
            shown.append([int(each[wheel]) for each in moved])
    finally:
        for encoder in encoders:
            encoder.close()
        bench.close()
    return {"signs": signs, "counts_forth_and_back": shown, "duty": DUTY, "pulse_s": PULSE_S}


def _pulse(patient, bench, encoders, wheel: int, duty: float) -> list:
    signs = patient.config.encoders.signs
    before = [encoder.read() for encoder in encoders]
    bench.pulse(wheel, duty, PULSE_S)
    patient.kernel.sleep(0.3)  # it runs out
    return [(encoder.read() - start) * sign for encoder, start, sign in zip(encoders, before, signs)]


def _judge(wheel: int, moved) -> None:
    forth, back = (each[wheel] for each in moved)
    for each in moved:
        others = max((abs(count) for i, count in enumerate(each) if i != wheel), default=0)
        if others > max(MOVED, OTHERS * abs(each[wheel])):
            raise MipRtError(f"motor {wheel + 1} was driven, another wheel turned: {each} counts.", "Put plugs or motors.channels in order: mip-rt doctor --interactive.",
                             "calibrate_motors")  # fmt: skip
    if min(abs(forth), abs(back)) <= MOVED or (forth > 0) == (back > 0):
        raise MipRtError(f"motor {wheel + 1} moved by {forth:+d} and {back:+d} counts in the two directions.", "Run mip-rt doctor --interactive.", "calibrate_motors")
    if abs(abs(forth) - abs(back)) > UNEQUAL * max(abs(forth), abs(back)):
        raise MipRtError(f"motor {wheel + 1} is much weaker in one direction: {forth:+d} and {back:+d} counts.",
                         "Something rubs, a direction line has no contact, or an encoder's channel is weak.", "calibrate_motors")  # fmt: skip


def in_words(found: dict) -> str:
    """What was found."""
    return f"signs {found['signs']}; counts forth and back by wheel {found['counts_forth_and_back']}"
