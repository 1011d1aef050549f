"""The unit, its user, and the shell script that switches the motors off after every stop."""

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mip_rt.config.schema import MBBR
from mip_rt.fake.sysfs import FakeSysfs
from mip_rt.guard_client import PRIORITY_ABOVE_LOOP
from mip_rt.hardware.boards import BOARDS, GPIO

FOLDER = Path(__file__).parents[2] / "systemd"
UNIT = FOLDER / "mip-rt.service"
MOTORS_OFF = FOLDER / "motors-off"
needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed: the unit is not verified here (apt install systemd)"
)


def analyze(*arguments):
    return subprocess.run(["systemd-analyze", "--no-pager", *map(str, arguments)], capture_output=True, text=True, check=False)


@needs_systemd
def test_unit_verifies(tmp_path):
    """Prevents a misspelt or misplaced setting, which systemd only warns of; the programs stand in where they will be installed."""
    text = UNIT.read_text()
    for name in re.findall(r"^Exec\w+=(\S+)", text, re.M):
        text = text.replace(f"={name}", f"={MOTORS_OFF}")
    (tmp_path / UNIT.name).write_text(text)
    result = analyze("verify", tmp_path / UNIT.name)
    ours = [line for line in (result.stdout + result.stderr).splitlines() if UNIT.name in line]
    assert result.returncode == 0 and ours == []


@needs_systemd
def test_unit_is_confined(tmp_path):
    """Prevents privileges from creeping back: `systemd-analyze security` rates 0 (confined) to 10 (anything goes)."""
    result = analyze("security", "--offline=true", "--threshold=20", UNIT)
    assert result.returncode == 0, result.stdout


@needs_systemd
def test_another_board_skips_the_unit():
    """Prevents a failed unit, and a degraded system, on a machine that is no BeagleBone."""
    (condition,) = re.findall(r"^(Condition\w+=.*)$", UNIT.read_text(), re.M)
    result = analyze("condition", condition)
    if Path("/proc/device-tree/compatible").exists():
        pytest.skip("this machine has a device tree of its own")
    assert result.returncode != 0 and "Failed to parse" not in result.stderr, result.stderr


def test_unit_grants_the_priorities_that_are_asked_for():
    """Prevents a loop or guard that silently runs without SCHED_FIFO on the robot."""
    limit = int(re.search(r"^LimitRTPRIO=(\d+)$", UNIT.read_text(), re.M)[1])
    assert limit >= MBBR["realtime"]["priority"].default + PRIORITY_ABOVE_LOOP
    assert "SystemCallFilter=@system-service" in UNIT.read_text()  # which holds sched_setscheduler, mlockall, memfd_create


def test_a_wrong_board_ends_with_a_code_that_the_unit_takes_for_success():
    """Prevents restarts without end and a failed unit where the program itself finds that this is no BeagleBone."""
    result = subprocess.run(
        [sys.executable, "-m", "mip_rt", "--set", "board=auto", "--duration", "1"], capture_output=True, text=True, check=False, cwd=FOLDER.parent
    )
    assert "board_unknown" in result.stderr and "cure" in result.stderr
    assert str(result.returncode) in re.search(r"^SuccessExitStatus=(.*)$", UNIT.read_text(), re.M)[1].split()


