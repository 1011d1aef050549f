"""uEnv.txt, rules and overlay on a fake system: shown before, written whole, taken back exactly."""

import os
import re
import shutil

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mip_rt import cli
from mip_rt.errors import MipRtError
from mip_rt.fake.generations import GENERATIONS
from mip_rt.fake.sysfs import FakeSysfs
from mip_rt.firmware import files, overlay, uenv
from mip_rt.hardware.boards import BOARDS
from mip_rt.hardware.kernel import Kernel

CAPE, BLUE = BOARDS["beaglebone-black-cape"], BOARDS["beaglebone-blue"]
PATH = "/lib/firmware/x.dtbo"
# The shape of an image's file.
STOCK = """#Docs: somewhere
uname_r=5.10.168-ti-r72
#uuid=
enable_uboot_overlays=1
#uboot_overlay_addr0=<file0>.dtbo
uboot_overlay_addr4=BB-UART1-00A0.dtbo
uboot_overlay_addr5=/lib/firmware/BB-EQEP0-00A0.dtbo
#disable_uboot_overlay_video=1
enable_uboot_cape_universal=1
cmdline=coherent_pool=1M net.ifnames=0 quiet
"""


def active(text):
    """Assignments as U-Boot's `env import` takes them: the last one wins."""
    pairs = (line.split("=", 1) for line in text.splitlines() if "=" in line and not line.lstrip().startswith("#"))
    return {key.strip(): value.strip() for key, value in pairs}


def test_stock_file_gets_overlay_and_settings_and_loses_conflicts():
    """Prevents BB-EQEP0, which takes the IMU's interrupt pad, from staying beside our overlay, and HDMI from holding UART5's pads."""
    text = uenv.added(STOCK, CAPE, PATH)
    assert active(text) == {
        "uname_r": "5.10.168-ti-r72", "enable_uboot_overlays": "1", "uboot_overlay_addr4": "BB-UART1-00A0.dtbo", "uboot_overlay_addr5": PATH,
        "disable_uboot_overlay_video": "1", "disable_uboot_overlay_audio": "1", "cmdline": "coherent_pool=1M net.ifnames=0 quiet",
    }  # fmt: skip
    assert "disable_uboot_overlay_video" not in active(uenv.added(STOCK, BLUE, PATH))  # a Blue has no HDMI
    assert uenv.removed(text) == STOCK


LINES = st.lists(
    st.sampled_from([*STOCK.splitlines(), "", "  uboot_overlay_addr4 = BB-EQEP1.dtbo", "enable_uboot_overlays=0", "# mip-rt", "x=#y", "ümlaut=1"])
    | st.text(st.characters(blacklist_categories=("Cs", "Cc", "Zl", "Zp")), max_size=20).filter(lambda t: "mip-rt" not in t), max_size=20,
)  # fmt: skip


@given(LINES, st.sampled_from(["\n", "\r\n"]), st.sampled_from(list(BOARDS.values())), st.sampled_from(list(BOARDS.values())))
def test_what_is_added_can_be_taken_back(lines, newline, first, second):
    """Prevents a file that grows with each run or that revert leaves changed, whatever a user has in it."""
    text = "".join(line + newline for line in lines)
    once = uenv.added(text, first, PATH)
    assert uenv.added(once, first, PATH) == once and uenv.removed(once) == text
    assert uenv.added(once, second, PATH) == uenv.added(text, second, PATH)
    assert PATH in active(once).values() and active(once)["enable_uboot_overlays"] == "1"


def test_edits_made_in_the_meantime_survive_revert():
    """Prevents a way back that throws away what the user did since."""
    text = uenv.added(STOCK, CAPE, PATH).replace("quiet", "verbose") + "added=1\n"
    assert uenv.removed(text) == STOCK.replace("quiet", "verbose") + "added=1\n"


def test_no_free_slot_is_said():
    """Prevents overwriting an overlay that somebody wants."""
    full = "".join(f"uboot_overlay_addr{n}=A{n}.dtbo\n" for n in range(8))
    with pytest.raises(MipRtError) as caught:
        uenv.added(full, CAPE, PATH)
    assert caught.value.code == "uenv_full"


# -- on a fake system ------------------------------------------------------------------------------------------------
@pytest.fixture
def system(tmp_path):
    made = FakeSysfs(tmp_path, CAPE, stock=True)
    for folder in ("boot", "etc/udev/rules.d", "etc/modprobe.d", "lib/firmware"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / files.UENV).write_text(STOCK)
    (tmp_path / "lib/firmware/BB-UART1-00A0.dtbo").write_text("not ours")
    yield tmp_path
    made.close()


def tree(root):
    """Everything outside of /sys, /proc and /dev."""
    paths = (path for folder in ("boot", "etc", "lib") for path in (root / folder).rglob("*"))
    return {str(path.relative_to(root)): path.read_bytes() for path in paths if path.is_file()}


def mip_rt(system, *words):
    return cli.main(["firmware", *words, "--root", str(system)])


