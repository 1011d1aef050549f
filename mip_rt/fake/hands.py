"""The person beside a dry run's board, as doctor and calibrate ask for one: turns wheels, lifts the robot, lays it on its sides, moves the stick."""

import math
import random
import struct

import numpy as np

from mip_rt.fake.faults_io import shift_counts

NO_LOAD_TURNS_S = 8.0  # at full duty, wheels in the air
NOISE_M_S2 = 0.05
GRAVITY_M_S2 = 9.80665


class Hands:
    """Does what is asked; what it knows of the robot may differ from the configuration.

    Args:
        bench: fake.bench.Bench.
        config: the configuration that the robot was built by.

    Attributes:
        counts_per_turn, encoder_signs: of the robot as it is.
        drives: by motor output as configured, (wheel, sign) that it turns.
        dead_channels: wheels of whose encoder one channel is not connected.
        accel_gain, accel_offset_m_s2: (3,) of the chip: true = gain * measured - offset.
        restless: the robot is not kept still.
    """

    def __init__(self, bench, config):
        self._bench, self._config = bench, config
        wheels = len(config.encoders.channels)
        self.counts_per_turn = config.encoders.counts_per_turn
        self.encoder_signs = list(config.encoders.signs)
        self.drives = [(wheel, 1) for wheel in range(wheels)]
        self.dead_channels = set()
        self.accel_gain, self.accel_offset_m_s2 = np.ones(3), np.zeros(3)
        self.restless = False
        self._rest = [0.0] * wheels  # fractions of a count
        self._up = None
        self._random = random.Random("hands")
        self._shown, self._base = [None] * wheels, [0] * wheels
        bench.injector.taps.add(bench.kernel.chip, "sample", self._sample)
        bench.injector.taps.add(bench.kernel.motor_wiring, "show_encoders", self._show)

    def __call__(self, act: tuple) -> None:
        getattr(self, f"_{act[0]}")(*act[1:])

    def _count(self, wheel: int, turns: float) -> None:
        if wheel in self.dead_channels:
            turns = 0.0
        exact = turns * self.counts_per_turn * self.encoder_signs[wheel] + self._rest[wheel]
        whole = math.floor(exact)
        self._rest[wheel] = exact - whole
        shift_counts(self._bench.injector, wheel, whole)

    def _show(self, call, counts):
        """A count that a driver has written stays in force, as in a counter: doctor and calibrate start the same counter more than once."""
        for i in range(len(self._shown)):
            found = self._bench.kernel.motor_wiring.count_file(i).number()
            if self._shown[i] is not None and found != self._shown[i] & 0xFFFFFFFF:
                self._base[i] += found - (self._shown[i] & 0xFFFFFFFF)
        self._shown = [int(count) + base for count, base in zip(counts, self._base)]
        return call(np.array(self._shown))

    def _turn(self, wheel: int, turns: float) -> None:
        self._count(wheel, turns)
        self._bench.kernel.sleep(0.1)

    def _lift(self) -> None:
        bench = self._bench
        bench.kernel.operator.grip()

        def read(call, duty):
            enabled = call(duty)
            if enabled:
                for i, (wheel, sign) in enumerate(self.drives):
                    self._count(wheel, sign * float(duty[i]) * NO_LOAD_TURNS_S * 0.005)
            return enabled

        bench.injector.taps.add(bench.kernel.motor_wiring, "read", read)

    def _seen(self, wheel: int) -> None:
        """Only looks."""

    def _stick(self) -> None:
        operator = self._bench.kernel.operator

        def sample(call, now_s, now_ns, enabled):
            operator._x, operator._y = 0.8 * math.sin(5.0 * now_s), 0.8 * math.cos(5.0 * now_s)
            return call(now_s, now_ns, enabled)

        self._bench.injector.taps.add(operator, "sample", sample)

    def _stand(self) -> None:
        """Puts the robot upright on a stand, without a tremor."""
        world = self._bench.world
        self._bench.kernel.operator.grip()
        world.lean_rad = np.zeros_like(world.lean_rad)
        world.hold()
        if not self.restless:
            world.state[0].held = 2
        self._bench.kernel.sleep(2.0)

    def _place(self, axis: int, sign: int) -> None:
        """Lays the robot so that this axis of the chip points up or down."""
        self._stand()
        self._up = np.zeros(3)
        self._up[axis] = sign * GRAVITY_M_S2

    def _sample(self, call, packet, raw):
        plain = np.array_equal(self.accel_gain, np.ones(3)) and not self.accel_offset_m_s2.any()
        if self._up is None and plain:
            return call(packet, raw)
        scale = self._config.imu.accel_range_g * GRAVITY_M_S2 / 32768.0
        changed = bytearray(packet)
        force = self._up if self._up is not None else np.array(struct.unpack_from(">3h", packet, 16)) * scale
        for axis in range(3):
            shake = 1.0 if self.restless else NOISE_M_S2
            measured = (force[axis] + self.accel_offset_m_s2[axis]) / self.accel_gain[axis] + self._random.gauss(0.0, shake)
            struct.pack_into(">h", changed, 16 + 2 * axis, max(-32768, min(32767, round(measured / scale))))
        return call(bytes(changed), bytes(changed[16:22]) + bytes(raw)[6:])
