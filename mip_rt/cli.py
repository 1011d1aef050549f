"""The verbs of `mip-rt`. No logic here: each verb parses its arguments and calls the module that does the work."""

import argparse
import json
import sys

from mip_rt import __version__
from mip_rt.errors import ConfigError, MipRtError

EXIT_CODES = """exit codes: 0 clean stop, 1 the robot fell or ended in a fault, 2 bad arguments or configuration,
3 a device refused"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="mip-rt",
        description="Real-time controller for balancing robots. Without a verb it runs the robot.",
        epilog=f"example: mip-rt --dry-run --scenario drive-spin-1.0 --duration 30\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"mip-rt {__version__}")
    parser.add_argument("--config", metavar="FILE", help="configuration file (default: the installed or shipped one)")
    parser.add_argument("--robot", choices=("mbbr",), default="mbbr")
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help="change one value of the configuration")
    parser.add_argument("--dry-run", action="store_true", help="on a PC: the same code against simulated chips and a simulated robot")
    parser.add_argument("--duration", metavar="S", type=float, help="stop after so many seconds (dry run: the scenario's length)")
    parser.add_argument("--speed", choices=("real", "max"), default="real", help="dry run in real time, or as fast as possible")
    parser.add_argument("--seed", metavar="N", type=int, default=1, help="of the dry run's randomness")
    parser.add_argument("--remote", metavar="PTY|FILE|none", help="the remote's port (default: the configuration's, or the scenario's)")
    parser.add_argument("--scenario", metavar="NAME|FILE", default="hold", help="what the dry run's operator does")
    parser.add_argument("--log", metavar="DIR", help="folder of the log")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON object, and nothing else, on standard output")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB")
    config = verbs.add_parser("config", help="check, show, template or document the configuration",
                              epilog="example: mip-rt config check --config my.yaml")  # fmt: skip
    from mip_rt.config import commands

    commands.add_arguments(config)
    verbs.add_parser("warm-up", help="compile everything and keep it", epilog="example: mip-rt warm-up")
    bench = verbs.add_parser("bench", help="measure costs", epilog="example: mip-rt bench steps")
    bench.add_argument("what", choices=("steps", "estimators", "robustness"), help="cost of EKF, tick and dry run; estimator errors by yaw rate; unknown model errors")
    bench.add_argument("--json", action="store_true")
    bench.add_argument("--quick", action="store_true", help="fewer seeds or ticks")
    return parser


def _warm_up() -> int:
    import time

    begin = time.perf_counter()
    from mip_rt.robots import mbbr  # noqa: F401  (importing compiles)

    print(f"compiled and kept in {time.perf_counter() - begin:.1f} s")
    return 0


def _run(arguments) -> int:
    from mip_rt import config as configuration

    path = arguments.config or configuration.default_path(arguments.robot)
    config = configuration.load(path, dict(configuration.parse_override(text) for text in arguments.set))
    if arguments.duration is not None and not 0.0 < arguments.duration < 1e8:
        raise ConfigError(f"--duration {arguments.duration:g} is not a time.", "Give seconds, for example --duration 60.", "arguments")
    scenario = None
    if arguments.dry_run:
        from mip_rt.config import scenario as scenarios

        scenario = scenarios.load(arguments.scenario)
    elif arguments.speed == "max":
        raise ConfigError("--speed max needs --dry-run.", "A robot runs in real time.", "arguments")

    from mip_rt import run
    from mip_rt.summary import render

    stop = run.install_signals()
    real_time = arguments.speed == "real"
    bench = None
    remote = {None: config.remote.device, "none": None}.get(arguments.remote, arguments.remote)
    if arguments.dry_run:
        from mip_rt.fake import bench as fake_bench

        bench = fake_bench.build(config, scenario, arguments.seed, real_time)
        if arguments.remote is None:
            remote = bench.remote.device
    try:
        folder = arguments.log or (run.temporary_log_folder() if bench else config.log.folder)
        name = scenario.name if scenario else ""
        session = run.Session(config, bench, folder, remote, arguments.seed, name)
        if not arguments.json:
            print(run.banner(session, name, arguments.speed), file=sys.stderr)
        duration = arguments.duration or (scenario.duration_s if scenario else 1e8)
        live = run.Live() if real_time and not arguments.json else None
        report = session.run(duration, stop, live, real_time)
    finally:
        if bench:
            bench.close()
    if arguments.json:
        print(json.dumps(report))
    else:
        scheduling = report["scheduling"]
        print(f"scheduling {scheduling['policy']} {scheduling['priority']}, memory "
              f"{'locked' if scheduling['memory_locked'] else 'not locked'}, garbage collector "
              f"{'frozen' if scheduling['gc_frozen'] else 'on'}")  # fmt: skip
        for warning in session.scheduling.warnings:
            print(f"warning: {warning}")
        print(render(report))
    return 1 if report["fell"] or report["faults"] else 0


def main(argv=None) -> int:
    """Entry point; returns the exit code."""
    arguments = _parser().parse_args(argv)
    try:
        if arguments.verb == "config":
            from mip_rt.config import commands

            return commands.run(arguments)
        if arguments.verb == "warm-up":
            return _warm_up()
        if arguments.verb == "bench":
            from mip_rt.lab import bench

            return bench.run(arguments)
        return _run(arguments)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except MipRtError as error:
        print(error, file=sys.stderr)
        return 3


if __name__ == "__main__":
    sys.exit(main())
