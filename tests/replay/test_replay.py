"""A log replays bit for bit, an edited one does not, and the replay says where."""

import errno
import json
import time
from dataclasses import replace

import numpy as np
import pytest
from helpers import DryRun, make_config

from shipped_logs import scenarios_of

from mip_rt import cli, compiled, robots
from mip_rt import log as logs
from mip_rt.config import scenario as scenarios
from mip_rt.errors import LogError
from mip_rt.frame import LIMITS, LOOP_LIMITS
from mip_rt.log import ring_format
from mip_rt.log.comparison import Comparison
from mip_rt.log.replay import replay
from mip_rt.log.rerun import Rerun
from mip_rt.log.ring import STATE_EVERY
from mip_rt.robots.mbbr_frame import LAYOUT
from mip_rt.supervisor import State


def recorded(folder, scenario="hold", duration_s=None, **overrides):
    """Path of the log of a dry run."""
    with DryRun(folder, make_config(**overrides), scenario) as dry:
        return dry.run(duration_s or scenarios.load(scenario).duration_s)["log"]


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A log of 5 s, 2.5 of them balancing, from tick 0."""
    return recorded(tmp_path_factory.mktemp("short"), "hold", 5.0)


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    """A log whose ring of 4 s has turned: it begins in the middle of a run."""
    return recorded(tmp_path_factory.mktemp("turned"), "spin-1.0", 12.3, log__ring_s="4")


def flipped(path, folder, tick, field, byte, bit):
    """A copy of a log in which one bit of one field of one tick is the other way round."""
    data = bytearray(open(path, "rb").read())
    geometry, _ = ring_format.unpack_header(data)
    at = geometry.rows_at + tick % geometry.rows * geometry.row_bytes + LAYOUT.offset[field] + byte
    data[at] ^= 1 << bit
    (folder / "flipped.ring").write_bytes(data)
    return folder / "flipped.ring"


@pytest.mark.parametrize(("robot", "scenario"), [(robot, scenario) for robot in robots.NAMES for scenario in scenarios_of(robot)])
def test_every_shipped_scenario_replays_bit_for_bit(tmp_path, robot, scenario):
    """Anything that the step depends on and the log lacks shows here."""
    path = recorded(tmp_path, scenario, min(22.0, scenarios.load(scenario).duration_s), robot=robot, log__ring_s="23")
    log = logs.open(path)
    rerun, comparison = replay(log)
    assert not rerun.other_machine and not rerun.other_sources and log.damage == []
    assert comparison.equal and comparison.exact and comparison.rows == len(log.frames) and log.frames["tick"][0] == 0
    assert len(log.states) == len(log.frames) // STATE_EVERY and rerun.states == log.states


@pytest.mark.parametrize("ring_s", ["30", "2"])
def test_a_run_with_faults_replays(tmp_path, ring_s):
    """Lost packets, silence, a jumping encoder, no battery reading, fall and another start: every way through the step is a function
    of the inputs and the state, also where the ring has turned and its rows held older numbers."""
    with DryRun(tmp_path, make_config(log__ring_s=ring_s)) as dry:
        kernel, supervisor = dry.bench.kernel, dry.session.supervisor
        wiring, chip, left = kernel.motor_wiring, kernel.chip, [2]
        show_encoders, sample = wiring.show_encoders, chip.sample

        def refuse_twice(messages):
            if left[0]:
                left[0] -= 1
                raise OSError(errno.EREMOTEIO, "injected")

        def ticks(count):
            end = dry.session.loop.ticks + count
            dry.until(lambda: dry.session.loop.ticks >= end)

        dry.until(lambda: dry.state is State.BALANCING)
        ticks(100)
        kernel.bus.before = refuse_twice
        ticks(50)
        wiring.show_encoders = lambda counts: show_encoders(counts + [0, 5000, 0])
        ticks(50)
        wiring.show_encoders = show_encoders
        wiring.show_battery = lambda raw: None
        kernel.sysfs.adc[dry.config.battery.adc_channel].put(b"garbage\n")
        ticks(120)
        del wiring.show_battery
        chip.sample = lambda packet, raw: False  # the interrupt line is dead for a while
        dry.until(lambda: dry.state is State.FAULT, 1.0)
        chip.sample = sample
        dry.bench.world.hold()
        ticks(100)
        for wanted in (State.DISARMED, State.BALANCING):
            supervisor.press()
            dry.until(lambda: dry.state is wanted, 3.0)
        ticks(150)
        dry.session.ring.close()
        log = logs.open(dry.session.ring.path)
    limits = np.bitwise_or.reduce(log.frames["limits"])
    assert ring_s == "2" or all(limits & LIMITS[name] for name in ("imu_missing", "encoder_jump", "battery_unknown"))
    rerun, comparison = replay(log)
    assert comparison.equal and comparison.rows == len(log.frames) - rerun.skipped and rerun.skipped < STATE_EVERY


@pytest.mark.timing
def test_replay_is_50_times_faster_than_the_run(tmp_path):
    """A replay of an hour must not take an hour. Processor time: the machine may be busy with other things."""
    log = logs.open(recorded(tmp_path, "hold", 60.0, log__ring_s="60"))
    times = []
    for _ in range(3):
        begin = time.process_time()
        replay(log)
        times.append(time.process_time() - begin)
    print(f"60 s replayed in {min(times):.3f} s: {60.0 / min(times):.0f} times real time")
    assert min(times) < 60.0 / 50.0


def test_a_log_that_begins_in_the_middle_resumes_at_its_first_state_row(turned):
    """Without state rows, a ring that has turned could never be replayed."""
    log = logs.open(turned)
    rerun, comparison = replay(log)
    first = min(tick for tick in log.states if tick >= log.frames["tick"][0] - 1)
    assert log.frames["tick"][0] > 0 and comparison.equal
    assert int(log.frames["tick"][rerun.spans[0].begin]) == first + 1
    assert rerun.skipped == first + 1 - log.frames["tick"][0] < STATE_EVERY
    assert comparison.rows == len(log.frames) - rerun.skipped


def test_replay_goes_on_after_missing_ticks(short):
    """Rows that a recorder dropped end one stretch; the next begins at a state row, not with a wrong history."""
    log = logs.open(short)
    missing = log.frames["tick"]
    missing = (missing >= 450) & (missing < 470) | (missing == 700)
    rerun, comparison = replay(replace(log, frames=log.frames[~missing]))
    assert [int(rerun.log.frames["tick"][span.begin]) for span in rerun.spans] == [0, 600, 800]
    assert comparison.equal and rerun.skipped == 130 + 99 and comparison.rows == 1000 - 21 - rerun.skipped


def test_a_state_row_that_differs_is_found(short):
    """The state is asserted, too: it is what later ticks come from."""
    log = logs.open(short)
    kept = bytearray(log.states[599])
    kept[100] ^= 1
    _, comparison = replay(replace(log, states={**log.states, 599: bytes(kept)}))
    assert not comparison.equal and comparison.state_ticks == [599]


SENSOR_BYTES = [("imu_packet", byte) for byte in (0, 3, 7, 11, 15, 17, 19, 21, 23, 25, 27)] + [
    ("encoder_count", 0), ("encoder_count", 8), ("encoder_count", 16), ("battery_v", 6), ("gyro_bias_rad_s", 7),
    ("gyro_rad_s", 0), ("acceleration_m_s2", 8), ("quaternion", 24), ("attitude_rad", 16), ("wheel_angle_rad", 0), ("wheel_rate_rad_s", 8),
]  # fmt: skip


@pytest.mark.parametrize(("field", "byte"), SENSOR_BYTES)
def test_one_flipped_bit_of_a_sensor_is_named(short, tmp_path, capsys, field, byte):
    """An edited or damaged log must never pass as what happened."""
    path = flipped(short, tmp_path, 777, field, byte, 0)
    assert cli.main(["replay", str(path), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    first = report["first_difference"]
    assert not report["equal"] and first["tick"] == 777 and first["time_s"] == pytest.approx(777 * 0.005)
    if field in LAYOUT.step_outputs:
        assert first["field"].startswith(field)
    assert cli.main(["replay", str(path)]) == 1
    assert f"NOT EQUAL bit for bit: first at tick 777 (3.885 s) in {first['field']}" in capsys.readouterr().out


def test_a_flipped_bit_of_any_output_is_named(short):
    """Whatever field, tick and bit: 2,000 random ones, each found where it is."""
    log, random = logs.open(short), np.random.default_rng(4)
    ((recorded_rows, replayed_rows, _, counted),) = Rerun(log).batches()
    assert counted == len(log.frames)
    for _ in range(2000):
        row, name = int(random.integers(1, counted - 1)), str(random.choice(LAYOUT.step_outputs))
        edited = recorded_rows[row - 1 : row + 2].copy()
        raw = edited[name][1:2].view(np.uint64).reshape(-1)
        column, bit = int(random.integers(raw.size)), int(random.integers(64))
        if name == "limits" and 1 << bit & LOOP_LIMITS:
            continue
        raw[column] ^= np.uint64(1 << bit)
        comparison = Comparison(log.frames, [name], True)
        comparison.take(edited, replayed_rows[row - 1 : row + 2])
        assert (comparison.first.tick, comparison.first.field, comparison.first.column) == (row, name, column)


def test_limits_that_the_loop_adds_do_not_count(short):
    """remote_lost is the loop's: the step does not know the remote."""
    log = logs.open(short)
    frames = log.frames.copy()
    frames["limits"] ^= 1 << 11
    assert replay(replace(log, frames=frames))[1].equal


