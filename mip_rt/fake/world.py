"""The simulated world: the robot, its motors and its sensors, from the configuration's model and its `dry_run` section.

`World.advance` moves everything by one IMU sample (5 ms) in one compiled call, and leaves what the chips would hold: the DMP's packet, the raw
registers, the encoder counts, the battery's ADC reading; and the truth, for judging estimators. Randomness comes from one seeded
generator, drawn in blocks: the same seed and commands give the same world, bit for bit.
"""

import importlib
import math
from functools import partial

import numpy as np

from mip_rt.compiled import direct, plain, span
from mip_rt.fake import usual_sample
from mip_rt.fake.plant import NORMALS
from mip_rt.fake.usual_sample import UNUSUAL
from mip_rt.hardware.compiled_io import MOST

BLOCK = 1024  # samples of random numbers drawn at a time
TRUTH_ROWS = 4096
SAMPLE_S = 0.005
GROUND_TILT_RAD = math.radians(80.0)


def rotation_from_vector(vector) -> np.ndarray:
    """(3, 3) rotation by a small rotation vector, rad."""
    x, y, z = vector
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        return np.eye(3)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / angle
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


class World:
    """One simulated robot.

    Args:
        config: a configuration with model, wheels, motor, motors, encoders, imu, friction, battery and dry_run sections.
        seed: of all randomness.

    Attributes:
        duty: (wheels,) where the boundary puts the signed duties that the motor drivers see.
        packet: 32 bytes, the DMP's packet of the newest sample, in the chip's form.
        raw: 14 bytes, accelerometer, temperature and gyro registers.
        counts: (wheels,) int64 encoder counts by wheel, wiring signs included.
        truth: (TRUTH_ROWS,) ring of the plant's TRUTH, row `truth_row` is the newest; `truth_rows` is the same as a plain array.
    """

    def __init__(self, config, seed: int):
        self.plant = plant = importlib.import_module(f"mip_rt.fake.{config.robot}_plant")
        self._random = np.random.default_rng(seed)
        self.parameters = np.zeros(1, plant.PARAMETERS).view(np.recarray)
        self.state = np.zeros(1, plant.STATE).view(np.recarray)
        self.truth = np.zeros(TRUTH_ROWS, plant.TRUTH).view(np.recarray)
        self.truth_row = 0
        self.samples = self._drawn = 0
        self._normals = self._random.standard_normal((BLOCK, NORMALS))
        self._adc = (config.battery.ratio, config.battery.offset_v)
        _configure(self.parameters[0], config)
        plant.configure(self.parameters[0], config)
        self._arguments = plain(self.parameters, plant.PARAMETERS), plain(self.state, plant.STATE)
        self.truth_rows = plain(self.truth, plant.TRUTH)
        self._advance = partial(direct(plant.advance), *(number for array in self._arguments for number in span(array)))
        self._normals_at, self._normal_bytes = span(self._normals)[0], self._normals[0].nbytes
        self._truth_span = span(self.truth_rows)
        self._duty, self._duty_span = None, ()  # that of the last sample: see fake.wiring
        s = self.state[0]
        self._held = np.asarray(self.state["held"])
        s.battery_v = self.parameters[0].battery_v
        self.packet = memoryview(np.asarray(s.packet)).cast("B")
        self.counts = np.asarray(s.count)
        self._wires = np.zeros(MOST)
        self.duty = self._wires[: plant.WHEELS]
        self.raw = memoryview(np.asarray(s.raw)).cast("B")[:14]
        self.lean_rad = config.dry_run.initial_lean_rad
        self.hold()

    def hold(self) -> None:
        """The operator picks the robot up and holds it at the configured lean."""
        s = self.state[0]
        s.held = 1
        self.plant.hold(s, self.lean_rad)

    def release(self) -> None:
        """The operator lets go; a robot that lies stays down."""
        s = self.state[0]
        if s.held == 1:
            s.held = 0

    @property
    def held(self) -> bool:
        """True while in the operator's hands."""
        return self._held[0] == 1

    @property
    def battery_raw(self) -> int:
        """The ADC's reading of the battery behind its divider, 12 bits at 1.8 V."""
        ratio, offset_v = self._adc
        raw = round((float(self.state[0].battery_v) - offset_v) / ratio / 1.8 * 4095.0)
        return min(max(raw, 0), 4095)

    def advance(self, duty, enabled: bool) -> None:
        """One sample: duty is a (wheels,) float64 array of signed duties by wheel."""
        normals_at, row = self._next()
        self.samples += 1
        self.truth_row = row
        if duty is not self._duty:
            self._duty, self._duty_span = duty, span(duty)
        self._advance(normals_at, NORMALS, *self._duty_span, enabled, *self._truth_span, row)

    def _next(self) -> tuple[int, int]:
        """Where the next sample's random numbers are, and its row of the truth."""
        samples = self.samples
        block_row = samples % BLOCK
        if block_row == 0 and samples != self._drawn:
            self._random.standard_normal(out=self._normals)
            self._drawn = samples
        return self._normals_at + block_row * self._normal_bytes, (samples + 1) % TRUTH_ROWS

    def attach(self, guard, wiring, chip) -> None:
        """The parts that `usual_sample` reaches."""
        self._parts = usual_sample.parts(guard, wiring, self, chip)
        self._usual = partial(direct(self.plant.sample), span(self._parts)[0])

    def usual_sample(self, line_at: int, due_ns: int) -> int:
        """One sample and all that belongs to it, see fake.usual_sample; UNUSUAL where nothing was done.

        Args:
            line_at: address of the interrupt line's edges.LINE.
        """
        normals_at, row = self._next()
        found = self._usual(normals_at, row, line_at, due_ns)
        if found != UNUSUAL:
            self.samples += 1
            self.truth_row = row
        return found

    def set(self, name: str, value) -> None:
        """Changes a parameter of the running world.

        Raises:
            KeyError: no such parameter.
        """
        if name not in self.plant.PARAMETERS.names or name in ("model", "body_from_wheel", "chip_from_body"):
            raise KeyError(name)
        self.parameters[name] = value


