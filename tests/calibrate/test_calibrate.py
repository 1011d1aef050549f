"""Calibration on the fake board: what is wrong with the simulated unit is found; bad data are refused with a reason and change nothing; a run uses it."""

import json

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt import session as runner
from mip_rt import unit_file
from mip_rt.calibrate import accelerometer
from mip_rt.calibrate.commands import calibrate
from mip_rt.doctor.interview import Person
from mip_rt.doctor.patient import Patient
from mip_rt.errors import MipRtError
from mip_rt.fake import patient as fake_patient
from mip_rt.models import mounting
from mip_rt.supervisor import State

TRUE_GAIN, TRUE_OFFSET = np.array([1.03, 0.98, 1.01]), np.array([0.3, -0.2, 0.15])


class Agreeing(Person):
    def _answer(self, text, hint):
        return "yes"


class Unit:
    """A patient on the fake board."""

    def __init__(self, robot="mbbr", **changes):
        self._opened = fake_patient.opened(make_config(robot, **changes))
        self.bench, self.hands = self._opened.__enter__()
        bench = self.bench
        self.patient = Patient(bench.kernel, make_config(robot, **changes), None, lambda: bench.guard, (bench.image_path, bench.image_sha256), None,
                               Agreeing(self.hands))  # fmt: skip

    def __enter__(self):
        return self

    def __exit__(self, *rest):
        self.patient.close()
        self._opened.__exit__(*rest)

    @property
    def path(self):
        return unit_file.unit_path(self.patient.config, self.patient.kernel)

    def measure(self, what):
        return calibrate(self.patient, what, "7")[0].parts[what]


def refused(unit, what, code, *words):
    with pytest.raises(MipRtError) as caught:
        unit.measure(what)
    assert caught.value.code == code and caught.value.cure and not unit.path.exists(), caught.value
    for word in words:
        assert word in caught.value.sentence + caught.value.cure


def test_gyro():
    """Against the bias that the world has, in body axes; a robot that moves is refused, and nothing is stored."""
    with Unit(dry_run__gyro_bias_rad_s="[0.02, -0.03, 0.01]") as unit:
        found = unit.measure("gyro")
        assert np.allclose(found["bias_rad_s"], [0.02, -0.03, 0.01], atol=5e-4) and found["windows_differ_rad_s"] < 0.002
        content = json.loads(unit.path.read_text())
        assert content["version"] == 2 and content["unit"] == "7" and content["gyro_bias_rad_s"] == found["bias_rad_s"]
    with Unit() as unit:
        unit.bench.injector.taps.add(unit.bench.world, "advance", lambda call, *rest: (_shake(unit.bench.world), call(*rest))[1])
        refused(unit, "gyro", "calibrate_moved", "moved")


