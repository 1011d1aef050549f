"""A session: puts configuration, drivers (or fakes), robot, supervisor and ring together, and turns the loop until it is told to stop.

The loop itself is in `loop.py`; here is everything around it, none of which is in the way of a tick: calibration and pre-arm
checks while the motors are off, the summary.
"""

import math
import os
import signal
import time
from pathlib import Path

import numpy as np

from mip_rt import frame, inputs, realtime, robots, self_test
from mip_rt.calibration import GyroCalibration
from mip_rt.errors import MipRtError
from mip_rt.faults import FAULT_BY_NUMBER
from mip_rt.hardware.devices import open_devices
from mip_rt.hardware.imu_status import IMU_OK
from mip_rt.hardware.kernel import Kernel
from mip_rt.log import recorder_process
from mip_rt.log.ring import Ring, header, remove_old_rings
from mip_rt.loop import Loop
from mip_rt.prearm import PreArm
from mip_rt.summary import Summary
from mip_rt.supervisor import State, Supervisor
from mip_rt.unit_file import UnitFile, apply_unit_file

ABSORB_EVERY = 64  # ticks between looks of the summary: some 0.1 ms of work
ABSORB_EVERY_VIRTUAL = 1024  # on virtual time nothing is late, and fewer looks are cheaper
CHECK_EVERY = 20  # ticks between pre-arm checks
RECOVER_AFTER_S = 1.0  # without a good packet while the motors are off: the IMU is reset, and again after as long
_BALANCING = State.BALANCING  # looked up in every tick, and an enumeration's members are found slowly
BOOT_TIMEOUTS = 40  # silent waits in a row before a start is given up


class Stop:
    """Set by SIGTERM, SIGINT and SIGHUP; the loop ends after its tick."""

    def __init__(self):
        self.requested = False

    def __call__(self, *_):
        self.requested = True


