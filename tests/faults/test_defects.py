"""The defects of the two programs that went before, one test each, named after its number: B of the ancestor BallBalancer, L of librobotcontrol.

Each fails on the behaviour that its docstring describes.
"""

import ast
import errno
import io
import math
import os
import random
import threading
import tokenize
from pathlib import Path
from types import SimpleNamespace

import board
import numpy as np
import pytest
from helpers import DryRun, make_config

import mip_rt
from mip_rt import frame, realtime
from mip_rt.config import documentation
from mip_rt.config.scenario import Event, Scenario
from mip_rt.controllers import spin_down
from mip_rt.errors import HardwareError, ImuError
from mip_rt.fake.sysfs import FakeSysfs
from mip_rt.hardware import mpu9250_registers
from mip_rt.hardware.battery import Battery
from mip_rt.hardware.boards import BOARDS
from mip_rt.hardware.devices import open_devices
from mip_rt.hardware.encoders import Encoder
from mip_rt.log import open as open_log
from mip_rt.prearm import CHECKS, failing
from mip_rt.remote import fourjoy
from mip_rt.supervisor import State

PACKAGE = Path(mip_rt.__file__).parent
ROOT = PACKAGE.parent


def script(*events):
    return Scenario("test", "", 10.0, [Event(**event) for event in events])


def for_ticks(dry, count):
    end = dry.session.loop.ticks + count
    dry.until(lambda: dry.session.loop.ticks >= end, count * 0.01 + 1.0)


# -- the ancestor -------------------------------------------------------------------------------------------------------
def test_b1_the_last_command_of_a_lost_remote_does_not_stay(tmp_path):
    """The phone goes out of range while driving and spinning: the ancestor keeps the last command for ever."""
    events = ({"at_s": 2.0, "press": "arm"}, {"at_s": 3.0, "speed_m_s": [0.2, 0.0], "yaw_rate_hz": 1.0})
    with DryRun(tmp_path, scenario=script(*events)) as dry:
        dry.until(lambda: dry.session.loop.ticks >= 1000)
        assert dry.row["remote_yaw_rate_rad_s"] > 6.0 and dry.row["remote_velocity_m_s"].any()
        dry.bench.kernel.operator._send = None
        took = dry.until(lambda: not dry.row["remote_yaw_rate_rad_s"] and not dry.row["remote_velocity_m_s"].any(), 2.0)
        assert took <= 0.5 and dry.row["limits"] & frame.LIMIT_REMOTE_LOST


def test_b2_a_slipped_byte_does_not_kill_the_remote():
    """Blocks of seven bytes without looking for the frame: one lost byte and nothing fits any more."""
    for lost in range(7):
        decoder, one = fourjoy.FourJoyDecoder(), fourjoy.frame(0.5, 0.6)
        decoder.feed(one * 3)
        decoder.feed(one[:lost] + one[lost + 1 :])
        frames = decoder.frames
        decoder.feed(one * 4)
        assert decoder.frames > frames and decoder.locked and decoder.y == pytest.approx(0.6, abs=0.01)


def test_b3_axis_byte_128_is_the_negative_end():
    """The ancestor takes 128 for +1.008: the robot leaps the other way at the stick's end."""
    values = [fourjoy.axis(byte) for byte in [*range(128, 256), *range(128)]]
    assert values == sorted(values) and values[0] == -1.0 and max(values) == 1.0


@pytest.mark.parametrize("reading", [b"0\n", b"garbage\n", b"\n", b"564\n", b"4095\n"])
def test_b4_a_failed_battery_reading_is_no_divisor(balancing, reading):
    """0 V divides every command: full duty or NaN. Ours: the last good value for 2 s, then nominal."""
    for_ticks(balancing, 200)
    state = balancing.session.robot.state[0]
    good_v = float(state.battery_v)
    assert good_v != balancing.config.motor.nominal_voltage_v
    balancing.bench.kernel.motor_wiring.show_battery = lambda raw: None
    balancing.bench.kernel.sysfs.adc[balancing.config.battery.adc_channel].put(reading)
    balancing.until(lambda: balancing.row["limits"] & frame.LIMIT_BATTERY_UNKNOWN, 1.0)
    for_ticks(balancing, 300)
    assert float(state.battery_v) == pytest.approx(good_v, abs=0.1)
    for_ticks(balancing, 150)
    assert float(state.battery_v) == balancing.config.motor.nominal_voltage_v
    rows = balancing.session.ring.rows[: balancing.session.loop.ticks]
    assert np.isfinite(rows["duty"]).all() and abs(rows["duty"][-450:]).max() < 1.0 and balancing.state is State.BALANCING


