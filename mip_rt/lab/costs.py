"""Costs of a tick without its surroundings: N steps of the EKF, N whole ticks, or N times one part of a tick.

For a tick the fakes are replaced after the robot has balanced for some time, and play back what they gave: the IMU's line is a pipe that holds an event for
every tick to come, the bus makes a real ioctl with a request that does nothing and shows the next recorded packet, the encoders and PWM files are real
files. What remains is what the controller itself costs, which `tools/test-armhf` counts in instructions; a few hundred are the play-back's.
"""

import fcntl
import itertools
import mmap
import os
import tempfile
import time
from functools import partial

import numpy as np

from mip_rt import config as configuration
from mip_rt import robots
from mip_rt import session as runner
from mip_rt.compiled import direct, entry, njit, records_at
from mip_rt.config import scenario as scenarios
from mip_rt.estimators import attitude, mbbr_ekf, mip_ekf, momentum_observer
from mip_rt.fake import bench as fake_bench
from mip_rt.fake.kernel import SAMPLE_NS
from mip_rt.hardware import compiled_io, system_calls
from mip_rt.hardware.gpio import EVENT_V2
from mip_rt.hardware.imu_status import IMU_OK
from mip_rt.hardware.kernel import Kernel
from mip_rt.supervisor import Condition, State

CHANGES = 8  # different pulses
MOST = 2400  # recorded ticks: the same for a short and a long run, so that they do not count
FIOCLEX = 0x5451  # an ioctl without effect here


@njit
def ekf_steps(parameters, states, u, y, count):
    """`count` cycles of the 13-state EKF in slot 0."""
    for _ in range(count):
        mbbr_ekf.step(parameters[0].ekf, states[0].filter, u, y, mbbr_ekf.ALL_VALID)


@njit
def mip_ekf_steps(parameters, states, u, y, count):
    """`count` cycles of the 6-state EKF in slot 0."""
    for _ in range(count):
        mip_ekf.step(parameters[0].ekf, states[0].filter, u, y, mip_ekf.ALL_VALID)


@njit
def _momentum_steps(parameters, states, y, count):
    for _ in range(count):
        momentum_observer.step(parameters[0].momentum, states[0], y, momentum_observer.ALL_VALID)


def momentum_steps(count: int) -> None:
    """Runs `count` cycles of the momentum observer."""
    arguments = robots.setup("mbbr").build(shipped(**{"estimator.control": "momentum"}))._arguments
    _momentum_steps(arguments[2], arguments[3], np.zeros(8), count)


