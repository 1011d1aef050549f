"""`mip-rt` without a verb: runs the robot, or its dry run, from command-line arguments to summary and exit code."""

import json
import sys

from mip_rt.errors import ConfigError


def add_arguments(parser) -> None:
    """Declares the arguments of a run."""
    parser.add_argument("--config", metavar="FILE", help="configuration file (default: the installed or shipped one)")
    parser.add_argument("--robot", choices=("mbbr", "edumip"), help="default: the file's, or mbbr")
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help="change one value of the configuration")
    parser.add_argument("--dry-run", action="store_true", help="on a PC: the same code against simulated chips and a simulated robot")
    parser.add_argument("--duration", metavar="S", type=float, help="stop after so many seconds (dry run: the scenario's length)")
    parser.add_argument("--speed", choices=("real", "max"), default="real", help="dry run in real time, or as fast as possible")
    parser.add_argument("--seed", metavar="N", type=int, default=1, help="of the dry run's randomness")
    parser.add_argument("--remote", metavar="PTY|FILE|none", help="the remote's port (default: the configuration's, or the scenario's)")
    parser.add_argument("--scenario", metavar="NAME|FILE", default="hold", help="what the dry run's operator does")
    parser.add_argument("--log", metavar="DIR", help="folder of the log: a dry run keeps its ring there, and the recorder its files")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON object, and nothing else, on standard output")


def run(arguments) -> int:
    """Exit code 0, or 1 where the robot fell or ended in a fault.

    Raises:
        MipRtError: a refusal to start.
    """
    from mip_rt import config as configuration
    from mip_rt import service

    path = arguments.config or configuration.default_path(arguments.robot or "mbbr")
    config = configuration.load(path, dict(configuration.parse_override(text) for text in arguments.set), arguments.robot)
    if arguments.duration is not None and not 0.0 < arguments.duration < 1e8:
        raise ConfigError(f"--duration {arguments.duration:g} is not a time.", "Give seconds, for example --duration 60.", "arguments")
    scenario = None
    if arguments.dry_run:
        from mip_rt.config import scenario as scenarios

        scenario = scenarios.load(arguments.scenario)
    elif arguments.speed == "max":
        raise ConfigError("--speed max needs --dry-run.", "A robot runs in real time.", "arguments")

    real_time = arguments.speed == "real"
    machine = guard = bench = None
    unit = service.from_environment()
    remote = {None: config.remote.device, "none": None}.get(arguments.remote, arguments.remote)
    try:
        if arguments.dry_run:
            from mip_rt.fake.machine import Machine

            machine = Machine(config)
        if real_time:
            from mip_rt import guard_client

            guard = guard_client.start(config, machine)  # before numba is loaded: it is small, and holds the motors from the first moment
        if unit:
            unit.status("loading; compiling what is not in the cache")
        from mip_rt import session as runner
        from mip_rt.console import Live, banner
        from mip_rt.log.folders import temporary_log_folder

        stop = runner.install_signals()
        if arguments.dry_run:
            from mip_rt.fake import bench as fake_bench

            bench = fake_bench.build(config, scenario, arguments.seed, real_time, machine, guard, arguments.config)
            if arguments.remote is None:
                remote = bench.remote.device
        # On the robot the ring stays in memory, whatever the recorder's folder: a mapped file on a disk makes the loop wait for it.
        folder = (arguments.log or temporary_log_folder()) if bench else config.log.folder
        record_folder = arguments.log or (None if bench else config.log.record_folder)
        name = scenario.name if scenario else ""
        session = runner.Session(
            config, bench, folder, remote, arguments.seed, name, record_folder if config.log.record else None, guard
        )  # fmt: skip
        if not arguments.json:
            print(banner(session, name, arguments.speed), file=sys.stderr)
        duration = arguments.duration or (scenario.duration_s if scenario else 1e8)
        # The journal is no place for a status line, and writing to it can block: under systemd the state is in `systemctl status`.
        live = Live() if real_time and not arguments.json and not unit else None
        report = session.run(duration, stop, live, real_time, unit)
    finally:
        if unit:
            unit.close()
        for part in (bench,) if bench else (guard, machine):  # a bench closes its own
            if part:
                part.close()
    _print(report, session, arguments.json)
    return 1 if report["fell"] or report["faults"] else 0


def _print(report: dict, session, as_json: bool) -> None:
    if as_json:
        print(json.dumps(report))
        return
    from mip_rt.summary import render

    scheduling = report["scheduling"]
    print(f"scheduling {scheduling['policy']} {scheduling['priority']}, memory "
          f"{'locked' if scheduling['memory_locked'] else 'not locked'}, garbage collector "
          f"{'frozen' if scheduling['gc_frozen'] else 'on'}")  # fmt: skip
    for warning in session.scheduling.warnings:
        print(f"warning: {warning}")
    print(render(report))