def test_b5_arming_and_disarming_never_touch_the_filters_while_they_run(tmp_path):
    """Another thread presses the button again and again: requests take effect at a tick's edge, by the loop, or not at all."""
    with DryRun(tmp_path) as dry:
        dry.until(lambda: dry.state is State.BALANCING)
        stop, source = threading.Event(), random.Random(3)

        def storm():
            while not stop.wait(source.uniform(0.0, 0.002)):
                dry.session.supervisor.press()

        thread = threading.Thread(target=storm)
        thread.start()
        try:
            # How often the other thread gets its turn in so many ticks is the interpreter's choice.
            begun, most = dry.session.loop.ticks, dry.session.ring.capacity
            while dry.session.loop.ticks < (begun + 3000 if len(dry.session.supervisor.events) > 20 else most):
                if dry.session.loop.tick():
                    dry.session._between_ticks(dry.session.loop.ticks - 1)
        finally:
            stop.set()
            thread.join()
        rows = dry.session.ring.rows[: dry.session.loop.ticks]
        assert len(dry.session.supervisor.events) > 20
        assert np.isfinite(rows["estimates"]).all() and np.isfinite(rows["duty"]).all()
        engaged = rows["request"] & frame.REQUEST_ENGAGED != 0
        assert (rows["state"][engaged] == State.BALANCING).all() and not rows["applied_ns"][~engaged].any()
        fresh = np.flatnonzero(engaged[1:] & ~engaged[:-1]) + 1
        assert not rows["estimates"][fresh, 0, 8:].any()  # every start has its ball at rest at the origin


@pytest.mark.parametrize("sign", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
@pytest.mark.parametrize("which", [0, 3, 8])
def test_b6_losing_balance_is_judged_by_a_norm_and_nan_counts_as_lost(which, sign):
    """A root of a sum of products is NaN for some signs: the ancestor's test then never fires, or never clears."""
    p = np.zeros(1, spin_down.PARAMETERS).view(np.recarray)[0]
    spin_down.configure(p, (0.3, 9.0, 15.0), (0.075, 5.0, 2.5))
    s = np.zeros(1, spin_down.STATE).view(np.recarray)[0]
    limit = {0: 0.3, 3: 9.0, 8: 15.0}[which]
    error = np.zeros(10)
    for size, lost in ((0.99, False), (1.01, True)):
        error[which], error[which + 1] = (size * limit / math.sqrt(2.0) * part for part in sign)
        assert spin_down.step(p, s, True, error) is lost
    error[:] = 0.0
    assert spin_down.step(p, s, True, error) is False
    error[which] = math.nan
    assert spin_down.step(p, s, True, error) is True and spin_down.step(p, s, True, error) is True


def test_b7_the_log_holds_every_tick_at_every_moment(balancing):
    """The ancestor's writer is never ahead and is flushed at a clean exit only. Ours is read here without any exit, and SIGKILL is in tests/e2e."""
    for _ in range(5):
        for_ticks(balancing, 37)
        log = open_log(balancing.session.ring.path)
        assert len(log.frames) == balancing.session.loop.ticks and log.damage == []
        assert log.frames["tick"][-1] == balancing.session.loop.ticks - 1


def test_b8_balancing_does_not_depend_on_recording(tmp_path, monkeypatch):
    """The ancestor balances only while it records, and stops at five minutes. Ours arms and balances with a full disk, and says so."""
    monkeypatch.setattr(os, "statvfs", lambda path: SimpleNamespace(f_bavail=0, f_frsize=4096))
    with DryRun(tmp_path, make_config(estimator__shadows="[]", log__ring_s="5")) as dry:
        dry.run(9.0)  # longer than the ring
        assert dry.state is State.BALANCING
        assert "log_space" in [check.code for check in failing(int(dry.session.supervisor.refusals))]
        assert not CHECKS["log_space"].blocks


def test_b9_no_callback_does_not_mean_the_last_duty(balancing):
    """No interrupt, no tick, so the ancestor's motors keep what they have."""
    for_ticks(balancing, 100)
    balancing.bench.kernel.chip.sample = lambda packet, raw: False
    assert balancing.until(lambda: not balancing.motors_on(), 0.2) <= 0.050


def test_b10_no_inversion_hides_a_bad_condition(balancing):
    """A tolerance of 1e-50 lets singular matrices pass. Ours inverts no matrix in the tick, and a covariance that is not one is a fault."""
    for folder in ("models", "estimators", "controllers"):
        for path in (PACKAGE / folder).glob("*.py"):
            for function in (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)):
                if "njit" in "".join(ast.unparse(decorator) for decorator in function.decorator_list):  # the others run before the loop
                    called = {node.attr for node in ast.walk(function) if isinstance(node, ast.Attribute)}
                    assert not called & {"inv", "solve", "pinv", "lstsq"}, (path, function.name)
    for_ticks(balancing, 400)
    P = balancing.session.robot.estimator_states[0].filter.P[:13, :13]
    assert abs(P - P.T).max() <= 1e-12 * abs(P).max() and np.linalg.eigvalsh(P).min() > 0.0
    P[5, 5] = -10.0
    balancing.session.loop.tick()
    assert balancing.row["limits"] & frame.LIMIT_ESTIMATOR_RESET


