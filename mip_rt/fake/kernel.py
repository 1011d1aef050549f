"""The kernel boundary of a dry run: clock, interrupt, I2C, GPIO and sysfs, with the simulated world behind them.

The world moves inside the waits: when the loop waits for the IMU's edge, everything up to the next sample happens, the
chip takes its sample and the edge is pushed into the line's descriptor with the time at which it was due. In real time the
wait then sleeps until that moment (so the wake-up latency is the machine's own); on virtual time the clock jumps to it.
The time that the fakes take between edge and motor write is measured, and reported apart.
"""

import select
import time
from pathlib import Path

import numpy as np

from mip_rt.fake.usual_sample import EDGE, FALLING, NO_ROOM, UNUSUAL
from mip_rt.fake.world import TRUTH_ROWS
from mip_rt.hardware.kernel import Kernel
from mip_rt.hardware.line_events import BUFFERED

SAMPLE_NS = 5_000_000
CATCH_UP_S = 0.2  # one wait may make up for lost samples so long: a machine too slow for the world keeps its loop alive, which can be stopped


class FakeKernel(Kernel):
    """See the module. The parts are attached by `fake.bench.build`.

    Args:
        root: temporary folder that stands for "/".
        real_time: sleep for real, or jump on a virtual clock.

    Attributes:
        start_ns: time of the world's sample 0.
        fake_ns: (rows, 2) time spent in the fakes during each sample's tick, before the loop woke and while it read; the row is
            that of the world's truth. Only in real time.
    """

    def __init__(self, root: Path, real_time: bool):
        self.root = Path(root)
        self._real = real_time
        if real_time:
            self.monotonic_ns = time.monotonic_ns
        self.start_ns = time.monotonic_ns() if real_time else 1_000_000_000
        self._now_ns = self.start_ns
        self._next_ns = self.start_ns + SAMPLE_NS
        self._prepared = False
        self._poll = select.poll()
        self._polled = set()
        self.fake_ns = np.zeros((TRUTH_ROWS, 2), np.int64)
        self._fake_row = self._own = 0
        self._watched = ()
        self.world = self.chip = self.operator = self.entrance = self.sysfs = self.gpio = self.bus = None
        self.imu_line = self.motor_wiring = self.guard = self.taps = None

    def power_on(self) -> None:
        """The world's time begins now: in real time, what was compiled and loaded before does not count."""
        if self._real:
            self.start_ns = time.monotonic_ns()
            self._next_ns = self.start_ns + SAMPLE_NS

    # -- what drivers call -------------------------------------------------------------------------------------------
    def monotonic_ns(self) -> int:
        """The virtual clock, or the machine's: then this is the system's own function."""
        return self._now_ns

    def ioctl(self, fd, request, argument, mutate=True):
        """GPIO only."""
        return self.gpio.ioctl(fd, request, argument, mutate)

    def open_i2c(self, bus: int):
        """The bus with the chip."""
        return self.bus

    def sleep(self, seconds: float) -> None:
        """Lets time and world pass; sysfs files that want an answer get one."""
        self._pass_until(self.monotonic_ns() + round(seconds * 1e9))
        self.sysfs.service()

    def wait_readable(self, fd: int, timeout_s: float) -> bool:
        """Lets the world move to its next sample, and waits for its moment."""
        if fd not in self._polled:
            self._poll.register(fd, select.POLLIN)
            self._polled.add(fd)
        now_ns = self.monotonic_ns()
        if self._next_ns > now_ns and self.gpio.pushed and self._poll.poll(0):
            return True
        deadline_ns = now_ns + round(timeout_s * 1e9)
        while True:
            if self._next_ns > deadline_ns:
                self.wait_until(deadline_ns)
                return bool(self._poll.poll(0))
            fell = self._sample()
            if self._real:
                give_up_ns = time.monotonic_ns() + round(CATCH_UP_S * 1e9)
                while self._next_ns <= time.monotonic_ns() < give_up_ns:
                    fell |= self._sample()  # the loop was late: these edges came in the meantime
            if fell and fd == self.gpio.event_fd(*self.imu_line) or self._poll.poll(0):
                return True

    def waiter(self, line, timeout_s: float):
        """As the real kernel's."""
        gpio = self.gpio

        def wait():
            if not self.wait_readable(line.fd, timeout_s):
                return 0
            taken = line.take()
            gpio.pushed = taken >= BUFFERED  # more may wait
            return taken

        return wait

    def sample_of(self, edge_ns: int) -> int:
        """Number of the world's sample that raised the edge with this timestamp."""
        return (edge_ns - self.start_ns) // SAMPLE_NS

    # -- the world behind --------------------------------------------------------------------------------------------
    def wait_until(self, moment_ns: int) -> None:
        """Lets time pass, without the world."""
        if not self._real:
            self._now_ns = max(self._now_ns, moment_ns)
            return
        remaining = moment_ns - time.monotonic_ns()
        if remaining > 0:
            time.sleep(remaining * 1e-9)

    def stall(self, seconds: float) -> None:
        """The caller is kept from going on, busy in real time, while the world moves."""
        end_ns = self.monotonic_ns() + round(seconds * 1e9)
        while self._real and time.monotonic_ns() < end_ns:
            pass
        self._pass_until(end_ns)

    def _pass_until(self, moment_ns: int) -> None:
        while self._next_ns <= moment_ns:
            self._sample()
        self.wait_until(moment_ns)

    def _sample(self) -> bool:
        """One IMU sample: the world moves up to it, then its moment comes, then the chip takes it; True where its driver got an edge."""
        due_ns, real, world, wiring = self._next_ns, self._real, self.world, self.motor_wiring
        usual = self._line() if self._watched else None
        if usual:
            enabled, watchers = wiring.enable_is_high, self.taps.changes
        else:
            enabled = self._see_duties(due_ns)
        now_s = (due_ns - self.start_ns) * 1e-9
        if self.entrance is not None:
            self.entrance.serve(now_s, due_ns)
        self.operator.sample(now_s, due_ns, enabled)
        found = UNUSUAL
        if usual:
            if self.taps.changes == watchers:
                found = world.usual_sample(usual.address, due_ns)
            if found == UNUSUAL:
                enabled = self._see_duties(due_ns)
        if found == UNUSUAL:
            world.advance(world.duty, enabled)
            wiring.show_encoders(world.counts)
        if world.samples % 40 == 1:
            wiring.show_battery(world.battery_raw)
        self._next_ns = due_ns + SAMPLE_NS
        if not real:
            if due_ns > self._now_ns:
                self._now_ns = due_ns
            if found < NO_ROOM:
                return self._take_sample(due_ns)
            self.gpio.pushed = True
            return found == EDGE
        self.wait_until(due_ns)
        begin = time.perf_counter_ns()
        fell = self._take_sample(due_ns)
        self._fake_row = world.truth_row
        self.fake_ns[self._fake_row] = time.perf_counter_ns() - begin, 0
        return fell

    def attach_usual(self) -> None:
        """From now on usual samples are compiled, on virtual time. A method that is replaced makes an object's dictionary grow, by which it is noticed."""
        self._watched = tuple(vars(part) for part in (self.chip, self.gpio, self.world, self.motor_wiring, self.guard))
        self._own = sum(map(len, self._watched))

    def _line(self):
        """The edges.Line of the IMU's interrupt where the next sample is a usual one, as far as can be seen here; otherwise None."""
        chip, gpio, world, wiring, guard = self._watched
        if len(chip) + len(gpio) + len(world) + len(wiring) + len(guard) != self._own:
            return None
        if not self.chip.may_be_usual or not self.guard.alive or not self.motor_wiring.connected():
            return None
        return self.gpio.events_of(*self.imu_line)

    def _see_duties(self, due_ns: int) -> bool:
        """The guard's look on virtual time, then what the motor drivers see; whether they are enabled."""
        if self.guard is not None:
            self.guard.step(due_ns)
        return self.motor_wiring.read(self.world.duty)

    def _take_sample(self, due_ns: int) -> bool:
        """The chip takes what the world shows; True where its driver got an edge."""
        return self.chip.sample(self.world.packet, self.world.raw) and self.gpio.push_edge(*self.imu_line, due_ns, FALLING)

    def charge(self, spent_ns: int) -> None:
        """Books time that a fake took inside the present tick."""
        self.fake_ns[self._fake_row, 1] += spent_ns
