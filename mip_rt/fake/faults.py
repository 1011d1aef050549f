"""The faults that a scenario can inject, as data: boundary, parameters, what is promised, what it means.

What each does stands in `faults_imu`, `faults_io` and `faults_process`, in a function of the same name; all of them act on the fakes of the
kernel boundary, never on drivers. `at_s` and `for_s` are the scenario's; a fault without `for_s` is a single event.
"""

from dataclasses import dataclass
from typing import NamedTuple

from mip_rt.config.fields import Choice, Field, Integer, Number, Text

OFF = "motors off"  # enable low or duty 0, within bound_s of the beginning
ZERO = "command zero"  # the remote's commands are zero within bound_s of its last byte
RIDES = "balances on"  # neither a fault nor a fall
ANY = "no promise broken"  # what follows depends on the moment; the general promises hold


@dataclass(frozen=True)
class Drawn(Number):
    """A number with the range from which a campaign draws it."""

    draw: tuple = ()


@dataclass(frozen=True)
class DrawnInteger(Integer):
    """Likewise a whole number."""

    draw: tuple = ()


class FaultKind(NamedTuple):
    """One fault.

    Attributes:
        module: module of `mip_rt.fake` with the function of that name.
        boundary: where it is injected.
        parameters: Field by name, beside at_s.
        promise: OFF, ZERO, RIDES or ANY, for the parameters' shipped values while the robot balances.
        bound_s: of OFF and ZERO.
        weight: how often a campaign draws it, 0 for never (it needs a process of its own).
        meaning: one sentence.
    """

    module: str
    boundary: str
    parameters: dict
    promise: str
    bound_s: float
    meaning: str
    weight: int = 2

    @property
    def lasts(self) -> bool:
        """It has a duration."""
        return "for_s" in self.parameters


def _for(default: float = 0.5, draw: tuple = (0.02, 0.8)) -> Field:
    return Drawn(default, "How long.", unit="s", low=0.001, high=1e6, draw=draw)


def _probability(default: float = 1.0, draw: tuple = (0.05, 1.0)) -> Field:
    return Drawn(default, "Of each chance to strike.", low=0.0, high=1.0, draw=draw)


BURST = DrawnInteger(1, "Strikes in a row, once it strikes.", low=1, high=100000, draw=(1, 6))
WHEEL = DrawnInteger(1, "Which wheel.", low=1, high=3, draw=(1, 3))
STRIKES = {"for_s": _for(), "probability": _probability(), "burst": BURST}
SELDOM = {**STRIKES, "for_s": _for(1.0), "probability": _probability(0.05, (0.01, 0.3))}
AXIS = Choice("x", "Which axis of the chip.", choices=("x", "y", "z"))


def _number(default, doc, unit, low, high, draw):
    return Drawn(default, doc, unit=unit, low=low, high=high, draw=draw)


