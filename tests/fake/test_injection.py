"""Faults of scenarios: what is promised of each, that they repeat by seed, and that they leave nothing behind."""

import importlib
import random
import time

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt.config import scenario as scenarios
from mip_rt.config.scenario import Event, Scenario
from mip_rt.errors import ConfigError
from mip_rt.fake.faults import ANY, FAULTS, OFF, RIDES, ZERO, defaults, documentation, drawn
from mip_rt.lab import soak_run
from mip_rt.lab.promises import broken

BEGIN_S = 4.2
IN_PROCESS = [name for name, kind in FAULTS.items() if kind.weight]
# Without the DMP there is neither FIFO nor quaternion; what else befalls the IMU must end as it does with it.
ONBOARD = [name for name in IN_PROCESS if FAULTS[name].module == "faults_imu" and name not in
           ("fifo_overflow", "fifo_misaligned", "quaternion_zero", "attitude_jump")]  # fmt: skip
CASES = [(name, "dmp") for name in IN_PROCESS] + [(name, "onboard") for name in ONBOARD]


def script(*faults, end_s=9.0):
    events = [Event(2.0, press="arm"), Event(3.3, 0.5, [0.1, 0.0])]
    events += [Event(at_s, fault=name, parameters=parameters) for at_s, name, parameters in faults]
    return Scenario("test", "", end_s, events)


@pytest.mark.parametrize(("name", "attitude"), CASES)
def test_each_fault_keeps_its_promise(name, attitude, tmp_path):
    """A fault whose reaction is missing, late, or exaggerated; and a general promise that it breaks."""
    kind, config = FAULTS[name], soak_run.configured({"imu.attitude": attitude})
    path = tmp_path / "config.yaml"
    path.write_text(config.to_yaml())
    seen, unclean = soak_run.observe(config, script((BEGIN_S, name, {})), 3, 6.7, path)
    assert unclean == [] and broken(seen, config) == []
    (reaction,) = soak_run.reactions(seen)
    assert reaction.armed and seen.injections[0][3] > 0 or name == "disk_full"  # it struck
    if kind.promise == OFF:
        assert reaction.off_s is not None and reaction.off_s <= kind.bound_s + 1e-9
    elif kind.promise == ZERO:
        assert reaction.zero_s <= kind.bound_s and reaction.off_s is None
    elif kind.promise == RIDES:
        assert reaction.off_s is None and not reaction.fell
    else:
        assert kind.promise == ANY


@pytest.mark.parametrize("text", ["word", "empty", "huge", "negative", "binary"])
def test_a_count_that_is_no_number_is_an_error_and_the_file_recovers(tmp_path, text):
    """An empty file has no memory behind its mapping: the fake once died of writing the next count there."""
    with DryRun(tmp_path, scenario=script((BEGIN_S, "encoder_garbage", {"wheel": 2, "text": text, "for_s": 0.05}))) as dry:
        encoder, counters = dry.session.devices.encoders[1], dry.session.devices.counters
        dry.until(lambda: dry.bench.injector.journal, 6.0)
        dry.run(0.2)
        assert (encoder.errors > 0) == (text != "negative") and not encoder.failing
        assert int(counters["raw"][0, 1]) == int(dry.bench.world.counts[1]) % (1 << 32)


def test_every_fault_is_implemented_and_its_draws_are_valid():
    source = random.Random(5)
    for name, kind in FAULTS.items():
        assert callable(getattr(importlib.import_module(f"mip_rt.fake.{kind.module}"), name))
        for parameters in (defaults(name), *(drawn(name, source) for _ in range(20))):
            whole = Scenario("t", "", 1.0, [Event(0.5, fault=name, parameters=parameters)])
            assert scenarios.loads(whole.to_yaml()).events[0].as_dict() == whole.events[0].as_dict()
        assert f"`{name}`" in documentation()


