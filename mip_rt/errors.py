"""The exceptions of mip-rt. Every refusal has a code, a sentence and a cure.

All of them derive from `MipRtError`; a caller that wants to tell the user why something was refused catches that one
class and prints it. The code is stable (tests, the monitor and scripts compare it), the words may change.
"""


class MipRtError(Exception):
    """A refusal that a user can act upon.

    Attributes:
        code: stable identifier in lower case, such as ``imu_absent``.
        sentence: what happened, in one sentence, with the figures that matter.
        cure: what to do about it, in the imperative.
    """

    code = "error"

    def __init__(self, sentence: str, cure: str = "", code: str | None = None):
        self.sentence = sentence
        self.cure = cure
        if code is not None:
            self.code = code
        super().__init__(f"{sentence} {cure}".strip())

    def __str__(self) -> str:
        return f"{self.code}: {self.sentence}" + (f"\n  cure: {self.cure}" if self.cure else "")


class ConfigError(MipRtError):
    """A configuration, scenario or override is not valid."""

    code = "config_invalid"


class HardwareError(MipRtError):
    """A device does not answer, or does not answer as it should."""

    code = "hardware"


class ImuError(HardwareError):
    """The MPU-9250 or its DMP refuses, is absent, or is something else."""

    code = "imu"


class DmpImageError(ImuError):
    """The DMP image is missing, or is not the one the configuration names."""

    code = "dmp_image"


class EncoderError(HardwareError):
    """An eQEP counter is missing or does not take its settings."""

    code = "encoder"


class MotorError(HardwareError):
    """A PWM channel, direction line or enable line is missing or refuses a write."""

    code = "motor"


class GpioError(HardwareError):
    """A GPIO chip or line cannot be found or requested."""

    code = "gpio"


class RemoteError(HardwareError):
    """The remote's serial port cannot be opened or set up."""

    code = "remote"


class LogError(MipRtError):
    """A log cannot be created or read."""

    code = "log"
