"""Costs of a tick without its surroundings: N steps of the EKF, N whole ticks, or N times one part of a tick.

For a tick the fakes are replaced by stubs after the robot balances: the IMU's line is always readable, the bus makes the driver's own ioctl
with a request that does nothing and shows one of a few recorded packets, the encoders and PWM files are real files. What remains is
what the controller itself costs, which `tools/test-armhf` counts in instructions.
"""

import fcntl
import itertools
import os
import tempfile
import time

import numpy as np

from mip_rt import config as configuration
from mip_rt import robots
from mip_rt import session as runner
from mip_rt.compiled import njit
from mip_rt.config import scenario as scenarios
from mip_rt.estimators import attitude, mbbr_ekf, mip_ekf, momentum_observer
from mip_rt.fake import bench as fake_bench
from mip_rt.fake.kernel import SAMPLE_NS
from mip_rt.hardware.i2c import I2cBus
from mip_rt.hardware.imu_status import IMU_OK
from mip_rt.hardware.kernel import Kernel
from mip_rt.supervisor import State

PACKETS = 8
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


def stubbed_loop(robot: str = "mbbr"):
    """(loop, bench): a loop in BALANCING whose boundary gives prepared answers."""
    bench = fake_bench.build(shipped(robot), scenarios.load("hold"), 1, False)
    session = runner.Session(shipped(robot), bench, tempfile.mkdtemp(), bench.remote.device, 1, "costs")
    loop, packets = session.loop, []
    while len(packets) < PACKETS:
        loop.tick()
        session._between_ticks(loop.ticks - 1)
        if session.supervisor.state is State.BALANCING and session.supervisor.drive_scale >= 1.0:
            packets.append(bytes(bench.world.packet))
    # A stubbed robot neither moves its wheels nor answers its motors: the detectors work, but must not end the measurement.
    patient = session.robot.parameters[0].health
    patient.stall_duty_s = patient.mismatch_limit_rad = np.inf
    patient.saturation_ticks = 1 << 40
    kernel, imu, readable = bench.kernel, loop.devices.imu, os.pipe()
    os.write(readable[1], b"x")
    turn, lone = itertools.cycle(packets), imu._packets[0]
    count = I2cBus.prepare(*imu._kept[:2])  # the structure that the real driver hands to the kernel

    def transfer(prepared):
        fcntl.ioctl(readable[0], FIOCLEX, count)
        if prepared is not imu._read_count:
            lone[:] = next(turn)

    imu._count_bytes[:] = (32).to_bytes(2, "big")
    kernel.bus.transfer = transfer
    real = Kernel()
    kernel.wait_readable = lambda fd, timeout_s: real.wait_readable(readable[0], timeout_s)
    kernel.monotonic_ns = time.monotonic_ns
    edges = itertools.count(kernel._now_ns, SAMPLE_NS)
    loop.devices.imu_line.read = lambda: (next(edges), 2, 1)
    bench.guard.patience_s(1e4)  # it lives on the clock that has just been left, and is no part of the tick
    return loop, bench


def ticks(count: int, robot: str = "mbbr") -> float:
    """Runs `count` stubbed ticks; returns the seconds they took."""
    loop, bench = stubbed_loop(robot)
    begin = time.perf_counter()
    for _ in range(count):
        loop.tick()
    elapsed = time.perf_counter() - begin
    assert loop.supervisor.state is State.BALANCING, loop.supervisor.fault.sentence
    loop.supervisor.shut_down()
    bench.close()
    return elapsed


PARTS = ("imu", "encoders", "step", "supervisor")


def parts(name: str, count: int) -> float:
    """Runs one of PARTS `count` times, as a tick calls it; returns the seconds it took."""
    loop, bench = stubbed_loop()
    loop.tick()
    devices, ring, supervisor, at = loop.devices, loop.ring, loop.supervisor, loop.robot.layout.offset
    changing = itertools.cycle([loop.robot.layout.pulses.pack(1000 + i, -2000 - i, 3000 + i) for i in range(PACKETS)])

    def supervise():
        ring.buffer[at["duty_ns"] : at["duty_ns"] + 24] = next(changing)
        supervisor.apply(0, IMU_OK, 0, 0, True, 0)

    action = {
        "imu": lambda: devices.imu.read(ring.buffer, at["imu_packet"]),
        "encoders": lambda: loop._read_counters(0),
        "step": lambda: loop.robot.step(0),
        "supervisor": supervise,
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
