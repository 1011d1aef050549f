"""What a tick costs on this board and kernel, stage by stage: a real run with the motors off, its own timestamps, and the bus timed transfer by transfer.

The loop runs as it does when it balances, disarmed, and the arm button is not listened to. The percentiles stand beside the budget of a 1 GHz AM335x;
a histogram of the wake-up latency (as cyclictest draws one) and the same under load show what the kernel adds. A dry run does the same on the fake board,
where the time of the simulated chips is taken off wake-up and reading.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mip_rt import realtime
from mip_rt import session as runner
from mip_rt.doctor.motors import open_bench
from mip_rt.hardware import i2c_time
from mip_rt.hardware import mpu9250_registers as r

PERCENTILES = (50, 99, 99.9, 100)
STAGES = {  # name: (what it is, budget in us or None)
    "wake": ("edge to awake", 200),
    "i2c_count": ("I2C: FIFO count", None),
    "i2c_packet": ("I2C: packet", None),
    "read": ("all sensors read", 1450),
    "step": ("compiled step", 400),
    "pwm": ("PWM: all duties written", 150),
    "tick": ("edge to motors", 2400),
}
ON_TOP_US = 100  # of a transfer's wire time, for the kernel
WARM_TICKS = 200
LOAD = "import os\nwhile True:\n    with open('load', 'wb') as f:\n        f.write(os.urandom(1 << 20)); f.flush(); os.fsync(f.fileno())\n    sum(range(200000))\n"


class TimedTransfers:
    """Stands before a bus's `transfer` and notes how long each took, by prepared transfer, in memory that is there beforehand."""

    def __init__(self, transfer, room: int):
        self._transfer = transfer
        self.spent, self.kinds, self.count = np.zeros(room, np.int64), [None] * room, 0

    def __call__(self, prepared) -> int:
        begin = time.perf_counter_ns()
        refused = self._transfer(prepared)
        if self.count < len(self.spent):
            self.spent[self.count] = time.perf_counter_ns() - begin
            self.kinds[self.count] = prepared
            self.count += 1
        return refused


def _budgets(attitude: str) -> dict:
    found = {name: budget for name, (_, budget) in STAGES.items()}
    found["i2c_count"] = round(i2c_time.read_bits(2) / i2c_time.FAST_HZ * 1e6 + ON_TOP_US)
    found["i2c_packet"] = round(i2c_time.read_bits(r.PACKET_BYTES if attitude == "dmp" else i2c_time.RAW_PACKET) / i2c_time.FAST_HZ * 1e6 + ON_TOP_US)
    return found


def _figures(spent_ns) -> dict:
    us = np.asarray(spent_ns) / 1e3
    return {"n": len(us), **{f"p{percentile:g}": round(float(np.percentile(us, percentile)), 1) for percentile in PERCENTILES}} if len(us) else {"n": 0}


def histogram(spent_ns) -> list:
    """[[upper bound in us, how many]] in steps of a factor of two, from 8 us on."""
    us = np.asarray(spent_ns) / 1e3
    bounds = 8.0 * 2.0 ** np.arange(13)
    counts, _ = np.histogram(us, np.concatenate(([-np.inf], bounds, [np.inf])))
    return [[float(bound), int(count)] for bound, count in zip((*bounds, np.inf), counts) if count]


