"""The verb `mip-rt config`."""

import sys

from mip_rt.config import default_path, load, parse_override
from mip_rt.config.documentation import documentation, template
from mip_rt.config.robots import ROBOTS
from mip_rt.errors import ConfigError


def add_arguments(parser) -> None:
    """Declares the verb's arguments."""
    parser.add_argument("action", choices=("check", "show", "template", "docs"),
                        help="check a file; show the effective values; print a commented template; print the reference")  # fmt: skip
    parser.add_argument("--robot", choices=tuple(ROBOTS), help="default: the file's, or mbbr")
    parser.add_argument("--config", metavar="FILE", help="configuration file (default: the installed or shipped one)")
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help="change one value")


def run(arguments) -> int:
    """Exit code 0, or 2 for an invalid configuration."""
    if arguments.action == "template":
        sys.stdout.write(template(arguments.robot or "mbbr"))
        return 0
    if arguments.action == "docs":
        sys.stdout.write(documentation(arguments.robot or "mbbr"))
        return 0
    try:
        path = arguments.config or default_path(arguments.robot or "mbbr")
        config = load(path, dict(parse_override(text) for text in arguments.set), arguments.robot)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    print(config.to_yaml() if arguments.action == "show" else f"{path}: ok")
    return 0