@pytest.fixture
def elsewhere(monkeypatch):
    """This program on a machine of another type."""
    here = compiled.machine_type()
    monkeypatch.setattr(compiled, "machine_type", lambda: {**here, "cpu": "another"})


def test_another_type_of_machine_compares_to_1e_9_of_each_column(turned, elsewhere):
    """Rounding of another processor must pass, anything larger must not."""
    log = logs.open(turned)
    rerun, comparison = replay(log)
    assert rerun.other_machine.keys() == {"cpu"} and rerun.recorded_command and not comparison.exact and comparison.equal
    scale = np.abs(log.frames["duty"]).max()
    for relative, equal in ((3e-10, True), (3e-9, False)):
        frames = log.frames.copy()
        frames["duty"][500, 0] += relative * scale
        comparison = replay(replace(log, frames=frames))[1]
        assert comparison.equal is equal
        assert equal or (comparison.first.field, comparison.first.tick) == ("duty", frames["tick"][500])
    for pulse, equal in ((1, True), (2, False)):
        frames = log.frames.copy()
        frames["duty_ns"][500, 0] += pulse
        assert replay(replace(log, frames=frames))[1].equal is equal
    for value in (np.nan, np.inf):
        frames = log.frames.copy()
        frames["duty"][500, 0] = value
        assert not replay(replace(log, frames=frames))[1].equal


