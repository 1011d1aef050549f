"""The verb `mip-rt soak`: randomised faults over randomised driving on virtual time, until a promise breaks or the hours are over."""

import json
import math
import shlex
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from mip_rt.config import scenario as scenarios
from mip_rt.errors import ConfigError
from mip_rt.fake.faults import FAULTS, documentation
from mip_rt.lab import batch, soak_run
from mip_rt.lab.soak_plan import plan

RUN_S = 240.0


class Job(NamedTuple):
    """One run: `scenario` names a shipped one for ordinary driving; otherwise a plan is drawn from the seed."""

    seed: int
    duration_s: float
    names: tuple | None = None
    scenario: str | None = None
    shipped_values: bool = False
    overrides: tuple = ()

    def configured(self):
        """The configuration of the run."""
        return soak_run.configured(dict(self.overrides))

    def script(self):
        """The scenario of the run."""
        if self.scenario is not None:
            return scenarios.load(self.scenario)
        gap_s = (1.0, 2.0) if self.shipped_values else (3.0, 7.0)
        return plan(self.seed, self.duration_s, self.configured().remote.levels, self.names, self.shipped_values, gap_s)


def work(job: Job) -> dict:
    """soak_run.run of a job, with a configuration file of its own that faults may overwrite."""
    config = job.configured()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.yaml"
        path.write_text(config.to_yaml())
        return soak_run.run(config, job.script(), job.seed, job.duration_s, job.scenario is None, path)


class Tally:
    """Sums over the runs of a campaign."""

    def __init__(self):
        self.runs, self.simulated_s, self.seeds = 0, 0.0, []
        self.rows, self.false_alarms, self.broken = {}, [], []

    def add(self, result: dict) -> None:
        """One run's result."""
        self.runs += 1
        self.simulated_s += result["simulated_s"]
        self.seeds.append(result["seed"])
        self.false_alarms += [(result["scenario"], result["seed"], at_s, code) for at_s, code in result["false_alarms"]]
        self.broken += [(result["scenario"], result["seed"], *entry) for entry in result["broken"]]
        for reaction in result["reactions"]:
            row = self.rows.setdefault(reaction.name, {"injected": 0, "balancing": 0, "reactions": Counter(), "worst_s": None, "falls": 0})
            row["injected"] += 1
            row["balancing"] += reaction.armed
            row["reactions"].update(reaction.codes)
            row["falls"] += reaction.fell
            if reaction.off_s is not None:
                row["worst_s"] = max(row["worst_s"] or 0.0, reaction.off_s)

    def report(self) -> dict:
        """As one JSON object."""
        return {
            "runs": self.runs,
            "simulated_hours": self.simulated_s / 3600.0,
            "seeds": [min(self.seeds), max(self.seeds)] if self.seeds else [],
            "injected": sum(row["injected"] for row in self.rows.values()),
            "faults": {name: {**row, "reactions": dict(row["reactions"])} for name, row in sorted(self.rows.items())},
            "false_alarms": self.false_alarms,
            "broken": self.broken,
        }


def render(report: dict) -> str:
    """Markdown table and sums for people."""
    lines = []
    if report["faults"]:
        lines += ["| fault | injected | while balancing | reactions seen | longest until off (ms) | falls |", "|---|---|---|---|---|---|"]
    for name, row in report["faults"].items():
        ordered = sorted(row["reactions"].items(), key=lambda entry: -entry[1])
        seen = ", ".join(f"{code} {count}" for code, count in ordered[:6]) or "none"
        worst = "stays on" if row["worst_s"] is None else f"{row['worst_s'] * 1e3:.0f}"
        lines.append(f"| `{name}` | {row['injected']} | {row['balancing']} | {seen} | {worst} | {row['falls']} |")
    seeds = "-".join(map(str, report["seeds"]))
    lines.append(
        f"{report['runs']} runs, {report['simulated_hours']:.2f} simulated hours, seeds {seeds}: {report['injected']} faults injected, "
        f"{len(report['false_alarms'])} false alarms, {len(report['broken'])} broken promises"
    )
    lines += [f"false alarm: {code} at {at_s:.2f} s of {name}, seed {seed}" for name, seed, at_s, code in report["false_alarms"][:20]]
    return "\n".join(lines)


