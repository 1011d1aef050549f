"""Opens what doctor and calibrate work on: the robot, or a dry run's board with whatever ails it."""

from contextlib import contextmanager

from mip_rt.doctor.interview import Person
from mip_rt.doctor.patient import Patient
from mip_rt.errors import ConfigError


def add_arguments(parser) -> None:
    """The arguments that both verbs have."""
    parser.add_argument("--config", metavar="FILE", help="configuration file (default: the installed or shipped one)")
    parser.add_argument("--robot", choices=("mbbr", "edumip"), help="default: the file's, or mbbr")
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help="change one value of the configuration")
    parser.add_argument("--remote", metavar="PTY|FILE", help="the remote's port (default: the configuration's)")
    parser.add_argument("--dry-run", action="store_true", help="on a PC: a simulated board, chips and person")
    parser.add_argument("--fault", metavar="NAME", action="append", default=[], help="dry run: something is wrong with the board; `--fault list` shows what")


@contextmanager
def open_patient(arguments, interactive: bool):
    """The Patient of these arguments; closed afterwards, motors off.

    Raises:
        MipRtError: configuration or fault unknown.
    """
    from mip_rt import config as configuration

    path = arguments.config or configuration.default_path(arguments.robot or "mbbr")
    config = configuration.load(path, dict(configuration.parse_override(text) for text in arguments.set), arguments.robot)
    if arguments.dry_run:
        from mip_rt.fake import patient as fake_patient

        with fake_patient.opened(config, arguments.fault) as (bench, hands):
            patient = Patient(
                bench.kernel, config, arguments.config, lambda: bench.guard, (bench.image_path, bench.image_sha256),
                arguments.remote or bench.remote.device, Person(hands) if interactive else None,
            )  # fmt: skip
            try:
                yield patient
            finally:
                patient.close()
        return
    if arguments.fault:
        raise ConfigError("--fault needs --dry-run.", "A robot has its own faults.", "arguments")
    from mip_rt import guard_client
    from mip_rt.hardware.kernel import Kernel

    patient = Patient(Kernel(), config, str(path), lambda: guard_client.start(config), None, arguments.remote, Person() if interactive else None)
    try:
        yield patient
    finally:
        patient.close()


def faults_in_words() -> str:
    """What `--fault` knows, one a line."""
    from mip_rt.fake.ailments import AILMENTS

    return "\n".join(f"{name:<20} {ailment.meaning}" for name, ailment in AILMENTS.items())
