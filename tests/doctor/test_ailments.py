"""Doctor against a board with one thing wrong: the line that must say so does, with a cure; and nothing ever raises, hangs or arms."""

import argparse

import pytest

from mip_rt.doctor.examination import LAYERS, examine
from mip_rt.doctor.interview import Person
from mip_rt.doctor.open_patient import open_patient
from mip_rt.doctor.report import FAIL, PASS, SKIP, WARN
from mip_rt.fake.ailments import AILMENTS
from mip_rt.hardware.boards import GPIO

LIMIT_S = 120.0  # of virtual time: a dead bus costs seconds, nothing costs minutes
WORDS = {  # what the cure or the sentence must name, beside being there
    "kernel-driver": ("inv-mpu6050-i2c", "unbind", "blacklist"), "e1-pad": ("0x9a0", "overlay"), "overlay-eqep0": ("P9_25", "uEnv.txt"),
    "overlay-eqep2": ("P8_41",), "counter-unclocked": ("ceiling", "clock"), "bus-100-khz": ("100 kHz", "3.66 ms", "400 kHz"),
    "blue-without-pwm": ("overlay", "6.1"), "debian-13": ("Debian 13",), "llvm-abort": ("SIGABRT", "cortex-a8"), "dmp-rate": ("100.", "200 Hz"),
    "bus-nack": ("121", "acknowledged"), "bus-timeout": ("110", "SDA"), "bus-error": ("error 5", "cable"), "bus-arbitration": ("11", "master"),
    "bus-busy": ("16", "unbind"), "no-interrupts": ("P9_25",), "robot-runs": ("systemctl stop mip-rt",), "wrong-baud": ("baud",),
    "no-image": ("librobotcontrol",), "motors-swapped": ("wheel 2",), "dead-channel": ("E1",), "irq-thread": ("chrt",),
}  # fmt: skip


class Scripted(Person):
    """Says yes, and sees what the simulated robot does."""

    def __init__(self, hands):
        super().__init__(hands)
        self.asked = []

    def _answer(self, text, hint):
        self.asked.append(text)
        return "yes"

    def chooses(self, text, choices, act=None):
        wheel, sign = self._hands.drives[act[1]]
        return str(wheel + 1 if sign else 0)


def arguments(*faults, config=None, robot=None, **changes):
    return argparse.Namespace(config=config, robot=robot, set=[f"{k.replace('__', '.')}={v}" for k, v in changes.items()], remote=None, dry_run=True,
                              fault=list(faults))  # fmt: skip


def needed(line, person):
    """The layer of the line, and those whose failure would hide it."""
    layer = line.partition(".")[0]
    names = {"board", layer} | ({"i2c"} if layer == "imu" else set()) | ({"encoders"} if person else set())
    return [each for each in LAYERS if each.name in names]


def diagnose(*faults, layers=None, person=False, **changes):
    """(report, person or None, seconds of virtual time) of a dry run; the enable line must never have been high unless a person agreed."""
    with open_patient(arguments(*faults, **changes), False) as patient:
        kernel = patient.kernel
        if kernel.command.probe is None:
            kernel.command.probe = (0, "cache\t/kept\t30\n")
        if person:
            from mip_rt.fake.hands import Hands

            hands = next(f.__self__ for f in kernel_filters(kernel) if isinstance(getattr(f, "__self__", None), Hands))
            patient.person = Scripted(hands)
        levels = set()
        whole = kernel.gpio.ioctl
        kernel.gpio.ioctl = lambda *rest: (whole(*rest), levels.add(kernel.gpio.line_value(GPIO[0], 20)))[0]
        begin_ns = kernel.monotonic_ns()
        report = examine(patient, layers or LAYERS)
        seconds = (kernel.monotonic_ns() - begin_ns) * 1e-9
        assert person or levels <= {0}, "the enable line was high"
        assert kernel.gpio.line_value(GPIO[0], 20) == 0
        return report, patient.person, seconds


def kernel_filters(kernel):
    """Filters that stand before the chip, by which the hands can be found."""
    call = kernel.chip.sample
    while hasattr(call, "filter"):
        yield call.filter
        call = call.call