FAULTS = {
    # -- I2C bus
    "i2c_nack": FaultKind("faults_imu", "I2C", STRIKES, OFF, 0.05, "transfers end with EREMOTEIO: the chip does not answer"),
    "i2c_error": FaultKind("faults_imu", "I2C", {**STRIKES, "error": Choice("EIO", "Which errno.", choices=("EIO", "EAGAIN", "EBUSY"))},
                           OFF, 0.05, "transfers end with a controller's error"),
    "i2c_timeout": FaultKind("faults_imu", "I2C", {**STRIKES, "wait_s": _number(0.01, "The call blocks for so long.", "s", 0.0, 2.0, (0.0, 0.02))},
                             OFF, 0.05, "transfers block and end with ETIMEDOUT"),
    "i2c_bit_flips": FaultKind("faults_imu", "I2C", {**SELDOM, "bits": DrawnInteger(1, "Flipped bits in a transfer.", low=1, high=64, draw=(1, 6))},
                               ANY, 0.0, "bits of what is read are flipped"),
    "i2c_short_read": FaultKind("faults_imu", "I2C", SELDOM, ANY, 0.0, "a read breaks off, the rest is 0xff"),
    "i2c_lost_once": FaultKind("faults_imu", "I2C", {"count": DrawnInteger(2, "Transfers that fail.", low=1, high=1000, draw=(1, 4))}, RIDES, 0.0,
                               "a tick's transfer and its repetition fail once"),
    # -- interrupt line
    "interrupt_lost": FaultKind("faults_imu", "interrupt", STRIKES, OFF, 0.05, "edges do not arrive, the packets do"),
    "interrupt_lost_some": FaultKind("faults_imu", "interrupt", {**SELDOM, "for_s": _for(2.0, (0.1, 3.0)), "probability": _probability(0.05, (0.01, 0.1)),
                                     "burst": DrawnInteger(1, "Strikes in a row.", low=1, high=100, draw=(1, 2))}, ANY, 0.0,
                                     "now and then an edge does not arrive"),
    "interrupt_doubled": FaultKind("faults_imu", "interrupt", {**STRIKES, "for_s": _for(2.0, (0.1, 3.0))}, ANY, 0.0, "edges arrive twice"),
    "interrupt_late": FaultKind("faults_imu", "interrupt", {**STRIKES, "delay_s": _number(0.002, "By how much.", "s", 0.0, 0.0049, (0.0002, 0.0045))},
                                RIDES, 0.0, "the loop is woken late"),
    # -- FIFO
    "fifo_overflow": FaultKind("faults_imu", "FIFO", {}, ANY, 0.0, "the FIFO is full of old packets"),
    "fifo_misaligned": FaultKind("faults_imu", "FIFO", {"bytes": DrawnInteger(5, "Stray bytes.", low=1, high=31, draw=(1, 31))}, OFF, 0.05,
                                 "stray bytes stand before the next packet"),
    # -- IMU
    "imu_silent": FaultKind("faults_imu", "IMU", {"for_s": _for(0.5, (0.02, 0.8))}, OFF, 0.05, "the chip stops: no interrupt, no packet"),
    "imu_dropped": FaultKind("faults_imu", "IMU", STRIKES, OFF, 0.05, "interrupts come, the FIFO stays empty"),
    "imu_dropped_some": FaultKind("faults_imu", "IMU", {**SELDOM, "for_s": _for(2.0, (0.1, 3.0)), "probability": _probability(0.05, (0.01, 0.1)),
                                  "burst": DrawnInteger(1, "Strikes in a row.", low=1, high=100, draw=(1, 2))}, ANY, 0.0,
                                  "now and then a packet is missing; three in a row by chance are a fault"),
    "imu_frozen": FaultKind("faults_imu", "IMU", {"for_s": _for()}, OFF, 0.06, "the same packet again and again"),
    "quaternion_zero": FaultKind("faults_imu", "IMU", STRIKES, OFF, 0.05, "the quaternion is 0, 0, 0, 0, which normalises to NaN"),
    "quaternion_ones": FaultKind("faults_imu", "IMU", STRIKES, OFF, 0.05, "all bits of the packet are one"),
    "packet_noise": FaultKind("faults_imu", "IMU", STRIKES, OFF, 0.05, "packets of random bytes"),
    "attitude_jump": FaultKind("faults_imu", "IMU", {**SELDOM, "angle_rad": _number(0.3, "Tilt added to the quaternion.", "rad", 0.0, 3.2, (0.02, 0.6))},
                               ANY, 0.0, "the quaternion is valid, but wrong for single samples"),
    "gyro_spike": FaultKind("faults_imu", "IMU", {**SELDOM, "axis": AXIS, "size_rad_s": _number(3.0, "Added to the rate.", "rad/s", -40, 40, (-20, 20))},
                            ANY, 0.0, "single rates are wrong"),
    "gyro_bias": FaultKind("faults_imu", "IMU", {"for_s": _for(2.0, (0.1, 3.0)), "axis": AXIS,
                           "size_rad_s": _number(0.03, "Added to the rate.", "rad/s", -40, 40, (-0.1, 0.1))}, ANY, 0.0, "the rate at rest changes"),
    "accel_spike": FaultKind("faults_imu", "IMU", {**SELDOM, "axis": AXIS, "size_m_s2": _number(10.0, "Added.", "m/s2", -300, 300, (-80, 80))},
                             ANY, 0.0, "single accelerations are wrong"),
    "accel_bias": FaultKind("faults_imu", "IMU", {"for_s": _for(2.0, (0.1, 3.0)), "axis": AXIS,
                            "size_m_s2": _number(0.3, "Added.", "m/s2", -300, 300, (-1.0, 1.0))}, ANY, 0.0, "the acceleration is offset"),
    # -- encoders
    "encoder_stuck": FaultKind("faults_io", "encoder", {"for_s": _for(1.0), "wheel": WHEEL}, ANY, 0.0, "a count stands still"),
    "encoder_jump": FaultKind("faults_io", "encoder", {"wheel": WHEEL, "counts": DrawnInteger(5000, "By how much.", low=-(2**31), high=2**31 - 1,
                              draw=(-100000, 100000))}, RIDES, 0.0, "a count jumps once and goes on from there"),
    "encoder_sign": FaultKind("faults_io", "encoder", {"for_s": _for(1.0), "wheel": WHEEL}, ANY, 0.0, "a count runs backwards"),
    "encoder_wrap": FaultKind("faults_io", "encoder", {"wheel": WHEEL, "margin": DrawnInteger(20, "Counts before the end.", low=0, high=2**31 - 1,
                              draw=(0, 400))}, RIDES, 0.0, "a count jumps to just below 2^32, and wraps as the wheel goes on"),
    "encoder_error": FaultKind("faults_io", "encoder", {"for_s": _for(0.02, (0.005, 0.5)), "wheel": WHEEL}, ANY, 0.0, "reading a count gives EIO"),
    "encoder_garbage": FaultKind("faults_io", "encoder", {"for_s": _for(0.02, (0.005, 0.5)), "wheel": WHEEL,
                                 "text": Choice("word", "What the file holds.", choices=("word", "empty", "huge", "negative", "binary"))},
                                 ANY, 0.0, "a count's file holds no count"),
    # -- PWM and direction lines
    "pwm_refused": FaultKind("faults_io", "PWM", {"for_s": _for(), "wheel": WHEEL,
                             "error": Choice("EINVAL", "Which errno.", choices=("EINVAL", "EIO", "ENOSPC"))}, OFF, 0.05,
                             "the kernel refuses a wheel's duty"),
    "direction_refused": FaultKind("faults_io", "GPIO", {"for_s": _for()}, ANY, 0.0, "the kernel refuses to turn a direction line"),
    # -- battery
    "adc_value": FaultKind("faults_io", "ADC", {"for_s": _for(1.0, (0.1, 3.0)), "raw": DrawnInteger(0, "The ADC's reading.", low=0, high=4095,
                           draw=(0, 4095))}, ANY, 0.0, "the battery reads as something else"),
    "adc_garbage": FaultKind("faults_io", "ADC", {"for_s": _for(1.0, (0.1, 3.0)),
                             "text": Choice("word", "What the file holds.", choices=("word", "empty", "huge", "negative", "binary"))}, RIDES, 0.0,
                             "the battery's file holds no number"),
    "adc_error": FaultKind("faults_io", "ADC", {"for_s": _for(1.0, (0.1, 3.0))}, RIDES, 0.0, "reading the battery gives EIO"),
    # -- remote
    "serial_lost": FaultKind("faults_io", "serial", {**STRIKES, "for_s": _for(2.0, (0.1, 3.0)), "probability": _probability(0.3)}, RIDES, 0.0,
                             "frames are lost"),
    "serial_split": FaultKind("faults_io", "serial", {"for_s": _for(2.0, (0.1, 3.0))}, RIDES, 0.0, "frames arrive in pieces"),
    "serial_bits": FaultKind("faults_io", "serial", {**SELDOM, "for_s": _for(2.0, (0.1, 3.0))}, RIDES, 0.0, "bits are flipped"),
    "serial_garbage": FaultKind("faults_io", "serial", {**STRIKES, "for_s": _for(2.0, (0.1, 3.0)), "bytes": DrawnInteger(20, "At a time.", low=1,
                                high=4096, draw=(1, 200))}, ANY, 0.0, "random bytes instead of frames"),
    "serial_replayed": FaultKind("faults_io", "serial", {"for_s": _for(2.0, (0.1, 3.0))}, RIDES, 0.0, "the last frame comes again and again"),
    "serial_silent": FaultKind("faults_io", "serial", {"for_s": _for(30.0, (0.1, 3.0))}, ZERO, 0.5, "nothing comes, the link stays connected"),
    "serial_error": FaultKind("faults_io", "serial", {"for_s": _for(2.0, (0.1, 3.0))}, ZERO, 0.5, "reading the port gives EIO: the device is gone"),
    # -- processor, clock, files
    "cpu_stall": FaultKind("faults_process", "CPU", {"stall_s": _number(0.012, "How long the loop does not run.", "s", 0.0, 60.0, (0.001, 0.3))}, RIDES,
                           0.0, "the loop does not run for a moment, the world does"),
    "cpu_hung": FaultKind("faults_process", "CPU", {"stall_s": _number(0.5, "How long the loop does not run.", "s", 0.0, 60.0, (0.1, 1.0))}, OFF, 0.1,
                          "the loop hangs: the guard drops the enable line"),
    "clock_step": FaultKind("faults_process", "clock", {"for_s": _for(2.0, (0.1, 3.0)), "step_s": _number(-3600.0, "By how much.", "s", -1e9, 1e9,
                            (-1e6, 1e6))}, RIDES, 0.0, "the realtime clock is set to another time"),
    "disk_full": FaultKind("faults_process", "disk", {"for_s": _for(2.0, (0.1, 3.0))}, RIDES, 0.0,
                           "the recorder's files cannot grow; nothing where there is no recorder"),
    "config_changed": FaultKind("faults_process", "file", {"for_s": _for(2.0, (0.1, 3.0))}, RIDES, 0.0,
                                "the configuration file holds nonsense; only a file named by --config is touched, and restored"),
    "signal": FaultKind("faults_process", "process", {"name": Text("SIGTERM", "Which signal.", pattern="SIG[A-Z0-9]+", wanted="a signal, as SIGTERM")},
                        ANY, 0.0, "the process gets a signal", weight=0),
    "child_killed": FaultKind("faults_process", "process", {"name": Text("recorder", "Part of the child's command line.")}, ANY, 0.0,
                              "a child process is killed", weight=0),
    # -- hands
    "tipped_over": FaultKind("faults_process", "robot", {"lean_rad": _number(1.3, "The body is turned to this roll.", "rad", -1.4, 1.4, (1.0, 1.35))},
                             OFF, 0.01, "the robot is thrown over"),
    "pushed": FaultKind("faults_process", "robot", {"rate_rad_s": _number(0.2, "Added to the roll rate.", "rad/s", -20, 20, (-0.6, 0.6))}, ANY, 0.0,
                        "somebody pushes the robot"),
}  # fmt: skip