def test_other_sources_are_told_and_still_asserted(short, monkeypatch, capsys):
    """A change of code is the usual reason for a difference: the user must be told, and equality still holds or not."""
    monkeypatch.setattr(compiled, "source_hash", lambda: "0123456789abcdef")
    assert cli.main(["replay", short]) == 0
    output = capsys.readouterr().out
    assert "recorded by other sources" in output and "equal bit for bit" in output


def test_from_and_to(short, capsys):
    """Times are those of mip-rt log: seconds since the loop's first tick."""
    assert cli.main(["replay", short, "--from", "3.5", "--to", "t900", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["first_tick"], report["last_tick"], report["ticks"], report["resumed_at"]) == (700, 899, 200, [600])
    for wrong, code in (("x", 2), ("t5000", 3), ("nan", 2)):
        assert cli.main(["replay", short, "--from", wrong]) == code


def test_force_shows_differences_and_asserts_nothing(short, tmp_path, capsys):
    """Changed code is tried on an old log: what changed, and how much."""
    path = flipped(short, tmp_path, 777, "wheel_rate_rad_s", 6, 3)
    assert cli.main(["replay", str(path), "--force"]) == 0
    output = capsys.readouterr().out
    assert "first difference at tick 777" in output and "wheel_rate_rad_s" in output and "NOT" not in output


def test_a_shadow_changes_nothing_of_the_others(turned, capsys):
    """What would it have seen: an estimator is added after the fact, from the middle of a run, and the log's own stay what they were."""
    assert cli.main(["replay", turned, *(f"--shadow={name}" for name in ("kf", "ekf_printed", "ekf")), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["estimators"] == ["dmp_ekf", "kf", "ekf_printed", "ekf"] and not report["asserted"]
    assert set(report["fields"]) == {"estimates", "estimator_flags"}
    assert cli.main(["replay", turned, "--shadow=ekf_printed", "--compare"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("estimates")]
    assert lines and all(line.startswith("estimates[ekf_printed]") for line in lines)


def test_what_would_another_estimator_or_gain_have_asked_for(short, tmp_path, capsys):
    """Open loop on the recorded command: estimates of the log's filters are the same, the commands differ."""
    assert cli.main(["replay", short, "--estimator", "ekf", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["estimators"] == ["ekf", "dmp_ekf", "kf", "dmp_kf"]
    assert "command_feedback" in report["fields"] and "estimates" not in report["fields"]
    assert cli.main(["replay", short, "--set", "friction.compensation=false", "--json"]) == 0
    fields = json.loads(capsys.readouterr().out)["fields"]
    assert "command_friction" in fields and "command_feedback" not in fields and "estimates" not in fields
    (tmp_path / "mine.yaml").write_text(make_config(friction__compensation="false").to_yaml())
    assert cli.main(["replay", short, "--config", str(tmp_path / "mine.yaml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fields"].keys() == fields.keys()
    assert cli.main(["replay", short, "--estimator", "nonsense"]) == 2


def test_plot(short, tmp_path):
    """The page exists, is an image, and a name that matplotlib does not know is refused."""
    pytest.importorskip("matplotlib")
    assert cli.main(["replay", short, "--shadow", "ekf_printed", "--plot", str(tmp_path / "a.png")]) == 0
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert cli.main(["replay", short, "--plot", str(tmp_path / "a.nonsense")]) == 3


def test_logs_that_cannot_be_replayed_are_refused(turned, capsys):
    """Nothing replayed must never read as equal."""
    log = logs.open(turned)
    with pytest.raises(LogError, match="neither tick 0 nor a state row"):
        replay(replace(log, states={}))
    with pytest.raises(LogError, match="neither tick 0 nor a state row that fits this program"):
        replay(replace(log, header={**log.header, "state_layout": "other"}))
    with pytest.raises(LogError, match="no complete tick"):
        replay(replace(log, frames=log.frames[:0]))
    wider = np.dtype([(name, "<f8", (4,)) if name == "duty" else (name, log.frames.dtype[name]) for name in log.frames.dtype.names])
    with pytest.raises(LogError, match="field duty"):
        replay(replace(log, frames=np.zeros(3, wider)))
    assert cli.main(["replay", "/nowhere.ring"]) == 3
    capsys.readouterr()


def test_a_forced_replay_starts_afresh_where_no_state_row_fits(turned):
    """Changed code often changes the state: the log is still of use."""
    log = logs.open(turned)
    rerun = Rerun(replace(log, header={**log.header, "state_layout": "other"}), asserted=False)
    comparison = Comparison(log.frames, rerun.outputs, True)
    for recorded_rows, replayed_rows, _, counted in rerun.batches():
        comparison.take(recorded_rows[-counted:], replayed_rows[-counted:])
    assert rerun.cold_ticks == [log.frames["tick"][0]] and rerun.skipped == 0 and comparison.rows == len(log.frames)


def test_an_input_that_an_older_log_lacks_is_taken_as_zero_and_told(short):
    """A new input field must not make every older log useless: whether it matters, the comparison tells."""
    log = logs.open(short)
    names = [name for name in log.frames.dtype.names if name != "imu_backlog"]
    rerun, comparison = replay(replace(log, frames=log.frames[names]))
    assert rerun.missing == ["imu_backlog"] and comparison.equal
    names = [name for name in log.frames.dtype.names if name != "drive_scale"]
    assert not replay(replace(log, frames=log.frames[names]))[1].equal


@pytest.mark.timing
def test_keeping_the_state_costs_microseconds(tmp_path):
    """Once a second, and still so little that no tick is late for it."""
    with DryRun(tmp_path) as dry:
        ring, parts = dry.session.ring, dry.session.robot.persistence.parts
        times = []
        for tick in range(2000):
            begin = time.perf_counter_ns()
            ring.keep_state(tick, parts)
            times.append(time.perf_counter_ns() - begin)
    print(f"keeping {sum(map(len, parts))} bytes: median {np.median(times) / 1000:.2f} us, once in {STATE_EVERY} ticks")
    assert np.median(times) < 20_000