def attitude_steps(count: int) -> None:
    """Runs `count` cycles of the onboard attitude on a recording of standing still."""
    p = np.zeros(1, attitude.PARAMETERS).view(np.recarray)[0]
    attitude.configure(p, 0.005)
    state, gyro, force, found = attitude.init(p), np.zeros((1000, 3)), np.full((1000, 3), (0.0, 0.0, 9.81)), np.empty((1000, 4))
    for _ in range(max(1, count // 1000)):
        attitude.run(p, state, gyro, force, found)


def shipped(robot="mbbr", **overrides):
    """The shipped configuration with one estimator."""
    return configuration.load(configuration.default_path(robot), {"estimator.shadows": "[]", "log.ring_s": "5", **overrides})


def steps(count: int, robot: str = "mbbr") -> None:
    """Runs `count` steps of the robot's EKF."""
    arguments = robots.setup(robot).build(shipped(robot))._arguments
    kernel, inputs, outputs = {"mbbr": (ekf_steps, 3, 8), "edumip": (mip_ekf_steps, 2, 4)}[robot]
    kernel(arguments[2], arguments[3], np.full(inputs, 0.05), np.zeros(outputs), count)


SHOW = np.dtype(
    [("fd", "i8"), ("turn", "i8"), ("packet", "u8"), ("packets", "u8"), ("counts", "u8"), ("encoders", "u8", (compiled_io.MOST,))], align=True
)


@entry("uintp", "uintp")
def show(state_at, prepared):
    """As a bus's transfer: an ioctl that does nothing; after every second one (the FIFO was read) the next packet appears, and the counts of the next tick.

    Args:
        state_at: address of one SHOW.
        prepared: not used.
    """
    s = records_at(state_at, 1, SHOW)[0]
    if s.turn & 1:
        n = s.turn >> 1
        packet, packets = records_at(s.packet, 4, np.uint64), records_at(s.packets, 4 * (n + 1), np.uint64)
        for i in range(4):
            packet[i] = packets[4 * n + i]
        counts = records_at(s.counts, compiled_io.MOST * (n + 2), np.int64)
        for i in range(compiled_io.MOST):
            if s.encoders[i] != 0:
                compiled_io.decimal(counts[compiled_io.MOST * (n + 1) + i], records_at(s.encoders[i], compiled_io.TEXT, np.uint8))
    s.turn += 1
    return system_calls.transfer(s.fd, FIOCLEX, 0)


def _fill(line, start_ns: int, count: int) -> None:
    """Puts a pipe under the line's descriptor that holds an event for each of `count` ticks, to be read one by one."""
    mine, theirs = os.pipe()
    fcntl.fcntl(theirs, fcntl.F_SETPIPE_SZ, 1 << 20)
    os.set_blocking(mine, False)
    sequence = int(line.state["sequence"][0])
    os.write(theirs, b"".join(EVENT_V2.pack(start_ns + i * SAMPLE_NS, 2, 0, sequence + i, sequence + i) for i in range(1, count + 1)))
    os.dup2(mine, line.fd)
    os.close(mine)
    line.state["room"] = EVENT_V2.size


def stubbed_loop(robot: str = "mbbr", count: int = MOST):
    """(loop, bench): a loop in BALANCING whose boundary plays back what it gave in a dry run, for `count` ticks; it was then set back to the beginning."""
    bench = fake_bench.build(shipped(robot), scenarios.load("hold"), 1, False)
    session = runner.Session(shipped(robot), bench, tempfile.mkdtemp(), bench.remote.device, 1, "costs")
    loop, kernel, devices = session.loop, bench.kernel, session.loop.devices

    def turn():
        loop.tick()
        session._between_ticks(loop.ticks - 1)

    while session.supervisor.state is not State.BALANCING or session.supervisor.drive_scale < 1.0:
        turn()
    kept = [session.robot.state, session.robot.estimator_states, devices.counters]
    saved, begin_ns = [part.copy() for part in kept], int(devices.imu_line.state["timestamp_ns"][0])
    packets, counts = np.zeros((count, 32), np.uint8), np.zeros((count + 1, compiled_io.MOST), np.int64)
    for n in range(count):
        turn()
        packets[n], counts[n] = devices.imu.packet, devices.counters["raw"][0]
    for part, before in zip(kept, saved):
        part[:] = before

    null = os.open(os.devnull, os.O_RDONLY)
    shown = np.zeros(1, SHOW)
    shown["fd"], files = null, []
    shown["packet"], shown["packets"], shown["counts"] = (part.ctypes.data for part in (devices.imu.packet, packets, counts))
    for i, encoder in enumerate(devices.encoders):
        encoder.path.write_bytes(f"{counts[0, i]}\n".encode().ljust(compiled_io.TEXT, b"\0"))
        with encoder.path.open("r+b") as file:
            files.append(np.frombuffer(mmap.mmap(file.fileno(), compiled_io.TEXT), np.uint8))
        shown["encoders"][0, i] = files[-1].ctypes.data
    kernel.bus.transfer, kernel.bus.shown = partial(direct(show), shown.ctypes.data), (shown, packets, counts, files)
    devices.imu._count_bytes[:] = (32).to_bytes(2, "big")
    devices.imu._read_count, devices.imu._read_fifo = 0, [0]
    real = Kernel()
    real.wait_readable(null, 0.0)  # the first call is its own replacement
    kernel.wait_readable, kernel.monotonic_ns = real.wait_readable, real.monotonic_ns
    kernel.ioctl = lambda fd, request, argument, mutate=True: real.ioctl(null, FIOCLEX, argument, mutate)
    _fill(devices.imu_line, begin_ns, count)
    bench.guard.patience_s(1e4)  # it lives on the clock that has just been left, and is no part of the tick
    devices.remote.state["frame_ns"], devices.remote.state["timeout_s"] = real.monotonic_ns(), 1e4
    return loop, bench


def ticks(count: int, robot: str = "mbbr", recorded: int = MOST) -> float:
    """Runs `count` stubbed ticks, of so many recorded ones; returns the seconds they took."""
    loop, bench = stubbed_loop(robot, recorded)
    begin = time.perf_counter()
    for _ in range(count):
        loop.tick()
    elapsed = time.perf_counter() - begin
    assert loop.supervisor.state is State.BALANCING, loop.supervisor.fault.sentence
    loop.supervisor.shut_down()
    bench.close()
    return elapsed


PARTS = ("wait", "encoders", "imu", "inputs", "step", "supervisor", "log", "slack", "nothing")


def parts(name: str, count: int) -> float:
    """Runs one of PARTS `count` times, as a tick calls it; returns the seconds it took."""
    loop, bench = stubbed_loop()
    loop.tick()
    devices, ring, supervisor, at = loop.devices, loop.ring, loop.supervisor, loop.robot.layout.offset
    index = (loop.ticks - 1) % ring.capacity
    kernel, line, state = bench.kernel, devices.imu_line, supervisor.state
    changing = itertools.cycle([loop.robot.layout.pulses.pack(1000 + i, -2000 - i, 3000 + i) for i in range(CHANGES)])

    def supervise():
        ring.buffer[at["duty_ns"] : at["duty_ns"] + 24] = next(changing)
        supervisor.apply(0, Condition.IMU_GOOD, True, 0)

    def record():
        ring.begin(index)
        ring.commit(index, 5)

    action = {
        "wait": lambda: kernel.wait_readable(line.fd, loop.silence_s) and line.take(),
        "encoders": loop._read_counters,
        "imu": devices.imu.read,
        "inputs": lambda: loop._gather(index, 5, 6, 7, state, supervisor.request, 0, IMU_OK, devices.imu.backlog, devices.battery_v, 1.0),
        "step": lambda: loop.robot.step(index),
        "supervisor": supervise,
        "log": record,
        "slack": lambda: loop._slack(5),
        "nothing": lambda: None,
    }[name]
    begin = time.perf_counter()
    for _ in range(count):
        action()
    elapsed = time.perf_counter() - begin
    supervisor.shut_down()
    bench.close()
    return elapsed


def run(kind: str, count: int) -> None:
    """`kind` is "ekf", "attitude", "momentum", "tick" or one of PARTS."""
    if kind in PARTS:
        parts(kind, count)
    else:
        {"ekf": steps, "attitude": attitude_steps, "momentum": momentum_steps, "tick": ticks}[kind](count)