@pytest.mark.skipif(shutil.which("systemd-sysusers") is None, reason="systemd-sysusers is not installed (apt install systemd)")
def test_user_file_is_understood(tmp_path):
    """Prevents a service without its user or groups."""
    result = subprocess.run(
        ["systemd-sysusers", "--dry-run", str(FOLDER / "mip-rt.sysusers.conf")], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0 and "mip-rt" in result.stdout + result.stderr, result.stderr


# -- motors-off ------------------------------------------------------------------------------------------------------
@pytest.fixture(params=["pwmchipK/pwmN", "pwm-K:N"])
def tree(request, tmp_path):
    """A tree as a killed robot leaves it: all motor channels running, the enable line exported high by another program."""
    sysfs = FakeSysfs(tmp_path, BOARDS["beaglebone-black-cape"], pwm_naming=request.param)
    for chip in (tmp_path / "sys/class/pwm").glob("pwmchip*"):
        for channel in "01":
            (chip / "export").write_text(channel)
            sysfs.service()
    running(tmp_path, "period", "50000\n")
    running(tmp_path, "duty_cycle", "12345\n")
    running(tmp_path, "enable", "1\n")
    bank = tmp_path / f"sys/devices/platform/ocp/{GPIO[0]}.gpio/gpio/gpiochip512"
    bank.mkdir(parents=True)
    (bank / "base").write_text("512\n")
    gpio = tmp_path / "sys/class/gpio"
    (gpio / "gpio532").mkdir(parents=True)
    (gpio / "gpio532/direction").write_text("out\n")
    (gpio / "gpiochip512").symlink_to(bank)
    yield tmp_path
    sysfs.close()


def channels(root):
    found = sorted({path.resolve() for pattern in ("pwmchip*/pwm[01]", "pwm-*:[01]") for path in (root / "sys/class/pwm").glob(pattern)})
    assert len(found) == 4
    return found


def running(root, name, value=None):
    """Reads an attribute of all channels, or writes it."""
    for channel in channels(root):
        if value is not None:
            (channel / name).write_text(value)
    return [(channel / name).read_text().split("\n")[0] for channel in channels(root)]


def motors_off(root, **options):
    return subprocess.run(["/bin/sh", str(MOTORS_OFF), str(root)], capture_output=True, text=True, check=False, **options)


def test_motors_off_switches_everything_off_within_100_ms(tree):
    """Prevents duties that survive a kill. With no program on the path: only the shell itself is used."""
    times = []
    for _ in range(5):
        running(tree, "duty_cycle", "12345\n")
        running(tree, "enable", "1\n")
        begin = time.monotonic()
        result = motors_off(tree, env={"PATH": "/nowhere"})
        times.append(time.monotonic() - begin)
        assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
        assert running(tree, "duty_cycle") == ["0"] * 4 and running(tree, "enable") == ["0"] * 4
        assert (tree / "sys/class/gpio/gpio532/direction").read_text() == "low\n"
    assert min(times) < 0.1


def test_motors_off_leaves_other_pwm_and_unset_channels_alone(tree):
    """Prevents switching off what is not ours, and complaints about channels that were never set up."""
    other = tree / "sys/devices/platform/ocp/48000000.interconnect/48300000.target-module/48300100.pwm/pwm/pwmchip0"
    (other / "pwm0").mkdir(parents=True)
    for name, value in (("period", "1000\n"), ("duty_cycle", "500\n"), ("enable", "1\n")):
        (other / "pwm0" / name).write_text(value)
    unset = channels(tree)[0]
    (tree / "sys/class/pwm/pwmchip0").symlink_to(other)
    for name in ("period", "duty_cycle"):
        (unset / name).write_text("0\n")
        (unset / name).chmod(0o444)
    result = motors_off(tree)
    assert result.returncode == 0 and result.stderr == ""
    assert (other / "pwm0/duty_cycle").read_text() == "500\n"


def test_motors_off_tries_everything_and_says_what_failed(tree):
    """Prevents that the first refused write leaves the rest running."""
    refused = channels(tree)[0] / "duty_cycle"
    refused.unlink()
    refused.mkdir()  # no write can succeed, not even root's
    result = motors_off(tree)
    assert result.returncode == 1 and str(refused.name) in result.stderr
    assert all((channel / "duty_cycle").read_text().startswith("0\n") for channel in channels(tree)[1:])
    assert (tree / "sys/class/gpio/gpio532/direction").read_text() == "low\n"


def test_motors_off_on_a_machine_without_motors(tmp_path):
    """Prevents a failed unit on a board where it does not belong."""
    result = motors_off(tmp_path)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


def test_motors_off_knows_the_same_pins_as_the_boards():
    """Prevents a script that switches off the wrong chips after an edit of the pin tables."""
    text = MOTORS_OFF.read_text()
    for board in BOARDS.values():
        assert all(chip in text for pin in board.motors.values() for chip, _ in pin.channels)
        bank, offset = board.enable
        assert GPIO[bank] in text and f"base + {offset}" in text
    assert os.access(MOTORS_OFF, os.X_OK)
