"""The verb `mip-rt bench`: what things cost, how well the estimators do, what the controller survives, how fast the guard is."""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mip_rt import config as configuration
from mip_rt import log
from mip_rt import session as runner
from mip_rt.config import published
from mip_rt.config import scenario as scenarios
from mip_rt.fake import bench as fake_bench
from mip_rt.lab import batch
from mip_rt.progress import progress

DRIVES = (("drive", 0.0), ("drive-spin-0.5", 0.5), ("drive-spin-1.0", 1.0), ("drive-spin-1.5", 1.5))
ALL_SCENARIOS = ("hold", "spin-0.5", "spin-1.0", "spin-1.5", "drive-spin-1.0", "dissertation-6.4.5")


def dry_run(overrides: dict, scenario: str, seed: int, duration_s: float | None = None, robot: str = "mbbr") -> dict:
    """Summary of a dry run on virtual time, in this process; and `loop_s`, the seconds from its first tick to the summary."""
    config = configuration.load(configuration.default_path(robot), overrides)
    script = scenarios.load(scenario)
    bench = fake_bench.build(config, script, seed, False)
    try:
        with tempfile.TemporaryDirectory() as folder:
            session = runner.Session(config, bench, Path(folder), bench.remote.device, seed, scenario)
            report = session.run(duration_s or script.duration_s, runner.Stop(), None, False)
            return report | {"loop_s": session.loop_s}
    finally:
        bench.close()


def work(job: tuple) -> dict:
    """dry_run of its arguments, for a batch."""
    return dry_run(*job)


def estimators(quick: bool, cluster=None, workers=None) -> dict:
    """Errors of every estimator on the same samples, by yaw rate, while driving at 0.2 m/s; mean over seeds."""
    shadows = [name for name in published.ESTIMATORS if name != "dmp_ekf"]
    seeds = range(1, 2 if quick else 4)
    overrides = {"estimator.shadows": f"[{', '.join(shadows)}]"}
    reports = batch.results(work, [(overrides, scenario, seed) for scenario, _ in DRIVES for seed in seeds], "runs", cluster, workers)
    table = {}
    for number, (_, yaw_rate_hz) in enumerate(DRIVES):
        runs = [report["estimators"] for report in reports[number * len(seeds) : (number + 1) * len(seeds)]]
        table[yaw_rate_hz] = {
            name: {key: float(np.sqrt(np.mean([run[name][key] ** 2 for run in runs]))) for key in runs[0][name]} for name in runs[0]
        }
    return table


def print_estimators(table: dict) -> None:
    """Markdown: tilt error in mrad / ball speed error in rad/s, RMS per axis."""
    names = list(next(iter(table.values())))
    print("| yaw rate | " + " | ".join(names) + " |")
    print("|---|" + "---|" * len(names))
    for yaw_rate_hz, row in table.items():
        cells = [f"{row[n]['tilt_rms_error_rad'] * 1e3:.1f} / {row[n]['ball_speed_rms_error_rad_s']:.2f}" for n in names]
        print(f"| {yaw_rate_hz:g} Hz | " + " | ".join(cells) + " |")


def draw(random, index: int) -> dict:
    """One set of unknown imperfections: model errors of up to 10 %, extra delay, a crooked IMU, an empty battery."""
    overrides = {f"dry_run.model_error.{name}": str(1.0 + 0.1 * random.choice((-1, 1))) for name in ("mass", "inertia", "com_height", "friction", "motor")}
    overrides["dry_run.extra_delay_ticks"] = str(index % 4)
    crooked = np.radians(2.0) * random.choice((-1, 1), 2) / np.sqrt(2.0)
    overrides["dry_run.imu_misalignment_rad"] = f"[{crooked[0]:.5f}, {crooked[1]:.5f}, 0.0]"
    overrides["dry_run.battery_v"] = "6.6" if index % 2 else "7.9"
    return overrides