def _shake(world):
    world.parameters[0].gyro_bias_rad_s[0] = 0.1 * (-1.0) ** (world.samples // 10)


def test_gyro_windows_that_disagree_are_refused():
    """A slow turn, or a chip that warms up: each window is still, the two differ."""
    with Unit() as unit:

        def drift(call, *rest):
            unit.bench.world.parameters[0].gyro_bias_rad_s[1] += 1e-5
            return call(*rest)

        unit.bench.injector.taps.add(unit.bench.world, "advance", drift)
        refused(unit, "gyro", "calibrate_disagree", "differ")


def test_level():
    """An IMU that is mounted crooked: found, and undone in a run; one that lies on its side is no mounting error."""
    with Unit(dry_run__imu_misalignment_rad="[-0.04, 0.03, 0.0]", dry_run__dmp_noise_rad="0.0") as unit:
        found = unit.measure("level")
        assert np.allclose(found["lean_rad"], [0.04, -0.03], atol=4e-3), found
        assert found["accelerometer_differs_rad"] < 0.01
    with Unit(dry_run__dmp_offset_rad="[0.12, 0.0]") as unit:
        refused(unit, "level", "calibrate_level", "differ")


@pytest.mark.parametrize("robot", ["mbbr", "edumip"])
def test_accelerometer_six_positions(robot):
    with Unit(robot) as unit:
        unit.hands.accel_gain[:], unit.hands.accel_offset_m_s2[:] = TRUE_GAIN, TRUE_OFFSET
        found = unit.measure("accelerometer")
        assert np.allclose(found["gain"], TRUE_GAIN, atol=2e-3) and np.allclose(found["offset_m_s2"], TRUE_OFFSET, atol=0.02)
        assert found["residual_m_s2"] < 0.03 < 0.2 < found["before_m_s2"]


def test_accelerometer_refuses_a_wrong_position_and_an_incredible_fit():
    with Unit() as unit:
        place = unit.hands._place
        unit.hands._place = lambda axis, sign: place(axis, 1)
        refused(unit, "accelerometer", "calibrate_position", "x axis is not down")
    with Unit() as unit:
        unit.hands.accel_gain[:] = (1.0, 1.0, 0.7)
        refused(unit, "accelerometer", "calibrate_accelerometer", "sound chip")
    with pytest.raises(MipRtError, match="determine"):
        accelerometer.fit([[0.0, 0.0, 9.8]] * 12)


def test_the_fit_is_exact_for_points_on_an_ellipsoid_and_any_direction():
    random = np.random.default_rng(3)
    directions = random.standard_normal((40, 3))
    directions *= 9.80665 / np.linalg.norm(directions, axis=1, keepdims=True)
    gain, offset = accelerometer.fit((directions + TRUE_OFFSET) / TRUE_GAIN)
    assert np.allclose(gain, TRUE_GAIN, atol=1e-9) and np.allclose(offset, TRUE_OFFSET, atol=1e-8)


def test_encoders_and_motors():
    with Unit() as unit:
        unit.hands.counts_per_turn, unit.hands.encoder_signs[0] = 1092, 1
        found = unit.measure("encoders")
        assert found["counts_per_turn"] == 1092 and found["signs"] == [1, 1, 1]
        unit.hands.drives[2] = (2, -1)
        assert unit.measure("motors")["signs"] == [1, -1, -1]  # by the encoders' signs just found
    with Unit() as unit:
        unit.hands.dead_channels.add(1)
        refused(unit, "encoders", "calibrate_encoders", "wheel 2")
    with Unit() as unit:
        unit.hands.drives[:2] = [(1, 1), (0, 1)]
        refused(unit, "motors", "calibrate_motors", "another wheel")


def test_motors_without_a_yes_do_not_move():
    with Unit() as unit:
        unit.patient.person._answer = lambda text, hint: "y"
        refused(unit, "motors", "calibrate_motors", "agree")
        assert not any(unit.bench.kernel.sysfs.duty_ns(*pin) for pin in (("48302200", 0), ("48304200", 0)))


def test_a_broken_file_is_not_overwritten():
    with Unit() as unit:
        unit.path.parent.mkdir(parents=True)
        unit.path.write_text("{")
        with pytest.raises(MipRtError, match="cannot be used"):
            unit.measure("gyro")
        assert unit.path.read_text() == "{"


# -- a run with it --------------------------------------------------------------------------------------------------------
def _with_file(monkeypatch, parts):
    def place_first(config, kernel):
        path = unit_file.unit_path(config, kernel)
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps({"version": 2, "unit": "7", "parts": parts}))
        return unit_file.apply_unit_file(config, kernel)

    monkeypatch.setattr(runner, "apply_unit_file", place_first)


def test_a_run_uses_level_gain_and_counts_and_logs_them(tmp_path, monkeypatch):
    """Crooked IMU: without the file the DMP's attitude is off by the mounting error, with it by a tenth; the header says what was in force."""
    from mip_rt import log

    date = {"measured_unix_s": 1.7e9}
    crooked = make_config(estimator__shadows="[]", dry_run__imu_misalignment_rad="[-0.04, 0.03, 0.0]", dry_run__initial_lean_rad="[0.0, 0.0]")
    leans = {}
    for name, parts in (("without", {}), ("with", {"level": {**date, "lean_rad": [0.04, -0.03]}, "encoders": {**date, "counts_per_turn": 1092, "signs": [-1, 1, 1]}})):
        _with_file(monkeypatch, parts)
        with DryRun(tmp_path / name if (tmp_path / name).mkdir() is None else None, crooked) as dry:
            dry.until(lambda: dry.state is State.DISARMED)
            rows = dry.session.ring.rows[: dry.session.loop.ticks]
            leans[name] = np.abs(rows["attitude_rad"][100:, :2].mean(0))
            force = rows["acceleration_m_s2"][100:].mean(0)
            level = np.abs(np.arctan2(force[:2], -force[2]))
            file, config = dry.session.ring.path, dry.session.config
            if name == "with":
                assert config.encoders.counts_per_turn == 1092 and (level < 0.01).all() and (leans[name] < 0.01).all()
            else:
                assert config.encoders.counts_per_turn == 1080 and (leans[name] > 0.025).all() and (level > 0.025).all()
    header = log.open(file).header
    assert header["calibration"]["unit"] == "7" and "level_rad: [0.04, -0.03]" in header["config"]


def test_a_file_of_another_robot_keeps_this_one_disarmed(tmp_path, monkeypatch):
    """Two signs for three wheels: not applied, and the pre-arm check says so."""
    _with_file(monkeypatch, {"motors": {"measured_unix_s": 1.7e9, "signs": [1, -1]}})
    with DryRun(tmp_path) as dry:
        dry.until(lambda: dry.state is State.DISARMED)
        dry.until(lambda: dry.session.loop.ticks % 40 == 1)
        assert any(refusal.code == "calibration_invalid" for refusal in dry.session.refusals)
        assert dry.session.config.motors.signs == (1, -1, 1)


def test_level_as_matrix_and_as_quaternion_are_one_rotation():
    w, x, y, z = mounting.level_quaternion((0.1, -0.07))
    matrix = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
              [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]  # fmt: skip
    assert np.allclose(matrix, mounting.level_rotation((0.1, -0.07)), atol=1e-12)