def test_a_healthy_board_passes_every_line():
    """A warning on a healthy robot is read by nobody."""
    report, _, _ = diagnose()
    found = [(layer, check) for layer, checks in report.layers.items() for check in checks if layer not in ("realtime", "software")]
    assert len(found) >= 20 and {check.verdict for _, check in found} == {PASS}, [each for each in found if each[1].verdict != PASS]
    assert "0.92 ms" in report.find("i2c", "clock").sentence and "0.41 ms" in report.find("i2c", "clock").sentence


@pytest.mark.parametrize("name", AILMENTS)
def test_each_ailment_has_its_line_and_a_cure(name):
    ailment = AILMENTS[name]
    layer, _, check = ailment.line.partition(".")
    changes = {"board": "beaglebone-blue"} if "blue" in name else {}
    report, _, seconds = diagnose(name, layers=needed(ailment.line, ailment.person), person=ailment.person, **changes)
    found = report.find(layer, check)
    assert found is not None and found.verdict == ailment.verdict, (found, report.layers.get(layer))
    assert found.cure and found.sentence.endswith((".", "!", "?"))
    for word in WORDS.get(name, ()):
        assert word in found.sentence + found.cure, (word, found)
    assert seconds < LIMIT_S


def test_later_layers_say_why_they_were_not_looked_at():
    report, _, _ = diagnose("robot-runs", layers=[layer for layer in LAYERS if layer.name != "software"])
    for layer in ("i2c", "imu", "encoders", "motors", "power", "remote"):
        (only,) = report.layers[layer]
        assert only.verdict == SKIP and "services.mip-rt failed" in only.sentence
    report, _, _ = diagnose("no-bus", layers=needed("imu.start", False))
    assert report.layers["imu"][0].sentence == "not checked because i2c.device failed"


def test_a_person_who_does_not_say_yes_moves_no_motor():
    class Refusing(Scripted):
        def _answer(self, text, hint):
            return "y"  # not a yes

    with open_patient(arguments(), True) as patient:
        patient.person = Refusing(patient.person._hands)
        levels = set()
        whole = patient.kernel.gpio.ioctl
        patient.kernel.gpio.ioctl = lambda *rest: (whole(*rest), levels.add(patient.kernel.gpio.line_value(GPIO[0], 20)))[0]
        report = examine(patient, needed("motors.pwm", False))
        assert report.find("motors", "turning").verdict == SKIP and levels <= {0}


def test_what_turned_is_written_into_the_configuration_after_asking(tmp_path):
    """Motors 1 and 2 exchanged and one reversed: doctor writes channels and signs, keeps the comments, and then finds everything in order."""
    from mip_rt import config as configuration

    file = tmp_path / "my.yaml"
    file.write_text(configuration.default_path("mbbr").read_text())
    lines = len(file.read_text().splitlines())
    with open_patient(arguments(config=str(file)), True) as patient:
        hands = patient.person._hands
        hands.drives[:] = [(1, 1), (0, -1), (2, 1)]
        patient.person = Scripted(hands)
        report = examine(patient, needed("motors.pwm", False))
    assert report.find("motors", "written").verdict == PASS
    written = configuration.load(file)
    assert written.motors.channels == (3, 1, 4) and "# Motor output of wheels 1 to 3 (A)." in file.read_text()
    assert len(file.read_text().splitlines()) == lines


def test_the_shipped_configuration_is_not_written_by_a_dry_run():
    from mip_rt import config as configuration

    before = configuration.default_path("mbbr").read_text()
    report, _, _ = diagnose("motor-sign", layers=needed("motors.pwm", False), person=True)
    assert report.find("motors", "written").verdict == WARN and configuration.default_path("mbbr").read_text() == before


def test_the_edumip_and_the_blue_are_examined_as_well():
    report, _, _ = diagnose(layers=[layer for layer in LAYERS if layer.name not in ("software", "realtime")], robot="edumip", person=True)
    assert report.count(FAIL) == 0 and report.count(WARN) == 0, report.as_dict()