def robustness(quick: bool, cluster=None, workers=None) -> dict:
    """{scenario: list of (draw, balanced seconds, fell)} over seeded draws of everything at once."""
    listed = []
    for scenario in ALL_SCENARIOS:
        random = np.random.default_rng(7)
        for index in range(3 if quick else 8):
            listed.append(({"estimator.shadows": "[]", **draw(random, index)}, scenario, index + 1))
    found = {scenario: [] for scenario in ALL_SCENARIOS}
    for (overrides, scenario, _), report in zip(listed, batch.results(work, listed, "draws", cluster, workers)):
        failed = report["fell"] or bool(report["faults"]) or report["balanced_s"] < report["duration_s"] - 3.0
        found[scenario].append((overrides, report["balanced_s"], failed, report["tilt_max_rad"]))
    return found


def print_robustness(found: dict) -> None:
    """Markdown, and every draw that fell."""
    print("| scenario | draws | fell or never balanced | largest lean (deg) |")
    print("|---|---|---|---|")
    for scenario, draws in found.items():
        worst = max(np.degrees(entry[3]) for entry in draws)
        print(f"| {scenario} | {len(draws)} | {sum(bool(entry[2]) for entry in draws)} | {worst:.1f} |")
    for scenario, draws in found.items():
        for overrides, balanced, fell, _ in draws:
            if fell:
                print(f"{scenario} fell after {balanced:.1f} s: " + " ".join(f"--set {key}={value}" for key, value in overrides.items()))


def speed(quick: bool, robot: str = "mbbr") -> dict:
    """Costs on this machine, the best of several runs: the EKF alone, a stubbed tick, a whole dry run against real time, a warm start."""
    from mip_rt.lab import costs

    count, runs = (5000, 3) if quick else (20000, 5)
    duration_s = 20.0 if quick else 60.0
    costs.steps(10, robot)
    ekf_s = min(_seconds(costs.steps, 20 * count, robot) for _ in range(runs)) / (20 * count)
    costs.attitude_steps(1000)
    attitude_s = min(_seconds(costs.attitude_steps, 20 * count) for _ in range(runs)) / (20 * count)
    tick_s = min(costs.ticks(count, robot, count) for _ in range(runs)) / count
    dry_run({"estimator.shadows": "[]"}, "hold", 1, 1.0, robot)  # what a process does once
    loop_s = min(dry_run({"estimator.shadows": "[]"}, "hold", 1, duration_s, robot)["loop_s"] for _ in range(runs))
    return {
        "ekf_step_ns": ekf_s * 1e9,
        "attitude_step_ns": attitude_s * 1e9,
        "tick_us": tick_s * 1e6,
        "loop_s": loop_s,
        "times_real_time": duration_s / loop_s,
        "start_s": min(start_s(robot) for _ in range(runs)),
    }


def _seconds(action, *arguments) -> float:
    begin = time.perf_counter()
    action(*arguments)
    return time.perf_counter() - begin


def start_s(robot: str = "mbbr") -> float:
    """From the start of `mip-rt --dry-run`, in real time, to the first tick of its log; what had to be compiled is compiled before."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "mip_rt", "--dry-run", "--robot", robot, "--duration", "0.1", "--json", "--log", folder]
        command += ["--set", "estimator.shadows=[]", "--set", "log.record=false"]
        begin_ns = time.monotonic_ns()
        subprocess.run(command, check=True, capture_output=True)
        return (int(log.open(next(Path(folder).glob("*.ring"))).frames["wake_ns"][0]) - begin_ns) * 1e-9


def add_arguments(parser) -> None:
    """Declares the verb's arguments."""
    parser.add_argument("what", choices=("steps", "choices", "estimators", "robustness", "log", "log-damage", "guard", "alarms", "attitude", "beyond",
                                         "broad", "board", "bring-up"),
                        help="cost of EKF, tick and dry run; of every estimator and controller; estimator errors by yaw rate; unknown model "
                        "errors; cost of the log in the loop, also with a recorder in trouble; logs of killed runs, cut files and flipped bits; enable line after a kill or hang; "
                        "false alarms in ordinary driving; tilt error with the DMP and without; the momentum observer on imperfect robots; onboard attitude on recordings with motion capture; "
                        "every stage of a tick on this board, motors off; starts of the IMU with a fault")  # fmt: skip
    parser.add_argument("--dry-run", action="store_true", help="board: on the fake board")
    parser.add_argument("--seconds", metavar="S", type=float, default=20.0, help="board: how long")
    parser.add_argument("--load", action="store_true", help="board: also while the processor and the disk are busy")
    parser.add_argument("--config", metavar="FILE", help="board: configuration file")
    parser.add_argument("--runs", metavar="N", type=int, default=1000, help="bring-up: how many")
    parser.add_argument("--data", metavar="FOLDER", help="broad: folder of the recordings")
    parser.add_argument("--hours", metavar="N", type=float, default=1.0, help="alarms: simulated hours of driving")
    parser.add_argument("--robot", choices=("mbbr", "edumip"), default="mbbr", help="whose costs `steps` and `choices`, whose errors `estimators` measures")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--quick", action="store_true", help="fewer seeds, ticks or runs")
    batch.add_arguments(parser)


