"""Costs of a tick without its surroundings: N steps of the EKF, or N whole ticks with the boundary reduced to prepared answers.

For a tick the fakes are replaced by stubs after the robot balances: the wait returns at once, the bus copies one of a few recorded packets, the
encoders and PWM files are real files. What remains is what the controller itself costs, which `tools/test-armhf` counts in instructions.
"""

import ctypes
import itertools
import tempfile
import time

import numpy as np

from mip_rt import config as configuration
from mip_rt import session as runner
from mip_rt.compiled import njit
from mip_rt.config import scenario as scenarios
from mip_rt.estimators import mbbr_ekf
from mip_rt.fake import bench as fake_bench
from mip_rt.fake.kernel import SAMPLE_NS
from mip_rt.hardware import mpu9250_registers as registers
from mip_rt.robots import mbbr_setup
from mip_rt.supervisor import State

PACKETS = 8


@njit
def ekf_steps(parameters, states, u, y, count):
    """`count` cycles of the 13-state EKF in slot 0."""
    for _ in range(count):
        mbbr_ekf.step(parameters[0].ekf, states[0].filter, u, y, mbbr_ekf.ALL_VALID)


def shipped(**overrides):
    """The shipped configuration with one estimator."""
    return configuration.load(configuration.default_path("mbbr"), {"estimator.shadows": "[]", "log.ring_s": "5", **overrides})


def steps(count: int) -> None:
    """Runs `count` EKF steps."""
    arguments = mbbr_setup.build(shipped())._arguments
    ekf_steps(arguments[2], arguments[3], np.array([0.1, -0.1, 0.05]), np.zeros(8), count)


def stubbed_loop():
    """(loop, bench): a loop in BALANCING whose boundary gives prepared answers."""
    bench = fake_bench.build(shipped(), scenarios.load("hold"), 1, False)
    session = runner.Session(shipped(), bench, tempfile.mkdtemp(), bench.remote.device, 1, "costs")
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
    kernel, count, turn = bench.kernel, (32).to_bytes(2, "big"), [0]
    numbers = {registers.FIFO_COUNT_H: count}

    def transfer(request, reply):
        if reply.len == 2:
            ctypes.memmove(reply.buf, numbers[registers.FIFO_COUNT_H], 2)
        else:
            turn[0] = (turn[0] + 1) % PACKETS
            ctypes.memmove(reply.buf, packets[turn[0]], 32)

    kernel.bus.i2c_rdwr = transfer
    kernel.wait_readable = lambda fd, timeout_s: True
    kernel.monotonic_ns = time.monotonic_ns
    edges = itertools.count(kernel._now_ns, SAMPLE_NS)
    loop.devices.imu_line.read = lambda: (next(edges), 2, 1)
    return loop, bench


def ticks(count: int) -> float:
    """Runs `count` stubbed ticks; returns the seconds they took."""
    loop, bench = stubbed_loop()
    begin = time.perf_counter()
    for _ in range(count):
        loop.tick()
    elapsed = time.perf_counter() - begin
    assert loop.supervisor.state is State.BALANCING, loop.supervisor.fault.sentence
    loop.supervisor.shut_down()
    bench.close()
    return elapsed


def run(kind: str, count: int) -> None:
    """`kind` is "step" or "tick"."""
    {"step": steps, "tick": ticks}[kind](count)
