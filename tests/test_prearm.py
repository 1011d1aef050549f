"""Pre-arm checks, calibration and the supervisor's own test: what keeps the robot disarmed, and that nothing else arms it."""

import json
import math
import os
import time

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt import prearm, safety, self_test, session
from mip_rt.calibration import GyroCalibration
from mip_rt.config.scenario import Event, Scenario
from mip_rt.console import Live
from mip_rt.errors import MipRtError
from mip_rt.faults import FAULT_BY_NUMBER, FAULTS
from mip_rt.prearm import CHECKS, failing
from mip_rt.realtime import Scheduling
from mip_rt.session import Session
from mip_rt.supervisor import CONDITION_SENTENCES, TRANSITIONS, Condition, State, Transition
from mip_rt.unit_file import apply_unit_file, load_unit_file


def script(*events):
    return Scenario("test", "", 10.0, [Event(**event) for event in events])


def blocking(dry):
    return [check.code for check in failing(dry.session.supervisor.refusals) if check.blocks]


def disarmed(tmp_path, **overrides):
    """A run whose operator presses nothing."""
    return DryRun(tmp_path, make_config(estimator__shadows="[]", **overrides), script({"at_s": 9.0, "press": "arm"}))


# -- the table ----------------------------------------------------------------------------------------------------------
def test_every_check_has_its_own_bit_a_sentence_and_a_cure():
    assert len({check.bit for check in CHECKS.values()}) == len(CHECKS)
    for check in CHECKS.values():
        assert check.bit & check.bit - 1 == 0 and check.sentence.endswith(".") and check.cure.endswith(".")
    assert prearm.BLOCKING == sum(check.bit for check in CHECKS.values() if check.code not in ("realtime_missing", "log_space"))
    assert [check.code for check in failing(CHECKS["battery_low"].bit | CHECKS["log_space"].bit)] == ["battery_low", "log_space"]


def test_every_fault_has_its_own_number_a_sentence_a_cure_and_a_bound():
    assert len(FAULT_BY_NUMBER) == len(FAULTS)
    for fault in FAULTS.values():
        if fault.number:
            assert fault.sentence and fault.cure and fault.bound_s > 0.0 and fault.reaction


def test_every_condition_of_the_table_has_a_sentence():
    """A bit without a sentence would be an empty cell of the specification."""
    known = 0
    for bit in CONDITION_SENTENCES:
        assert bit & bit - 1 == 0
        known |= bit
    for rows in TRANSITIONS.values():
        for row in rows:
            assert (row.conditions | row.blockers) & ~known == 0


# -- self-test ----------------------------------------------------------------------------------------------------------
def changed(state, rows):
    return {**TRANSITIONS, state: rows}


@pytest.mark.parametrize(
    ("state", "rows", "words"),
    [
        (State.BOOT, (Transition(Condition.IMU_GOOD, 0, 0.0, State.BALANCING),), "without arming"),
        (State.DISARMED, (Transition(Condition.READY, 0, 0.0, State.ARMING),), "without a press"),
        (State.DISARMED, (Transition(Condition.BUTTON, 0, 0.0, State.ARMING),), "without a press of the button or without the pre-arm"),
        (State.FAULT, (Transition(Condition.BUTTON, 0, 0.0, State.ARMING),), "without a press"),
        (State.FAULT, (Transition(Condition.IMU_GOOD, 0, 0.0, State.DISARMED),), "without a press"),
        (State.BALANCING, (Transition(Condition.TIPPED, 0, 0.0, State.FAULT, "tiped"),), "unknown fault"),
        (State.BALANCING, (Transition(Condition.TIPPED, 0, 0.0, State.FAULT),), "needs its reason"),
        (State.BALANCING, TRANSITIONS[State.BALANCING][:5], "not acted upon"),
        (State.ARMING, (), "cannot be reached"),
    ],
)
def test_a_broken_table_is_found(state, rows, words):
    found = list(self_test.check_table(changed(state, rows)))
    assert any(words in sentence for sentence in found), found


def test_a_supervisor_that_keeps_its_motors_on_is_found(monkeypatch):
    """The self-test runs the real class: one that forgets to switch off must not pass."""
    limits = make_config().limits
    assert self_test.run(limits, 0.005) == []
    monkeypatch.setattr(self_test._Motors, "off", lambda self: None)
    assert any("does not switch the motors off" in sentence for sentence in self_test.run(limits, 0.005))


def test_a_failed_self_test_keeps_the_robot_disarmed(tmp_path, monkeypatch):
    monkeypatch.setattr(self_test, "run", lambda limits, dt_s: ["something is not as it should be"])
    with DryRun(tmp_path) as dry:
        dry.run(4.0)
        assert dry.state is State.DISARMED and blocking(dry) == ["self_test"]