def defaults(name: str) -> dict:
    """Shipped values of a fault's parameters."""
    return {key: field.default for key, field in FAULTS[name].parameters.items()}


def drawn(name: str, random) -> dict:
    """Parameters drawn from the campaign's ranges by a random.Random."""
    found = {}
    for key, field in FAULTS[name].parameters.items():
        if isinstance(field, DrawnInteger):
            found[key] = random.randint(*field.draw)
        elif isinstance(field, Drawn):
            found[key] = float(f"{random.uniform(*field.draw):.4g}")
        elif isinstance(field, Choice):
            found[key] = random.choice(field.choices)
        else:
            found[key] = field.default
    return found


def documentation() -> str:
    """Markdown table of all faults."""
    lines = ["| fault | boundary | parameters (shipped value) | meaning |", "|---|---|---|---|"]
    for name, kind in FAULTS.items():
        listed = ", ".join(f"{key} ({_shown(field)})" for key, field in kind.parameters.items())
        lines.append(f"| `{name}` | {kind.boundary} | {listed or 'none'} | {kind.meaning} |")
    return "\n".join(lines) + "\n"


def _shown(field) -> str:
    value = f"{field.default:g}" if isinstance(field.default, float) else str(field.default)
    return f"{value} {field.unit}" if getattr(field, "unit", "") else value