@pytest.mark.parametrize("line, words", [
    ("{at_s: 1, fault: i2c_nak}", "did you mean 'i2c_nack'?"),
    ("{at_s: 1, fault: i2c_nack, probabilty: 0.5}", "did you mean 'probability'?"),
    ("{at_s: 1, fault: i2c_nack, probability: 1.5}", "at most 1"),
    ("{at_s: 1, fault: encoder_stuck, wheel: 4}", "from 1 to 3"),
    ("{at_s: 1, probability: 0.5}", "no such key"),
])  # fmt: skip
def test_a_wrong_fault_is_refused_with_file_and_line(line, words):
    with pytest.raises(ConfigError) as caught:
        scenarios.loads(f"events:\n  - {line}\n", "mine.yaml")
    assert words in str(caught.value) and "mine.yaml:2" in str(caught.value)


def test_units_are_taken():
    (event,) = scenarios.loads("events:\n  - {at_s: 1, fault: i2c_nack, for_s: 30 ms}\n").events
    assert event.parameters == {"for_s": 0.03}


def test_same_seed_same_faults(tmp_path):
    """A campaign's broken run that cannot be replayed."""
    faults = [(4.0, "i2c_bit_flips", {"probability": 0.2}), (5.0, "serial_garbage", {"probability": 0.5}), (6.0, "packet_noise", {"probability": 0.1})]
    logs = []
    for number, seed in enumerate((4, 4, 5)):
        with DryRun(tmp_path / str(number), scenario=script(*faults), seed=seed) as dry:
            dry.run(7.5)
            logs.append(dry.session.ring.rows.tobytes())
    assert logs[0] == logs[1] and logs[0] != logs[2]


def test_a_fault_does_not_change_the_worlds_noise(tmp_path):
    """Faults that draw from the world's generator would make every comparison with and without them worthless."""
    truths = []
    for number, faults in enumerate(([], [(2.5, "serial_split", {"for_s": 0.5}), (3.0, "clock_step", {}), (3.5, "interrupt_late", {"delay_s": 0.0})])):
        with DryRun(tmp_path / str(number), scenario=script(*faults)) as dry:
            dry.run(5.0)
            truths.append(dry.bench.world.truth_rows[:900].tobytes())
    assert truths[0] == truths[1]


def test_nothing_remains_of_faults_that_are_over(tmp_path):
    """A filter that stays would slow every later tick, or strike on."""
    lasting = [name for name in IN_PROCESS if FAULTS[name].lasts and FAULTS[name].promise == RIDES and name != "config_changed"]
    faults = [(4.0 + 0.1 * i, name, {"for_s": 0.05}) for i, name in enumerate(lasting)]
    real_time, real_time_ns = time.time, time.time_ns
    with DryRun(tmp_path, scenario=script(*faults)) as dry:
        kernel = dry.bench.kernel
        targets = (kernel, kernel.bus, kernel.chip, kernel.gpio, kernel.motor_wiring, dry.bench.remote)
        before = [dict(vars(target)).keys() for target in targets]
        dry.run(4.5 + 0.1 * len(lasting))
        assert len(dry.bench.injector.journal) == len(lasting)
        assert [dict(vars(target)).keys() for target in targets] == before
        assert (time.time, time.time_ns) == (real_time, real_time_ns) and not dry.bench.injector.taps._chains


def test_a_configuration_of_ours_is_never_overwritten(tmp_path):
    with DryRun(tmp_path, scenario=script((3.0, "config_changed", {}))) as dry, pytest.raises(ConfigError, match="--config"):
        dry.run(4.0)


def test_a_changed_configuration_file_has_no_effect_and_is_restored(tmp_path):
    config = soak_run.configured({})
    path = tmp_path / "config.yaml"
    path.write_text(config.to_yaml())
    frames = []
    for faults in ([], [(3.0, "config_changed", {"for_s": 2.0}), (3.5, "config_changed", {"for_s": 2.5})]):
        seen, _ = soak_run.observe(config, script(*faults), 1, 7.0, path)
        frames.append(seen.rows["duty"].tobytes())
        assert path.read_text() == config.to_yaml()
    assert frames[0] == frames[1]