class Session:
    """One run of one robot.

    Args:
        config: loaded configuration.
        bench: fake.bench.Bench of a dry run; None on the robot.
        log_folder: where the ring file goes.
        remote_device: the remote's port; None for none.
        seed, scenario_name: of a dry run, for the log's name.
        record_folder: where the recorder keeps its files; None for no recorder.
        guard: guard_client.GuardClient that holds the robot's enable line; a dry run brings its own.

    Attributes:
        loop_s: what `run` took from the first tick to the summary, on the wall's clock.
    """

    def __init__(
        self, config, bench, log_folder: Path, remote_device, seed: int, scenario_name: str = "", record_folder: Path | None = None,
        guard=None,
    ):  # fmt: skip
        self.bench, self.seed = bench, seed
        self.kernel = bench.kernel if bench else Kernel()
        config, self.unit = apply_unit_file(config, self.kernel)
        self.config = config
        setup = robots.setup(config.robot)
        self.robot = setup.build(config)
        rows = round(config.log.ring_s * config.realtime.rate_hz)
        stamp = f"{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}"
        name = f"dry-run-{scenario_name}-seed{seed}" if bench else f"mip-rt-{stamp}"
        layout, persistence = self.robot.layout, self.robot.persistence
        extra = {
            "estimators": self.robot.names,
            "state_layout": persistence.layout,
            "codes": codes(),
            "calibration": {"gyro_bias_rad_s": self.robot.gyro_bias_rad_s.tolist()} | (self.unit.applied() if isinstance(self.unit, UnitFile) else {}),
        }
        if bench:
            extra |= {"seed": seed, "scenario": scenario_name}
            if bench.kernel.entrance is not None and remote_device == bench.remote.device:
                extra["remote_entrance"] = str(bench.kernel.entrance.path)
        recording = None
        if record_folder is not None:
            run_folder = f"{name}-{stamp}" if bench else name
            recording = recorder_process.settings(config.log, record_folder, run_folder, config.realtime.rate_hz)
            extra["recording"] = recording
        description = header(layout, config.to_yaml(), extra, self.kernel.monotonic_ns())
        if not bench:
            remove_old_rings(Path(log_folder), "mip-rt-*.ring")
        self.ring = Ring(Path(log_folder) / f"{name}.ring", layout.dtype, rows, description, persistence.size)
        self.recorder = recorder_process.RecorderProcess(self.ring, recording)
        self.robot.attach(self.ring.rows)
        self.robot.rehearse()
        inputs.compile_for(layout.dtype)
        if bench:
            bench.kernel.power_on()
        image = (bench.image_path, bench.image_sha256) if bench else None
        self.guard = bench.guard if bench else guard
        self.devices = open_devices(self.kernel, config, self.guard, remote_device, image)
        dt_s = 1.0 / config.realtime.rate_hz
        self.supervisor = Supervisor(self.devices.motors, config.limits, dt_s, config.control.soft_start_s)
        self.supervisor.attach(self.robot.rows)
        self.loop = Loop(
            self.robot, self.devices, self.supervisor, self.ring, self.kernel, config.limits.imu_silence_s,
            config.limits.engage_tilt_rad,
        )  # fmt: skip
        self.calibration = GyroCalibration(config.realtime.rate_hz)
        self.prearm = PreArm(
            config, self.devices, self.calibration, self.unit, self.ring.path.parent, self_test.run(config.limits, dt_s)
        )
        self.summary = Summary(self.robot.names, dt_s, setup.Judge(config))
        self.scheduling = realtime.Scheduling()
        self.refusals = []
        self._imu_good_ns = None  # newest good packet, or attempt to get one, since the motors are off
        self._absorbed, self._absorb_every = 0, ABSORB_EVERY
        self.loop_s = math.nan
        self._state = None  # as last noticed

    def run(self, duration_s: float, stop: Stop, live=None, real_time: bool = True, service=None) -> dict:
        """Turns the loop for `duration_s` (or until stopped); returns the summary. The motors are off afterwards, however it ends."""
        loop, kernel = self.loop, self.kernel
        try:
            self.recorder.start()
            if real_time:
                settings = self.config.realtime
                self.scheduling = realtime.enter(settings.policy, settings.priority, settings.lock_memory)
                self.scheduling.warnings += self.guard.warnings
            else:
                realtime.freeze_garbage_collector()
                self._absorb_every = min(ABSORB_EVERY_VIRTUAL, self.ring.capacity // 2)
                self.scheduling = realtime.Scheduling(gc_frozen=True)
            self.prearm.scheduling = self.scheduling
            if kernel.wait_readable(self.devices.imu_line.fd, self.config.limits.imu_silence_s):
                self.devices.imu_line.forget()  # interrupts of the bring-up are not missed ticks
            end_ns = kernel.monotonic_ns() + round(min(duration_s, 1e8) * 1e9)
            silent = 0
            begin_s = time.perf_counter()
            while not stop.requested and kernel.monotonic_ns() < end_ns:
                ticked = loop.tick()
                if service is not None:
                    service.turn(self, ticked)
                if not ticked:
                    silent += 1
                    if silent > BOOT_TIMEOUTS and loop.ticks == 0:
                        raise MipRtError("the IMU sends no interrupts.", "Run mip-rt doctor.", "imu_no_interrupt")
                    self._notice_state(loop.ticks)
                    self._recover_imu()
                    continue
                silent = 0
                self._between_ticks(loop.ticks - 1)
                if not real_time:
                    self.recorder.wait_where_time_is_virtual()
                if live is not None:
                    live.update(self)
        finally:
            self.supervisor.shut_down()
            self.devices.close()
            realtime.leave()
        self._absorb(loop.ticks)
        self.ring.close()
        self.recorder.finish()
        report = self.summary.report(
            self.supervisor.state, self.scheduling.summary(), self._log_path(), self.config.robot, self.robot.controller, self.seed,
            self.tipped,
        )  # fmt: skip
        report["recorder"] = self.recorder.summary()
        self.loop_s = time.perf_counter() - begin_s
        return report

    def _log_path(self) -> Path:
        """What `mip_rt.log.open` reads this run from: the ring while it holds everything and lasts, otherwise the recorded files."""
        lasting = self.bench is not None and self.loop.ticks <= self.ring.capacity
        recorded = self.recorder.summary()
        return self.ring.path if lasting or not recorded or not recorded["recorded"] else self.recorder.folder

    def _notice_state(self, tick: int) -> None:
        """Where the supervisor has entered another state: shows it at the LEDs, and tells the recorder of a FAULT."""
        state = self.supervisor.state
        if state is self._state:
            return
        self._state = state
        self.devices.leds.show(state in (State.ARMING, State.BALANCING))
        if state is State.FAULT:
            self.ring.report_fault(self.supervisor.fault.number, tick)

    @property
    def tipped(self) -> bool:
        """The last row says that the robot leans beyond the limit."""
        return any(code == "tipped" for _, _, code in self.supervisor.events)

    def condition(self) -> str:
        """State in words: with the fault, or with the first reason why the robot is not armed, and the cure."""
        reason = self.why_not_armed()
        return self.supervisor.state.name + (f"  {reason}" if reason else "")

    def _between_ticks(self, tick: int) -> None:
        state = self.supervisor.state
        if tick - self._absorbed >= self._absorb_every - 1:
            self._absorb(tick + 1)
        if tick % recorder_process.LOOK_EVERY == 0:
            self.recorder.look()
        if state is not self._state:
            self._notice_state(tick + 1)
        if state is _BALANCING:
            self._imu_good_ns = None
            return
        now_ns = self.kernel.monotonic_ns()
        row = self.ring.rows[tick % self.ring.capacity]
        usable = bool(row["imu_status"] & IMU_OK)
        if not usable:
            self.calibration.restart()
            self._recover_imu()
        else:
            self._imu_good_ns = now_ns
        if usable and state in (State.CALIBRATING, State.DISARMED, State.FAULT) and self.calibration.due(now_ns * 1e-9):
            self._calibrate(row, now_ns * 1e-9)
        if tick % CHECK_EVERY == 0:
            self.refusals = self.prearm.check(now_ns * 1e-9, state is not State.BOOT, self._rate_hz(tick))
            self.supervisor.refusals = sum(refusal.check.bit for refusal in self.refusals)

    def _calibrate(self, row, now_s: float) -> None:
        measured = row["gyro_rad_s"] + row["gyro_bias_rad_s"]
        if self.calibration.take(now_s, measured, row["acceleration_m_s2"], row["attitude_rad"]):
            self.robot.gyro_bias_rad_s[:] = self.calibration.bias_rad_s
            self.supervisor.calibrated = True

    def _recover_imu(self) -> None:
        """Resets an IMU that has put the robot into FAULT or keeps it in BOOT, once a second."""
        now_ns = self.kernel.monotonic_ns()
        last_ns, self._imu_good_ns = self._imu_good_ns, self._imu_good_ns or now_ns
        if last_ns is None or self.supervisor.state not in (State.BOOT, State.FAULT) or now_ns - last_ns < RECOVER_AFTER_S * 1e9:
            return
        self._imu_good_ns = now_ns
        try:
            self.devices.imu.recover()
        except OSError:
            pass  # counted by the driver's next read; the next attempt follows

    def why_not_armed(self) -> str:
        """What stands between the robot and balancing, in a sentence; empty while it balances."""
        supervisor = self.supervisor
        if supervisor.state is State.BALANCING:
            return ""
        if supervisor.state is State.FAULT:
            return f"{supervisor.fault.code}: {supervisor.fault.sentence}; {supervisor.fault.cure}"
        blocking = [refusal for refusal in self.refusals if refusal.check.blocks]
        if blocking:
            more = f" (and {len(blocking) - 1} more)" if len(blocking) > 1 else ""
            return f"not armed: {blocking[0].sentence} {blocking[0].cure}{more}"
        if supervisor.state is State.ARMING:
            return f"arming: hold it upright within {math.degrees(self.config.limits.engage_tilt_rad):.0f} deg"
        return "ready: press the arm button" if supervisor.state is State.DISARMED else "not armed: starting"

    def _rate_hz(self, tick: int) -> float:
        """Interrupt rate over the last 200 ticks, with the interrupts that the loop was too late for; the wanted rate before there are so many."""
        rows, n = self.ring.rows, self.ring.capacity
        span = min(tick, 200, n - 1)
        if span < 50:
            return self.config.realtime.rate_hz
        last = np.arange(tick - span + 1, tick + 1) % n
        interrupts = span + int(rows["missed"][last].sum())
        return interrupts * 1e9 / float(rows["edge_ns"][tick % n] - rows["edge_ns"][(tick - span) % n])

    def _absorb(self, until: int) -> None:
        capacity = self.ring.capacity
        while self._absorbed < until:
            first = self._absorbed % capacity
            count = min(until - self._absorbed, capacity - first)
            rows = self.ring.rows[first : first + count]
            if self.bench:
                world = self.bench.world  # its rows run on with its samples, missed ones included
                samples = self.kernel.sample_of(rows["edge_ns"]) % len(world.truth)
                if (np.diff(samples) == 1).all():  # as always but for lost and doubled interrupts: a slice needs no copy
                    samples = slice(samples[0], samples[-1] + 1)
                self.summary.absorb(rows, world.truth_rows[samples], self.kernel.fake_ns[samples])
            else:
                self.summary.absorb(rows)
            self._absorbed += count


def codes() -> dict:
    """Names of the numbers and bits in the frame, for a log that explains itself: field: {number or bit as text: name}."""
    return {
        "state": {str(int(state)): state.name for state in State},
        "fault": {str(number): fault.code for number, fault in FAULT_BY_NUMBER.items()},
        "limits": {str(bit): name for name, bit in frame.LIMITS.items()},
        "alarms": {str(bit): name for name, bit in frame.ALARMS.items()},
    }


def install_signals() -> Stop:
    """SIGTERM, SIGINT and SIGHUP end the loop in an orderly way."""
    stop = Stop()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, stop)
    return stop
