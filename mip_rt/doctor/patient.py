"""What is examined: the kernel boundary of a robot or of a dry run, its configuration, and the person beside it."""

from dataclasses import dataclass, field

from mip_rt.errors import MipRtError


@dataclass
class Patient:
    """The robot under examination.

    Attributes:
        kernel: hardware.kernel.Kernel.
        config, config_path: configuration, and the file that may be changed; None in a dry run from the shipped one.
        start_guard: callable() -> guard_client.GuardClient, started when the motors are first looked at.
        image: (path, sha256) of another DMP image than the configuration's; None on a robot.
        remote_device: path of the remote's port.
        person: interview.Person, None where nobody is to be asked.
        pins: hardware.boards.Board, once the board is known.
        notes: what one layer found and another needs: measured bus clock, windows of the IMU.
    """

    kernel: object
    config: object
    config_path: str | None
    start_guard: object
    image: tuple | None = None
    remote_device: str | None = None
    person: object = None
    pins: object = None
    notes: dict = field(default_factory=dict)
    _guard: object = None

    @property
    def guard(self):
        """The guard, started now if it was not."""
        if self._guard is None:
            self._guard = self.start_guard()
        return self._guard

    def text(self, *parts: str) -> str:
        """A small file below the root, stripped; empty where it cannot be read."""
        try:
            return self.kernel.path(*parts).read_text(errors="replace").strip("\0 \n")
        except OSError:
            return ""

    def close(self) -> None:
        """Ends the guard, if one was started."""
        if self._guard is not None:
            self._guard.close()


def as_check(name: str, error: MipRtError):
    """The line for a refusal."""
    from mip_rt.doctor.report import fail

    return fail(name, error.sentence, error.cure)