def test_b11_real_time_scheduling_is_the_default_and_its_refusal_is_said(tmp_path, monkeypatch):
    """The ancestor's IMU thread runs at default priority and nobody knows."""
    config = make_config(estimator__shadows="[]")
    assert config.realtime.policy == "fifo" and config.realtime.lock_memory

    def refuse(*_):
        raise PermissionError(errno.EPERM, "injected")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    obtained = realtime.enter(config.realtime.policy, config.realtime.priority, False)
    realtime.leave()
    assert any("SCHED_FIFO" in warning and "rtprio" in warning for warning in obtained.warnings)
    for strict, code in (("false", "realtime_missing"), ("true", "realtime_required")):
        with DryRun(tmp_path, make_config(estimator__shadows="[]", realtime__strict=strict)) as dry:
            monkeypatch.setattr(realtime, "Scheduling", lambda **_: obtained)
            dry.run(4.0)
            monkeypatch.undo()
            assert code in [check.code for check in failing(int(dry.session.supervisor.refusals))]
            assert (dry.state is State.BALANCING) is (strict == "false")
        monkeypatch.setattr(os, "sched_setscheduler", refuse)


def commented_out_code(path):
    """Comment lines that are Python statements."""
    for token in tokenize.generate_tokens(io.StringIO(path.read_text()).readline):
        if token.type != tokenize.COMMENT or token.line.strip() != token.string:
            continue
        text = token.string.lstrip("#").strip()
        try:
            tree = ast.parse(text)
        except SyntaxError:
            continue
        if any(not isinstance(node, ast.Expr) or isinstance(node.value, ast.Call) for node in tree.body):
            yield f"{path.name}:{token.start[0]}: {text}"


def test_b12_no_commented_out_code_and_no_dead_parameters():
    """Two fifths of the ancestor's main files are dead: nobody can tell what is true."""
    assert [found for path in PACKAGE.rglob("*.py") for found in commented_out_code(path)] == []
    used = set()
    for path in PACKAGE.rglob("*.py"):
        if path.name != "schema.py":
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Attribute):
                    used.add(node.attr)
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    used.add(node.value)
    keys = {key.replace("[]", "").split(".")[-1] for key, _ in documentation.keys("mbbr") if "<name>" not in key and "process_noise." not in key}
    assert sorted(keys - used - {"protocol", "attitude"}) == []  # those two have one choice so far


