"""The verbs of `mip-rt`. No logic here: each verb is a module with `add_arguments(parser)` and `run(arguments) -> exit code`.

Only the module of the verb that was asked for is imported, so that `mip-rt --help` and `mip-rt config check` answer at once.
"""

import argparse
import importlib
import sys
from typing import NamedTuple

from mip_rt import __version__
from mip_rt.errors import ConfigError, MipRtError

EXIT_CODES = """exit codes: 0 clean stop, 1 the robot fell or ended in a fault (replay: something differs), 2 bad arguments or configuration,
3 a device refused, 4 this is no BeagleBone"""


class Verb(NamedTuple):
    """One verb: the module that does the work, one line of help, an example."""

    module: str
    help: str
    example: str


VERBS = {
    "config": Verb("mip_rt.config.commands", "check, show, template or document the configuration", "mip-rt config check --config my.yaml"),
    "replay": Verb("mip_rt.log.replay", "run a log again through the same code; equality is asserted", "mip-rt replay dry-run-hold-seed1.ring"),
    "log": Verb("mip_rt.log.commands", "look into a log: info, plot, export, tail, diff, spectrum", "mip-rt log info"),
    "monitor": Verb("mip_rt.monitor.commands", "watch a running loop: terminal, JSON lines or web page", "mip-rt monitor --web"),
    "doctor": Verb("mip_rt.doctor.commands", "what is wrong with board, bus, IMU, encoders, motors, system, and what to do", "mip-rt doctor"),
    "calibrate": Verb("mip_rt.calibrate.commands", "measure this unit: gyro, level, accelerometer, encoders, motors", "mip-rt calibrate gyro"),
    "warm-up": Verb("mip_rt.warm_up", "compile everything and keep it", "mip-rt warm-up"),
    "dmp": Verb("mip_rt.dmp_commands", "get the IMU's DMP image out of what you hold; check it", "mip-rt dmp extract librobotcontrol/"),
    "firmware": Verb("mip_rt.firmware.commands", "overlay, U-Boot, udev, modprobe: show, diff, apply, revert", "mip-rt firmware diff"),
    "safety": Verb("mip_rt.safety", "print states, transitions, faults, limits and pre-arm checks as Markdown", "mip-rt safety"),
    "bench": Verb("mip_rt.lab.bench", "measure costs, estimators, robustness", "mip-rt bench steps"),
    "reproduce": Verb("mip_rt.lab.reproduce", "tables and figures of five papers, ours beside the published", "mip-rt reproduce all --out report"),
    "soak": Verb("mip_rt.lab.soak", "faults at random over hours of virtual time, promises checked", "mip-rt soak --hours 10"),
}
RUN = Verb("mip_rt.run", "", "mip-rt --dry-run --scenario drive-spin-1.0 --duration 30")


def _parser(verb: str | None) -> argparse.ArgumentParser:
    """The parser; only the asked verb's arguments are declared in full, and none of the run's where a verb is asked."""
    listed = "\n".join(f"  {name:<12} {entry.help}" for name, entry in VERBS.items())
    parser = argparse.ArgumentParser(
        prog="mip-rt",
        description="Real-time controller for balancing robots. Without a verb it runs the robot.",
        epilog=f"verbs (mip-rt VERB --help tells more):\n{listed}\n\nexample: {RUN.example}\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"mip-rt {__version__}")
    if verb is None:
        importlib.import_module(RUN.module).add_arguments(parser)
        return parser
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    entry = VERBS[verb]
    sub = verbs.add_parser(verb, help=entry.help, description=entry.help, epilog=f"example: {entry.example}\n{EXIT_CODES}",
                           formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    importlib.import_module(entry.module).add_arguments(sub)
    return parser


def main(argv=None) -> int:
    """Entry point; returns the exit code."""
    argv = sys.argv[1:] if argv is None else list(argv)
    verb = argv[0] if argv and argv[0] in VERBS else None
    try:
        parser = _parser(verb)
        if verb is None and argv and not argv[0].startswith("-"):
            from mip_rt.config.suggestion import nearest

            parser.error(f"there is no verb {argv[0]!r}{nearest(argv[0], VERBS)}")
        arguments = parser.parse_args(argv)
        return importlib.import_module((VERBS[verb] if verb else RUN).module).run(arguments)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except MipRtError as error:
        print(error, file=sys.stderr)
        return 4 if error.code == "board_unknown" else 3


if __name__ == "__main__":
    sys.exit(main())