def measure(patient, bench, seconds: float) -> dict:
    """Figures of a run with the motors off; `bench` is the dry run's, None on the robot."""
    motor_bench, settings = open_bench(patient), patient.config.realtime
    try:
        realtime.enter(settings.policy, settings.priority, settings.lock_memory)
        pwm = motor_bench.time_zero_writes(200)
    finally:
        realtime.leave()
        motor_bench.close()
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        session = runner.Session(patient.config, bench, Path(folder), None, 1, "bench-board", None, patient.guard)
        imu, loop = session.devices.imu, session.loop
        timed = TimedTransfers(imu._bus.transfer, round(3 * seconds * patient.config.realtime.rate_hz))
        imu.watch(timed)
        session.devices.button.read = lambda: None  # nobody arms a robot that is being measured
        report = session.run(seconds, runner.install_signals())
        ticks = loop.ticks
        rows = session.ring.rows[np.arange(max(WARM_TICKS, ticks - session.ring.capacity + 1), ticks) % session.ring.capacity]
        fakes = np.zeros((len(rows), 2), np.int64)
        if bench is not None:
            fakes = bench.kernel.fake_ns[bench.kernel.sample_of(rows["edge_ns"]) % len(bench.world.truth)]
        wake = rows["wake_ns"] - rows["edge_ns"] - fakes[:, 0]
        read = rows["read_ns"] - rows["wake_ns"] - fakes[:, 1]
        step = rows["step_ns"] - rows["read_ns"]
        count = getattr(imu, "_read_count", None)
        kinds = timed.kinds[: timed.count]
        is_count = np.array([kind is count for kind in kinds], bool)
        spent = timed.spent[: timed.count]
    stages = {
        "wake": _figures(wake), "i2c_count": _figures(spent[is_count]), "i2c_packet": _figures(spent[~is_count]), "read": _figures(read),
        "step": _figures(step), "pwm": _figures(pwm), "tick": _figures(wake + read + step + np.median(pwm)),
    }  # fmt: skip
    return {"ticks": ticks, "scheduling": report["scheduling"], "stages": stages, "wake_histogram_us": histogram(wake)}


def run(dry_run: bool, seconds: float, load: bool, config_path=None, robot=None) -> dict:
    """{"budget_us", "idle", "load" where asked for}."""
    from mip_rt import config as configuration
    from mip_rt import guard_client
    from mip_rt.config import scenario as scenarios
    from mip_rt.doctor.patient import Patient
    from mip_rt.hardware.boards import board
    from mip_rt.hardware.kernel import Kernel

    path = config_path or configuration.default_path(robot or "mbbr")
    config = configuration.load(path, None, robot)
    found = {"budget_us": _budgets(config.imu.attitude)}
    for name in ("idle", "load") if load else ("idle",):
        bench = None
        if dry_run:
            from mip_rt.fake import bench as fake_bench

            bench = fake_bench.build(config, scenarios.load("hold"), 1, True)
            bench.kernel.operator.press_button = lambda now_ns: None
            patient = Patient(bench.kernel, config, None, lambda b=bench: b.guard, (bench.image_path, bench.image_sha256), pins=bench.machine.pins)
        else:
            patient = Patient(Kernel(), config, str(path), lambda: guard_client.start(config), pins=board(config.board, Kernel()))
        with tempfile.TemporaryDirectory() as folder:
            burners = [subprocess.Popen([sys.executable, "-S", "-c", LOAD], cwd=folder) for _ in range(os.cpu_count() or 1)] if name == "load" else []
            try:
                found[name] = measure(patient, bench, seconds)
            finally:
                for burner in burners:
                    burner.kill()
                    burner.wait()
                patient.close()
                if bench is not None:
                    bench.close()
    return found


def render(found: dict) -> None:
    """Prints the tables."""
    for name in ("idle", "load"):
        if name not in found:
            continue
        part = found[name]
        scheduling = part["scheduling"]
        print(f"\n{name}: {part['ticks']} ticks, {scheduling['policy']} {scheduling['priority']}, memory {'locked' if scheduling['memory_locked'] else 'not locked'}")
        print("| stage | budget us | " + " | ".join(f"p{p:g}" if p < 100 else "max" for p in PERCENTILES) + " |")
        print("|---|---|" + "---|" * len(PERCENTILES))
        for stage, figures in part["stages"].items():
            cells = " | ".join(f"{figures[f'p{p:g}']:.1f}" if figures["n"] else "-" for p in PERCENTILES)
            print(f"| {STAGES[stage][0]} | {found['budget_us'][stage]} | {cells} |")
        print("wake-up latency, us: ticks")
        most = max((count for _, count in part["wake_histogram_us"]), default=1)
        for bound, count in part["wake_histogram_us"]:
            label = f"up to {bound:.0f}" if np.isfinite(bound) else "more"
            print(f"  {label:>12} {count:>7} {'#' * max(1, round(40 * count / most))}")
