"""Motors: PWM chips and their settings read back, direction lines, enable line; with a person, what each of them turns.

Nothing moves without a typed yes, and then only in short pulses of small duty (`hardware.motor_bench`).
"""

import numpy as np

from mip_rt.doctor.patient import as_check
from mip_rt.doctor.report import fail, ok, skip, warn
from mip_rt.errors import MipRtError
from mip_rt.hardware.encoders import Encoder
from mip_rt.hardware.motor_bench import MotorBench

DUTY, PULSE_S = 0.2, 0.4
MOVED = 10  # counts


def examine(patient):
    """Yields the layer's Checks."""
    try:
        bench = open_bench(patient)
    except MipRtError as error:
        blue = patient.pins.name == "beaglebone-blue" and error.code == "pwm_missing"
        words = " On the Blue no device tree from 6.1 on enables the motors' PWM." if blue else ""
        yield fail("pwm", error.sentence + words, error.cure)
        return
    try:
        yield _read_back(patient, bench)
        yield ok("lines", "direction lines and the enable line (held low by the guard) are ours.")
        warnings = patient.guard.warnings
        if warnings:
            yield warn("guard", warnings[0].partition(":")[2].strip() + ".", "As said; see the layer realtime.")
        if patient.person is not None:
            yield from _what_turns(patient, bench)
    except MipRtError as error:
        yield as_check("pulse", error)
    finally:
        bench.close()


def open_bench(patient) -> MotorBench:
    """The motors of the patient, off, the guard holding their enable line."""
    from mip_rt import robots  # the frames for which the compiled write is in the cache
    from mip_rt.hardware import compiled_io

    layout = robots.layout(patient.config.robot)
    rows = np.zeros(1, layout.dtype)
    if compiled_io.JIT_DISABLED:
        rows = rows.view(np.recarray)
    period_ns = round(1e9 / patient.config.motor.pwm_frequency_hz)
    return MotorBench(patient.kernel, patient.pins, patient.config.motors.channels, period_ns, patient.guard, rows)


def _read_back(patient, bench):
    period_ns = round(1e9 / patient.config.motor.pwm_frequency_hz)
    outputs = patient.config.motors.channels
    wrong = [f"output {output}: {sentence}" for output, found in zip(outputs, bench.differences()) for sentence in found]
    if wrong:
        return fail("pwm", "; ".join(wrong) + ".", "Stop other programs that use PWM; both channels of a chip share their period; then reboot.")
    return ok("pwm", f"{len(patient.config.motors.channels)} channels at {1e6 / period_ns:.0f} kHz, duty 0, read back.")


def _what_turns(patient, bench):
    person, config = patient.person, patient.config
    if not person.agrees(
        f"Each motor will now turn for {PULSE_S:g} s at {DUTY:.0%} duty. Take the robot off the ground, wheels free, hands away. Type yes to go on."
    ):
        yield skip("turning", "you did not agree to motors moving", "mip-rt doctor --interactive, and type yes.")
        return
    person.act(("lift",))
    encoders = [Encoder(patient.kernel, patient.pins.encoders[channel - 1]) for channel in config.encoders.channels]
    try:
        for encoder in encoders:
            encoder.start()
        found = {}
        for wheel, output in enumerate(config.motors.channels):
            check, turned = _one(patient, bench, encoders, wheel, output)
            yield check
            if turned is not None:
                found[wheel] = turned
        yield from _write(patient, found)
    finally:
        for encoder in encoders:
            encoder.close()


def _one(patient, bench, encoders, wheel, output):
    """(Check, (wheel that turned, sign of its turn) or None) of one output."""
    config, person, name = patient.config, patient.person, f"output{output}"
    if not person.agrees(f"Motor output {output}: type yes, then watch which wheel turns."):
        return skip(name, "you did not agree to it moving"), None
    before = [encoder.read() for encoder in encoders]
    bench.pulse(wheel, DUTY, PULSE_S)
    patient.kernel.sleep(0.1)
    moved = [(encoder.read() - start) * sign for encoder, start, sign in zip(encoders, before, config.encoders.signs)]
    said = person.chooses("Which wheel turned? Its number, or 0 for none.", [str(i) for i in range(len(encoders) + 1)], ("seen", wheel))
    seen, most = int(said) - 1, int(np.argmax(np.abs(moved)))
    if seen < 0:
        if abs(moved[most]) > MOVED:
            return fail(name, f"you saw nothing turn, but encoder {most + 1} moved by {moved[most]:+d} counts.", "Look again: mip-rt doctor --interactive."), None
        return fail(name, "no wheel turned.", "Check the motors' supply, their plugs, the driver's enable line and the direction pads (board.pads)."), None
    if abs(moved[most]) <= MOVED:
        return fail(name, f"wheel {seen + 1} turned, no encoder moved.", f"Check the plug of encoder {config.encoders.channels[seen]}."), None
    if seen != most:
        return fail(name, f"wheel {seen + 1} turned, but it is encoder {most + 1} that moved.",
                    "Put the encoders' plugs, or encoders.channels, into the order of the wheels."), None  # fmt: skip
    turned = (seen, 1 if moved[most] > 0 else -1)
    wanted = (wheel, config.motors.signs[wheel])
    sentence = f"wheel {seen + 1} turned by {moved[most]:+d} counts at positive duty"
    if turned == wanted:
        return ok(name, f"{sentence}, as motors.channels and motors.signs say."), turned
    return fail(name, f"{sentence}; the configuration expects wheel {wheel + 1} with sign {wanted[1]:+d}.",
                "Let doctor write what it found (it asks at the end), or change motors.channels and motors.signs."), turned  # fmt: skip


def _write(patient, found):
    config = patient.config
    count = len(config.motors.channels)
    if len(found) != count or sorted(seen for seen, _ in found.values()) != list(range(count)):
        return
    channels, signs = [0] * count, [0] * count
    for wheel, (seen, sign) in found.items():
        channels[seen], signs[seen] = config.motors.channels[wheel], sign
    if (tuple(channels), tuple(signs)) == (tuple(config.motors.channels), tuple(config.motors.signs)):
        return
    from mip_rt.config.edit import set_values

    values = {"motors.channels": channels, "motors.signs": signs}
    if patient.config_path is None:
        yield warn("written", f"found: motors.channels {channels}, motors.signs {signs}.", "A dry run changes only a file that --config names.")
    elif patient.person.agrees(f"Write motors.channels {channels} and motors.signs {signs} into {patient.config_path}? Type yes."):
        set_values(patient.config_path, values)
        yield ok("written", f"motors.channels {channels} and motors.signs {signs} stand in {patient.config_path} now.")
    else:
        yield warn("written", f"found: motors.channels {channels}, motors.signs {signs}; not written.", f"Write them into {patient.config_path}.")