def keep(job: Job, folder: Path) -> tuple[str, str]:
    """Writes scenario and configuration of a run, replays it with `mip-rt`; (command, path of its log)."""
    folder.mkdir(parents=True, exist_ok=True)
    script = job.script()
    scenario_path, config_path = folder / f"{script.name}-seed{job.seed}.yaml", folder / f"{script.name}-seed{job.seed}-config.yaml"
    scenario_path.write_text(script.to_yaml())
    config_path.write_text(soak_run.configured({**dict(job.overrides), "log.ring_s": str(math.ceil(job.duration_s) + 1)}).to_yaml())
    command = ["mip-rt", "--dry-run", "--speed", "max", "--config", str(config_path), "--scenario", str(scenario_path),
               "--duration", f"{job.duration_s:g}", "--seed", str(job.seed), "--log", str(folder)]  # fmt: skip
    replayed = subprocess.run([sys.executable, "-m", "mip_rt", *command[1:], "--json"], capture_output=True, text=True, check=False)
    try:
        log = json.loads(replayed.stdout)["log"]
    except ValueError:
        log = f"none: {replayed.stderr.strip().splitlines()[-1:]}"
    return shlex.join(command), log


def jobs(arguments) -> list[Job]:
    """The runs that the arguments ask for."""
    overrides = tuple(sorted(dict(part.split("=", 1) for part in arguments.set).items()))
    if arguments.no_faults:
        names = sorted(scenarios.shipped())
        lengths = {name: scenarios.load(name).duration_s for name in names}
        count = math.ceil(arguments.hours * 3600.0 / sum(lengths.values()))
        return [Job(arguments.seed + i, lengths[name], None, name, False, overrides) for i in range(count) for name in names]
    count = math.ceil(arguments.hours * 3600.0 / RUN_S)
    return [Job(arguments.seed + i, RUN_S, tuple(arguments.fault) or None, overrides=overrides) for i in range(count)]


def campaign(listed, arguments, out: Path) -> Tally:
    """Runs the jobs until one breaks a promise, which is then kept and told."""
    tally = Tally()
    for job, result in batch.completed(work, listed, "runs", arguments.cluster, arguments.workers):
        tally.add(result)
        if result["broken"]:
            for entry in result["broken"]:
                print(f"broken promise '{entry.promise}' at {entry.time_s:.2f} s, seed {job.seed}: {entry.sentence}", file=sys.stderr)
            command, log = keep(job, out)
            print(f"replay: {command}\nlog: {log}", file=sys.stderr)
            break
    return tally


def add_arguments(parser) -> None:
    """Declares the verb's arguments."""
    parser.add_argument("--hours", type=float, default=1.0, help="simulated hours (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the first run; each run has the next one")
    parser.add_argument("--fault", metavar="NAME", action="append", default=[], help="only this fault; may be repeated")
    parser.add_argument("--no-faults", action="store_true", help="ordinary driving in all shipped scenarios: every alarm is a false one")
    parser.add_argument("--list", action="store_true", help="print the table of all faults and stop")
    parser.add_argument("--table", action="store_true", help="print bound, worst time and result of each fault, as Markdown")
    parser.add_argument("--injections", type=int, default=100, metavar="N", help="for --table: at least so many of each (default: %(default)s)")
    parser.add_argument("--out", metavar="DIR", default="soak-failures", help="where a broken run is kept (default: %(default)s)")
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help="change one value of the configuration")
    parser.add_argument("--json", action="store_true")
    batch.add_arguments(parser)


def run(arguments) -> int:
    """Exit code 1 where a promise was broken, or an alarm was false.

    Raises:
        ConfigError: there is no such fault, or the numbers make no sense.
    """
    if arguments.list:
        sys.stdout.write(documentation())
        return 0
    from mip_rt.config.suggestion import nearest

    for name in arguments.fault:
        if name not in FAULTS:
            raise ConfigError(f"there is no fault {name!r}{nearest(name, FAULTS)}.", "See mip-rt soak --list.", "fault_unknown")
    if not 0.0 < arguments.hours < 1e6 or arguments.injections < 1:
        raise ConfigError("--hours and --injections must be above 0.", "For example --hours 10.", "arguments")
    out = Path(arguments.out)
    if arguments.table:
        from mip_rt.lab import fault_table

        report = fault_table.measure(arguments.fault, arguments.injections, arguments.seed, arguments)
        print(json.dumps(report) if arguments.json else fault_table.render(report))
        return int(any(row["failed"] for row in report["faults"].values()) or bool(report["broken"]))
    report = campaign(jobs(arguments), arguments, out).report()
    print(json.dumps(report) if arguments.json else render(report))
    return int(bool(report["broken"]) or (arguments.no_faults and bool(report["false_alarms"])))