# -- each check -----------------------------------------------------------------------------------------------------------
def test_the_checks_before_the_first_packets_and_during_calibration(tmp_path):
    with disarmed(tmp_path) as dry:
        dry.until(lambda: dry.session.loop.ticks >= 1)
        assert dry.state is State.BOOT and {"imu_starting", "calibrating"} <= set(blocking(dry))
        dry.until(lambda: dry.state is State.CALIBRATING and dry.session.loop.ticks % 20 == 1)
        assert blocking(dry) == ["calibrating"]
        dry.until(lambda: dry.state is State.DISARMED)
        dry.until(lambda: dry.session.loop.ticks % 40 == 1)
        assert blocking(dry) == [] and dry.session.why_not_armed() == "ready: press the arm button"


@pytest.mark.parametrize(("setting", "code"), [
    ({"dry_run__gyro_noise_rad_s": "0.3"}, "not_still"),
    ({"dry_run__gyro_bias_rad_s": "[0.6, 0.0, 0.0]"}, "gyro_bias"),
    ({"dry_run__dmp_offset_rad": "[0.12, 0.0]"}, "attitude_disagrees"),
])  # fmt: skip
def test_what_keeps_the_gyro_from_being_calibrated_is_named(tmp_path, setting, code):
    with disarmed(tmp_path, **setting) as dry:
        dry.run(3.0)
        assert dry.state is State.CALIBRATING and blocking(dry) == [code] and CHECKS[code].cure in dry.session.why_not_armed()


def test_an_old_bias_does_not_count_and_stillness_renews_it(tmp_path):
    with disarmed(tmp_path) as dry:
        dry.until(lambda: dry.state is State.DISARMED)
        calibration = dry.session.calibration
        calibration.measured_s -= 700.0
        dry.bench.world.set("gyro_noise_rad_s", 0.3)  # not still
        dry.until(lambda: blocking(dry) == ["gyro_bias_old"], 3.0)
        dry.bench.world.set("gyro_noise_rad_s", 0.0014)
        dry.bench.world.parameters["gyro_bias_rad_s"] = (0.05, 0.0, 0.0)  # it has drifted
        dry.until(lambda: blocking(dry) == [], 4.0)
        assert dry.session.robot.gyro_bias_rad_s[0] == pytest.approx(0.05, abs=0.01)


def test_encoder_that_does_not_answer(tmp_path):
    with disarmed(tmp_path) as dry:
        dry.until(lambda: dry.state is State.DISARMED)
        encoder = dry.session.devices.encoders[1]
        null = os.open("/dev/null", os.O_RDONLY)
        kept = os.dup(encoder._fd)
        os.dup2(null, encoder._fd)
        dry.until(lambda: blocking(dry) == ["encoder_errors"], 1.0)
        assert "wheel 2" in dry.session.why_not_armed()
        os.dup2(kept, encoder._fd)
        os.close(kept)
        os.close(null)
        dry.until(lambda: blocking(dry) == [], 1.0)  # one that answers again is no reason any more


def test_wrong_rate(tmp_path):
    with disarmed(tmp_path) as dry:
        dry.until(lambda: dry.state is State.DISARMED)
        dry.session._rate_hz = lambda tick: 190.0
        dry.until(lambda: blocking(dry) == ["rate_wrong"], 1.0)
        dry.session._rate_hz = lambda tick: math.nan
        dry.until(lambda: blocking(dry) == ["rate_wrong"], 1.0)


@pytest.mark.parametrize(("strict", "blocks"), [("false", False), ("true", True)])
def test_refused_real_time_settings_warn_or_refuse(tmp_path, strict, blocks):
    with disarmed(tmp_path, realtime__strict=strict) as dry:
        dry.session.prearm.scheduling = Scheduling(warnings=["no SCHED_FIFO: allow it"])
        dry.until(lambda: dry.state is State.DISARMED)
        dry.until(lambda: dry.session.loop.ticks % 40 == 1)
        assert bool(blocking(dry)) is blocks
        assert any("no SCHED_FIFO: allow it" in refusal.sentence for refusal in dry.session.refusals)


def unit_file(bias, **changes):
    return json.dumps({"unit": "7", "measured_unix_s": time.time() - 3 * 86400, "gyro_bias_rad_s": bias, **changes})