# -- librobotcontrol ----------------------------------------------------------------------------------------------------
def test_l1_a_missing_interrupt_is_a_named_fault_in_every_state(tmp_path):
    """The library polls again and calls nobody."""
    for target in (State.DISARMED, State.ARMING, State.BALANCING):
        config = make_config(estimator__shadows="[]", **({"dry_run__initial_lean_rad": "[0.4, 0.0]"} if target is State.ARMING else {}))
        with DryRun(tmp_path, config) as dry:
            dry.until(lambda: dry.state is target)
            dry.bench.kernel.chip.sample = lambda packet, raw: False
            assert dry.until(lambda: dry.state is State.FAULT, 0.2) <= 0.050
            assert dry.session.supervisor.fault.code == "imu_silent" and not dry.motors_on()


def test_l2_failed_reads_are_counted_tolerated_and_then_a_fault(balancing):
    """The library skips the callback of a failed read, silently."""
    for_ticks(balancing, 100)
    imu, bus, left = balancing.session.devices.imu, balancing.bench.kernel.bus, [0]

    def refuse(messages):
        if left[0]:
            left[0] -= 1
            raise OSError(errno.EREMOTEIO, "injected")

    bus.before = refuse
    before, start = imu.counters["bus_errors"], balancing.session.loop.ticks
    left[0] = 4
    for_ticks(balancing, 20)
    rows = balancing.session.ring.rows[start : start + 20]
    assert imu.counters["bus_errors"] == before + 2 and np.count_nonzero(rows["limits"] & frame.LIMIT_IMU_MISSING) == 2
    assert balancing.state is State.BALANCING
    left[0] = 6
    balancing.until(lambda: balancing.state is State.FAULT, 0.05)
    assert balancing.session.supervisor.fault.code == "i2c_error"


def test_l3_of_a_backlog_the_newest_packet_counts(balancing):
    """With four or five packets waiting the library parses the third."""
    for_ticks(balancing, 50)
    balancing.bench.kernel.sleep(0.0251)
    balancing.session.loop.tick()
    assert balancing.row["imu_backlog"] == 4 and balancing.row["missed"] == 4
    assert bytes(balancing.row["imu_packet"]) == bytes(balancing.bench.world.packet)


def test_l4_defaults_are_real_time_and_warnings_reach_the_user(capsys):
    """The library's defaults are ordinary scheduling and no warnings."""
    from mip_rt.run import _print

    config = make_config()
    assert (config.realtime.policy, config.realtime.lock_memory) == ("fifo", True) and 0 < config.realtime.priority < 50
    scheduling = realtime.Scheduling(warnings=["asked for much, got little: do this"])
    with pytest.raises(KeyError):  # the summary itself is not of interest here
        _print({"scheduling": scheduling.summary()}, SimpleNamespace(scheduling=scheduling), False)
    assert "warning: asked for much" in capsys.readouterr().out


@pytest.mark.parametrize("encoder", ["counter", "tieqep"])
@pytest.mark.parametrize("naming", ["pwmchipK/pwmN", "pwm-K:N"])
@pytest.mark.parametrize("abi", [1, 2])
def test_l5_three_generations_of_kernels_are_probed(tmp_path, encoder, naming, abi):
    """The library's paths are those of one vendor kernel."""
    pins = BOARDS["beaglebone-black-cape"]
    kernel = board.Kernel(tmp_path, abi, encoder_interface=encoder, pwm_naming=naming)
    Encoder(kernel, pins.encoders[0]).start()
    motors = board.started_motors(kernel)
    assert motors.enable() and board.write(motors, 1000, 2000, -3000) and kernel.sysfs.duty_ns(*pins.motors[3].pwm) == 2000