def _configure(p, config) -> None:
    dry, motor = config.dry_run, config.motor
    error = dry.model_error
    p.resistance_ohm = motor.resistance_ohm
    p.torque_constant_n_m_a = motor.torque_constant_n_m_a * error.motor
    p.inductance_h, p.pwm_period_s = motor.inductance_h, 1.0 / motor.pwm_frequency_hz
    p.diode_drop_v = motor.diode_drop_v
    p.brake = 1 if motor.drive == "brake" else 0
    p.battery_v, p.battery_resistance_ohm = dry.battery_v, dry.battery_resistance_ohm
    p.battery_fade_v_s = dry.battery_fade_v_s
    counts_per_rad = config.encoders.counts_per_turn / (2.0 * math.pi)
    p.count_per_rad[:] = [sign * counts_per_rad for sign in config.encoders.signs]
    p.backlash_rad = dry.backlash_rad
    p.gyro_bias_rad_s[:], p.gyro_noise_rad_s = dry.gyro_bias_rad_s, dry.gyro_noise_rad_s
    p.gyro_drift_rad_s2[:] = dry.gyro_drift_rad_s2
    p.accel_bias_m_s2[:], p.accel_noise_m_s2 = dry.accel_bias_m_s2, dry.accel_noise_m_s2
    p.imu_misalignment[:] = rotation_from_vector(dry.imu_misalignment_rad)
    p.chip_from_body[:] = np.array(config.imu.mounting, float).T
    p.gyro_count_per_rad_s = 32768.0 / math.radians(config.imu.gyro_range_dps)
    p.accel_count_per_m_s2 = 32768.0 / (config.imu.accel_range_g * 9.80665)
    p.dmp_lag_s, p.dmp_noise_rad = dry.dmp_lag_s, dry.dmp_noise_rad
    p.dmp_noise_time_s, p.dmp_yaw_drift_rad_s = dry.dmp_noise_time_s, dry.dmp_yaw_drift_rad_s
    # A chip that is turned against the body sees the body turned the other way, and so does its DMP.
    p.dmp_offset_rad[:] = np.array(dry.dmp_offset_rad) - np.array(dry.imu_misalignment_rad)[:2]
    p.actuation_delay_steps, p.extra_delay_ticks = dry.actuation_delay_ms, dry.extra_delay_ticks
    p.tip_limit_rad = GROUND_TILT_RAD