@pytest.mark.parametrize(("text", "code"), [
    (None, None),
    (unit_file([0.01, -0.006, 0.004]), None),
    (unit_file([0.2, -0.006, 0.004]), "calibration_differs"),
    (unit_file([0.01, -0.006]), "calibration_invalid"),
    (unit_file([0.01, -0.006, math.nan]), "calibration_invalid"),
    (unit_file("abc"), "calibration_invalid"),
    ("[1, 2]", "calibration_invalid"),
    ("{", "calibration_invalid"),
])  # fmt: skip
def test_calibration_file_of_the_unit(tmp_path, monkeypatch, text, code):
    """No file: the bias measured at the start counts. A file: it must be whole, and agree."""

    def place_first(config, kernel):
        if text is not None:
            file = kernel.path("var/lib/mip-rt/calibration.json")
            file.parent.mkdir(parents=True)
            file.write_text(text)
        return apply_unit_file(config, kernel)

    monkeypatch.setattr(session, "apply_unit_file", place_first)
    with disarmed(tmp_path) as dry:
        dry.until(lambda: dry.state is State.DISARMED)
        dry.until(lambda: dry.session.loop.ticks % 40 == 1)
        assert blocking(dry) == ([code] if code else [])
        if code == "calibration_differs":
            assert "unit 7, 3 days old" in dry.session.why_not_armed()


def test_unreadable_calibration_file_is_refused(tmp_path):
    with pytest.raises(MipRtError, match="cannot be used"):
        load_unit_file(tmp_path)  # a folder


def test_gravity_must_be_down_and_not_up():
    """An accelerometer with the wrong sign is at every lean parallel to the right one."""
    for sign, wanted in ((-1.0, None), (1.0, "attitude_disagrees")):
        calibration = GyroCalibration(200.0)
        for _ in range(200):
            calibration.take(1.0, np.zeros(3), np.array([0.0, 0.0, 9.8 * sign]), np.zeros(3))
        assert (calibration.reason.code if calibration.reason else None) == wanted


# -- arming ---------------------------------------------------------------------------------------------------------------
def test_arming_gives_up_when_nobody_holds_the_robot_upright(tmp_path):
    """A press, then nothing: an hour later the robot must not start because somebody lifts it."""
    config = make_config(estimator__shadows="[]", dry_run__initial_lean_rad="[0.4, 0.0]", limits__arming_timeout_s="2.0")
    with DryRun(tmp_path, config) as dry:
        dry.until(lambda: dry.state is State.ARMING)
        assert "upright" in dry.session.why_not_armed()
        assert dry.until(lambda: dry.state is State.DISARMED, 3.0) == pytest.approx(2.0, abs=0.02)


def test_a_touched_stick_ends_arming(tmp_path):
    events = ({"at_s": 2.0, "press": "arm"}, {"at_s": 2.2, "speed_m_s": [0.2, 0.0]})
    with DryRun(tmp_path, scenario=script(*events)) as dry:
        dry.run(4.0)
        assert dry.state is State.DISARMED and [state for _, state, _ in dry.session.supervisor.events][-2:] == [State.ARMING, State.DISARMED]


def test_a_remote_that_comes_back_does_not_arm(tmp_path):
    with disarmed(tmp_path) as dry:
        dry.until(lambda: dry.state is State.DISARMED)
        operator = dry.bench.kernel.operator
        send, operator._send = operator._send, None
        dry.until(lambda: not dry.session.devices.remote.alive, 2.0)
        operator._send = send
        dry.until(lambda: dry.session.devices.remote.alive, 2.0)
        end = dry.session.loop.ticks + 400
        dry.until(lambda: dry.session.loop.ticks >= end, 3.0)
        assert dry.state is State.DISARMED


def test_soft_start_grows_the_command(tmp_path):
    with DryRun(tmp_path) as dry:
        dry.until(lambda: dry.state is State.BALANCING)
        dry.until(lambda: dry.session.supervisor.drive_scale >= 1.0, 1.0)
        rows = dry.session.ring.rows[: dry.session.loop.ticks]
        scale = rows["drive_scale"][(rows["request"] & 1) != 0]
        assert scale[0] == 0.0 and (np.diff(scale) <= 0.005 / 0.3 + 1e-9).all() and len(scale) >= 59


def test_the_status_line_says_each_second_why_the_robot_is_not_armed(tmp_path, monkeypatch):
    written, write = [], os.write
    with disarmed(tmp_path, dry_run__battery_v="6.2") as dry:
        monkeypatch.setattr(os, "write", lambda fd, data: written.append(data.decode()) if fd == 2 else write(fd, data))
        live = Live()
        live._terminal, live._every = False, 200
        for _ in range(900):
            if dry.session.loop.tick():
                dry.session._between_ticks(dry.session.loop.ticks - 1)
                live.update(dry.session)
        monkeypatch.undo()
    assert len(written) == 4 and "6.1" in written[-1] + written[-1].replace("6.2", "6.1")
    assert all("not armed:" in line for line in written[:1]) and "battery has" in written[-1] and "Charge it" in written[-1]


# -- the README -----------------------------------------------------------------------------------------------------------
def test_the_safety_section_of_the_readme_is_what_the_command_prints():
    from pathlib import Path

    text = (Path(__file__).parents[1] / "README.md").read_text()
    section = text.split(safety.BEGIN)[1].split(safety.END)[0]
    assert section.strip() == safety.markdown().strip(), "put the output of `mip-rt safety` between the markers"