needs_dtc = pytest.mark.skipif(shutil.which("dtc") is None or shutil.which("cpp") is None, reason="apt install device-tree-compiler cpp")


@needs_dtc
def test_diff_changes_nothing_apply_does_and_revert_undoes(system, capsys):
    """Prevents a surprise in /boot: the dry run touches nothing, a second apply finds nothing to do, revert leaves the copy alone."""
    before = tree(system)
    assert mip_rt(system, "diff") == 0 and tree(system) == before
    shown = capsys.readouterr().out
    assert "+uboot_overlay_addr5=/lib/firmware/mip-rt-beaglebone-black-cape.dtbo" in shown and "blacklist inv_mpu6050_i2c" in shown
    assert mip_rt(system, "apply") == 0
    after = tree(system)
    assert set(after) - set(before) == {
        "lib/firmware/mip-rt-beaglebone-black-cape.dtbo", "etc/udev/rules.d/90-mip-rt.rules", "etc/modprobe.d/mip-rt.conf", files.BACKUP,
    }  # fmt: skip
    assert after[files.BACKUP] == before[files.UENV] and after["lib/firmware/mip-rt-beaglebone-black-cape.dtbo"][:4] == b"\xd0\x0d\xfe\xed"
    assert "reboot" in capsys.readouterr().out
    assert mip_rt(system, "apply") == 0 and tree(system) == after and "nothing to change" in capsys.readouterr().out
    assert mip_rt(system, "show") == 0 and "differs" not in capsys.readouterr().out
    assert mip_rt(system, "apply", "--board", "beaglebone-black-mc33926") == 0
    assert [name for name in tree(system) if "mip-rt-bea" in name] == ["lib/firmware/mip-rt-beaglebone-black-mc33926.dtbo"]
    assert mip_rt(system, "revert") == 0
    assert tree(system) == {**before, files.BACKUP: before[files.UENV]}
    assert mip_rt(system, "revert") == 0 and "nothing to change" in capsys.readouterr().out.splitlines()[-1]


@needs_dtc
def test_a_refused_write_leaves_the_old_file(system, monkeypatch):
    """Prevents half a uEnv.txt, with which the board would not start: a write that fails at any point leaves the old content."""
    kernel = Kernel()
    kernel.root = system
    changes = [change for change in files.plan(kernel, CAPE) if change.name == files.UENV]

    def refuse(fd):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(MipRtError, match="No space") as caught:
        files.carry_out(kernel, changes)
    assert caught.value.cure and (system / files.UENV).read_text() == STOCK
    assert sorted(path.name for path in (system / "boot").iterdir()) == ["uEnv.txt"]


def test_a_system_without_uenv_is_told(system, capsys):
    """Prevents a traceback on an image that boots otherwise."""
    (system / files.UENV).unlink()
    assert mip_rt(system, "diff") == 3 and "uenv_missing" in capsys.readouterr().err


@pytest.mark.parametrize("generation", GENERATIONS)
def test_the_kernels_way_of_writing_pads_is_found(tmp_path, generation):
    """Prevents pads of the old form on a new kernel and the other way round: the kernel would read other pads and values."""
    FakeSysfs(tmp_path, CAPE, generation).close()
    kernel = Kernel()
    kernel.root = tmp_path
    wanted = GENERATIONS[generation].pinctrl_cells
    assert overlay.pinctrl_cells(kernel) == wanted
    shutil.rmtree(tmp_path / "proc/device-tree")  # by the release alone
    assert overlay.pinctrl_cells(kernel) == wanted


# -- rules -----------------------------------------------------------------------------------------------------------
def test_udev_rules_serve_the_services_groups():
    """Prevents a device that the service cannot open: every device has a rule, every group is one of the service's, every line parses."""
    text = (overlay.source_folder() / "90-mip-rt.rules").read_text()
    service = (overlay.source_folder().parent / "systemd/mip-rt.service").read_text()
    groups = set(re.search(r"^SupplementaryGroups=(.*)$", service, re.M)[1].split())
    match = r'[A-Z]+\s*(?:==|=|\+=)\s*"[^"]*"'
    subsystems = set()
    for line in text.splitlines():
        if not line or line.startswith("#"):
            continue
        assert re.fullmatch(rf"{match}(?:, {match})*", line), line
        subsystems |= set(re.findall(r'SUBSYSTEM=="(\w[\w-]*)"', line))
        assert set(re.findall(r'GROUP="(\w+)"|chgrp -RP (\w+)', line)[0]) - {""} <= groups
    assert subsystems == {"gpio", "i2c-dev", "tty", "misc", "iio", "pwm", "counter", "platform", "leds"}


def test_modprobe_file_keeps_the_imus_driver_away():
    """Prevents the driver from taking the IMU again at the next boot."""
    lines = [line for line in (overlay.source_folder() / "mip-rt.conf").read_text().splitlines() if line and not line.startswith("#")]
    assert lines == ["blacklist inv_mpu6050_i2c"]