def run(arguments) -> int:
    """Exit code 1 where a robustness draw fell, a log lost more than it may, the enable line fell too late, ordinary driving raised an alarm, the
    momentum observer is not the best by its margin, or the onboard attitude is worse than the DMP's or VQF's may be."""
    if arguments.what == "estimators" and arguments.robot == "edumip":
        from mip_rt.lab import mip_estimators

        table = mip_estimators.run(arguments.quick, lambda jobs: batch.results(mip_estimators.work, jobs, "runs", arguments.cluster, arguments.workers))
        print(json.dumps(table) if arguments.json else mip_estimators.render(table))
    elif arguments.what == "estimators":
        table = estimators(arguments.quick, arguments.cluster, arguments.workers)
        print(json.dumps(table)) if arguments.json else print_estimators(table)
    elif arguments.what == "robustness":
        found = robustness(arguments.quick, arguments.cluster, arguments.workers)
        print(json.dumps(found)) if arguments.json else print_robustness(found)
        return int(any(entry[2] for draws in found.values() for entry in draws))
    elif arguments.what == "alarms":
        from mip_rt.lab import alarms

        found = alarms.run(arguments.hours, arguments.cluster, arguments.workers)
        print(json.dumps(found)) if arguments.json else alarms.print_table(found)
        return int(any(result["faults"] or any(result["graded"].values()) for result in found))
    elif arguments.what == "board":
        from mip_rt.lab import board

        found = board.run(arguments.dry_run, arguments.seconds, arguments.load, arguments.config, arguments.robot if not arguments.config else None)
        print(json.dumps(found)) if arguments.json else board.render(found)
    elif arguments.what == "bring-up":
        from mip_rt.lab import bring_up

        found = bring_up.run(100 if arguments.quick else arguments.runs, progress)
        print(json.dumps(found)) if arguments.json else bring_up.render(found)
        return int(any(result["broken"] for result in found))
    elif arguments.what == "attitude":
        from mip_rt.lab import attitude_sources

        found = attitude_sources.run(dry_run, arguments.quick, progress)
        print(json.dumps(found) if arguments.json else attitude_sources.render(found))
        return int(not attitude_sources.passed(found))
    elif arguments.what == "choices":
        from mip_rt.lab import choices

        found = choices.run(arguments.robot, arguments.quick, progress)
        print(json.dumps(found) if arguments.json else choices.render(found))
    elif arguments.what == "beyond":
        from mip_rt.lab import beyond

        found = beyond.run(arguments.quick, arguments.cluster, arguments.workers)
        print(json.dumps(found) if arguments.json else beyond.render(found))
        return int(not beyond.passed(found))
    elif arguments.what == "broad":
        from mip_rt.lab import broad

        return broad.report(arguments.data, arguments.json, progress)
    elif arguments.what.startswith("log"):
        from mip_rt.lab import log_costs, log_damage

        module = log_costs if arguments.what == "log" else log_damage
        figures = module.report(arguments.quick, progress)
        progress(1, 1, "")
        print(json.dumps(figures)) if arguments.json else module.render(figures)
        return int(module is log_damage and not log_damage.passed(figures))
    else:
        figures = speed(arguments.quick, arguments.robot)
        if arguments.json:
            print(json.dumps(figures))
        else:
            print(f"EKF step {figures['ekf_step_ns']:.0f} ns; onboard attitude {figures['attitude_step_ns']:.0f} ns; whole tick without fakes {figures['tick_us']:.1f} us; "
                  f"dry run {figures['times_real_time']:.0f} times real time, start excluded; "
                  f"start to first tick {figures['start_s']:.2f} s")  # fmt: skip
    return 0