def test_l6_a_missing_device_is_named_with_a_cure_and_unused_ones_are_not_opened(tmp_path):
    """The library opens all encoders, used or not, and leaves with the kernel's error number."""
    pins, config = BOARDS["beaglebone-black-cape"], make_config()
    with pytest.raises(HardwareError) as caught:
        open_devices(SimpleNamespace(path=lambda *parts: tmp_path.joinpath(*parts)), config, SimpleNamespace(wait_ready=lambda: None), None)
    assert caught.value.code != "error" and caught.value.sentence and caught.value.cure
    FakeSysfs(tmp_path, pins)
    for entry in (tmp_path / "sys/bus/counter/devices").iterdir():
        if pins.encoders[2] in os.path.realpath(entry):
            entry.unlink()
    kernel = SimpleNamespace(path=lambda *parts: tmp_path.joinpath(*parts))
    for channel in (1, 2):
        Encoder(kernel, pins.encoders[channel - 1]).start()
    with pytest.raises(HardwareError, match=pins.encoders[2]) as caught:
        Encoder(kernel, pins.encoders[2])
    assert caught.value.cure


def test_l7_the_magnetometer_is_left_alone(tmp_path):
    """A magnetometer behind the IMU's bypass breaks silently; nothing here talks to any chip but the IMU."""
    with DryRun(tmp_path) as dry:
        seen = set()
        dry.bench.kernel.bus.before = lambda messages: seen.update(message.addr for message in messages)
        dry.session.devices.imu.start()
        dry.run(3.0)
        assert seen == {dry.config.imu.address}


def test_l8_the_service_restarts_is_watched_and_is_not_root():
    """The library's unit has no Restart, no watchdog, and runs as root."""
    text = (ROOT / "systemd/mip-rt.service").read_text()
    lines = dict(line.split("=", 1) for line in text.splitlines() if "=" in line and not line.startswith("#"))
    assert lines["Restart"] in ("on-failure", "always") and lines["WatchdogSec"] and lines["Type"] == "notify"
    assert lines.get("User", "root") != "root" and lines["NoNewPrivileges"] in ("yes", "true")


def test_l9_every_run_leaves_a_log(tmp_path):
    """rc_balance has no log at all."""
    with DryRun(tmp_path) as dry:
        report = dry.run(1.0)
    log = open_log(report["log"])
    assert len(log.frames) == report["ticks"] > 100 and "body_mass_kg" in log.config


@pytest.mark.parametrize("identity", [0x70, 0x71, 0x73, 0x74, 0x75, 75])
def test_l10_the_chips_identity_is_a_table_of_names(tmp_path, identity):
    """The library compares with decimal 75 where 0x75 is meant. What ours accepts and refuses is what its table says, by name."""
    with DryRun(tmp_path) as dry:
        imu, chip = dry.session.devices.imu, dry.bench.kernel.chip
        chip._identity = identity
        name, usable = mpu9250_registers.CHIPS.get(identity, ("an unknown chip", False))
        if usable:
            imu.start()
            assert imu.chip == name
        else:
            with pytest.raises(ImuError) as caught:
                imu.start()
            assert name in caught.value.sentence and f"0x{identity:02x}" in caught.value.sentence and caught.value.cure
        assert (75 in mpu9250_registers.CHIPS) is False and usable is (identity in (0x70, 0x71, 0x73))


@pytest.mark.parametrize("raw", [0, 1, 200])
def test_l11_an_unconnected_battery_is_no_voltage(tmp_path, raw):
    """The library answers exactly 0.0 below 1 V. Ours: no reading, which arms nothing and divides nothing."""
    sysfs = FakeSysfs(tmp_path, BOARDS["beaglebone-black-cape"])
    config = make_config(estimator__shadows="[]")
    sysfs.set_adc(config.battery.adc_channel, raw)
    battery = Battery(SimpleNamespace(path=lambda *parts: tmp_path.joinpath(*parts)), config.battery)
    assert math.isnan(battery.read()) and battery.errors == 1
    with DryRun(tmp_path / "run", config) as dry:
        dry.bench.kernel.motor_wiring.show_battery = lambda _: dry.bench.kernel.sysfs.set_adc(config.battery.adc_channel, raw)
        dry.run(4.0)
        assert dry.state is State.DISARMED and "battery_unknown" in [refusal.code for refusal in dry.session.refusals]
