"""The tick: wait, read, step, supervise, write, log. Everything that happens 200 times a second is on this page.

The IMU's interrupt starts each tick; its kernel timestamp is the sample's time. The row of the ring is the working memory: the
drivers' bytes and numbers go in, the compiled step fills the rest, the supervisor lets the result through or not.
"""

import os
import select
import struct

from mip_rt import frame
from mip_rt.hardware.imu_status import IMU_NO_DATA, IMU_OK
from mip_rt.inputs import GUARD, REMOTE_LOST, gatherer, sensor
from mip_rt.log.ring import STATE_EVERY
from mip_rt.supervisor import State

ARMING = State.ARMING
REMOTE_EVERY = 4  # ticks between looks at the serial port: 20 ms
BATTERY_EVERY = 40  # ticks between battery readings: 0.2 s

_LIMITS = struct.Struct("<q")
_LEAN = struct.Struct("<2d")


class Loop:
    """One robot's tick.

    Args:
        robot: robots.robot.Robot: compiled step and its arrays.
        devices: opened drivers: imu, imu_line, encoders, motors, battery, button, remote.
        supervisor: owner of the motors.
        ring: log.ring.Ring.
        kernel: the boundary; only its clock and its wait are used here.
        settings: silence_s (no interrupt for so long: motors off), engage_tilt_rad.

    Attributes:
        ticks: ticks completed.
        timeouts: waits that ended without an interrupt.
    """

    def __init__(self, robot, devices, supervisor, ring, kernel, silence_s: float, engage_tilt_rad: float):
        self.robot, self.devices, self.supervisor, self.ring, self.kernel = robot, devices, supervisor, ring, kernel
        self.silence_s, self.engage_tilt_rad = silence_s, engage_tilt_rad
        self.ticks = self.timeouts = 0
        layout = robot.layout
        self._at = layout.offset
        self._pulses, self._no_pulses = layout.pulses, (0,) * layout.wheels
        self._wait = kernel.waiter(devices.imu_line, silence_s)
        self._sense, self._gather = sensor(devices, ring), gatherer(devices, robot)
        self._persistent = robot.persistence.parts
        self._arrivals = select.poll()  # one look at both is cheaper than a read of each that finds nothing
        for fd in (devices.button.fd, *([devices.port.fd] if devices.port else [])):
            self._arrivals.register(fd, select.POLLIN)

    def tick(self) -> bool:
        """Runs one tick; False where no interrupt came in time (the motors are then off)."""
        devices, ring, kernel, supervisor = self.devices, self.ring, self.kernel, self.supervisor
        at = self._at
        edges = self._wait()
        wake_ns = kernel.monotonic_ns()
        if edges <= 0:
            if edges < 0:
                raise OSError(-edges, os.strerror(-edges))
            supervisor.imu_silent(self.ticks)
            devices.imu.on_timeout()
            self.timeouts += 1
            self._look(wake_ns)
            return False

        tick = self.ticks
        index = tick % ring.capacity
        base = index * ring.row_bytes
        buffer = ring.buffer
        status, backlog = self._sense(index), 0
        if status != IMU_OK:
            status, backlog = devices.imu.unusual(status), devices.imu.backlog
        read_ns = kernel.monotonic_ns()
        found = self._gather(
            index, tick, wake_ns, read_ns, supervisor.state, supervisor.request, supervisor.refusals, status, backlog, devices.battery_v,
            supervisor.drive_scale,
        )  # fmt: skip

        conditions = self.robot.step(index)
        step_ns = kernel.monotonic_ns()

        if found & REMOTE_LOST:
            self._note(base, frame.LIMIT_REMOTE_LOST)
        upright = supervisor.state is ARMING and not status & IMU_NO_DATA and self._is_upright(base)
        if not supervisor.apply(tick, conditions, upright, index, found & GUARD):
            self._pulses.pack_into(buffer, base + at["applied_ns"], *self._no_pulses)
        write_ns = kernel.monotonic_ns()

        ring.finish(index, tick, supervisor.fault.number, step_ns, write_ns)
        self.ticks = tick + 1
        if self.ticks % STATE_EVERY == 0:  # see robots.persistence
            ring.keep_state(tick, self._persistent)
        self._slack(wake_ns)
        return True

    def _is_upright(self, base: int) -> bool:
        roll, pitch = _LEAN.unpack_from(self.ring.buffer, base + self._at["attitude_rad"])
        return abs(roll) < self.engage_tilt_rad and abs(pitch) < self.engage_tilt_rad

    def _note(self, base: int, limit: int) -> None:
        """Adds a bit to the row's limits, after the step."""
        place = base + self._at["limits"]
        _LIMITS.pack_into(self.ring.buffer, place, _LIMITS.unpack_from(self.ring.buffer, place)[0] | limit)

    def _slack(self, now_ns: int) -> None:
        """Work that may wait until the motors are written."""
        if self.ticks % REMOTE_EVERY == 0:
            self._look(now_ns)
        if self.ticks % BATTERY_EVERY == 0:
            self.devices.battery_v = self.devices.battery.read()

    def _look(self, now_ns: int) -> None:
        """Takes what remote and button have sent; also while the IMU is silent, for what waits unread would look new later."""
        devices = self.devices
        for fd, _ in self._arrivals.poll(0):
            if fd == devices.button.fd:
                if devices.button.read() is not None:
                    self.supervisor.press()
                continue
            devices.remote.receive(now_ns)
            if devices.remote.heading_reset():
                self.supervisor.request_heading_reset()