def test_a_recovering_operator_acknowledges_lifts_and_arms(tmp_path):
    config = make_config(estimator__shadows="[]")
    events = [Event(2.0, press="arm"), Event(4.0, fault="tipped_over", parameters={}), Event(5.0, press="recover")]
    with DryRun(tmp_path, config=config, scenario=Scenario("t", "", 9.0, events)) as dry:
        dry.until(lambda: dry.state.name == "FAULT", 6.0)
        dry.until(lambda: dry.motors_on(), 6.0)
        assert np.abs(dry.row["attitude_rad"][:2]).max() < 0.2


def test_the_death_of_the_guard_switches_off(tmp_path):
    with DryRun(tmp_path, scenario=script((4.0, "child_killed", {"name": "guard"}))) as dry:
        dry.until(lambda: dry.motors_on(), 4.0)
        dry.until(lambda: dry.bench.injector.journal, 4.0)
        assert dry.until(lambda: not dry.motors_on(), 0.2) <= 0.1


@pytest.mark.slow
def test_stalls_are_real_in_real_time(tmp_path):
    """In real time a stalled loop is really kept from running."""
    from mip_rt.fake import bench as fake_bench

    bench = fake_bench.build(make_config(), scenarios.load("hold"), 1, True)
    begin = time.monotonic()
    bench.injector.stall(0.1)
    assert 0.1 <= time.monotonic() - begin
    assert bench.world.samples >= 19
    bench.close()


@pytest.mark.slow
def test_a_machine_too_slow_for_the_world_can_still_be_stopped():
    """Prevents a dry run that hangs in its own world, because each of its samples takes longer than 5 ms: the wait must come back."""
    from mip_rt.fake import bench as fake_bench
    from mip_rt.fake.kernel import CATCH_UP_S
    from mip_rt.hardware.devices import open_devices

    config = make_config()
    bench = fake_bench.build(config, scenarios.load("hold"), 1, True)
    bench.kernel.power_on()
    devices = open_devices(bench.kernel, config, bench.guard, None, (bench.image_path, bench.image_sha256))
    advance = bench.world.advance

    def slowly(duty, enabled):
        time.sleep(0.01)
        advance(duty, enabled)

    bench.world.advance = slowly
    for _ in range(3):
        begin = time.monotonic()
        while devices.imu_line.read() is not None:
            pass
        assert bench.kernel.wait_readable(devices.imu_line.fd, 0.03)
        assert time.monotonic() - begin < CATCH_UP_S + 0.1
    assert bench.kernel._next_ns < time.monotonic_ns() - 100_000_000  # it had fallen behind by more
    devices.close()
    bench.close()


@pytest.mark.slow
def test_what_a_long_pause_has_missed_is_made_up_for_in_one_wait():
    """Prevents ticks that are late for seconds after the memory was locked, because each wait brought only some of the edges."""
    from mip_rt.fake import bench as fake_bench
    from mip_rt.hardware.devices import open_devices

    config = make_config()
    bench = fake_bench.build(config, scenarios.load("hold"), 1, True)
    bench.kernel.power_on()
    devices = open_devices(bench.kernel, config, bench.guard, None, (bench.image_path, bench.image_sha256))
    time.sleep(1.2)
    assert bench.kernel.wait_readable(devices.imu_line.fd, 0.03)
    while devices.imu_line.read() is not None:
        pass
    assert bench.kernel._next_ns > time.monotonic_ns() - 20_000_000
    devices.close()
    bench.close()


@pytest.mark.parametrize("names", [("serial_split", "serial_bits"), ("serial_bits", "serial_split")])
def test_bits_of_split_frames_are_flipped(tmp_path, names):
    """A split frame may be empty."""
    both = [(3.0 + 0.01 * i, name, {"for_s": 2.0} if name == "serial_split" else {"for_s": 2.0, "probability": 1.0}) for i, name in enumerate(names)]
    with DryRun(tmp_path, scenario=script(*both)) as dry:
        dry.run(6.0)
        assert [entry.name for entry in dry.bench.injector.journal] == list(names)
