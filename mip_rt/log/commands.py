"""The verb `mip-rt log`: one module an action, each with `add_arguments(parser)` and `run(arguments) -> exit code`."""

import importlib
import os
import sys

ACTIONS = {
    "info": ("mip_rt.log.info", "what happened: rate, latencies, faults, limits, states, configuration", "mip-rt log info"),
    "plot": ("mip_rt.log.plot", "one page that answers why it fell: PNG or interactive HTML", "mip-rt log plot -o fall.html"),
    "export": ("mip_rt.log.export", "CSV, NPZ, Parquet or MCAP", "mip-rt log export run.ring -o run.mcap"),
    "tail": ("mip_rt.log.tail", "chosen fields of a running loop, live", "mip-rt log tail --rate 10 --fields battery_v,duty"),
    "diff": ("mip_rt.log.difference", "first and largest difference of each field of two logs", "mip-rt log diff a.ring b.ring"),
    "spectrum": ("mip_rt.log.spectrum", "Welch spectrum of fields while balancing", "mip-rt log spectrum --fields gyro_rad_s"),
}


def add_arguments(parser) -> None:
    """Declares the actions and their arguments."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for name, (module, words, example) in ACTIONS.items():
        sub = actions.add_parser(name, help=words, description=words, epilog=f"example: {example}")
        importlib.import_module(module).add_arguments(sub)


def run(arguments) -> int:
    """Exit code of the action.

    Raises:
        MipRtError: the log cannot be read, a field or window is not in it, a package is missing.
    """
    try:
        code = importlib.import_module(ACTIONS[arguments.action][0]).run(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader of a pipe, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 0
