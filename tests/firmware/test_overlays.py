"""The compiled overlays, decompiled, against pads and values that stand here as numbers, from the hardware's documents."""

import re
import shutil
import subprocess

import pytest

from mip_rt.firmware import overlay
from mip_rt.firmware.overlay import FirmwareError
from mip_rt.hardware.boards import BOARDS, EHRPWM

needs_dtc = pytest.mark.skipif(shutil.which("dtc") is None or shutil.which("cpp") is None, reason="apt install device-tree-compiler cpp")

# Pad registers (offset in the control module) and the values that they shall have: 0x2. receiver with pull-down, 0x3. with pull-up, ..f and
# ..8 no pull, 0x0. output; last digit's low three bits are the mode.
COMMON = {0x8C0: 0x0C, 0x8C4: 0x34, 0x9AC: 0x37, 0x89C: 0x37, 0x898: 0x37, 0x9B4: 0x27}  # UART5, IMU interrupt, two buttons, standby
PWM = {0x848: 0x06, 0x84C: 0x06, 0x820: 0x04, 0x824: 0x04}  # P9_14, P9_16, P8_19, P8_13
BLACK = {
    0x9A0: 0x31, 0x9A4: 0x31, 0x8D0: 0x32, 0x8D4: 0x32, 0x830: 0x34, 0x834: 0x34,  # eQEP0, 1, 2
    0x890: 0x27, 0x894: 0x27, 0x9A8: 0x27, 0x964: 0x2F,  # lamps, second pads of P9_41 and P9_42
}  # fmt: skip
THREE_DIRECTIONS = dict.fromkeys((0x878, 0x874, 0x840, 0x8CC, 0x8AC, 0x8A8), 0x27)
TABLES = {
    "mip-rt-beaglebone-black-cape": COMMON | BLACK | PWM | THREE_DIRECTIONS | {0x8A0: 0x27, 0x8A4: 0x27},
    "mip-rt-beaglebone-black-mc33926": COMMON | BLACK | {0x848: 0x06, 0x84C: 0x06, 0x820: 0x04} | THREE_DIRECTIONS,
    "mip-rt-beaglebone-black-mc33926-s2": COMMON | BLACK | PWM | {0x950: 0x03, 0x954: 0x03},
    "mip-rt-beaglebone-blue": COMMON | PWM | {
        0x9A0: 0x21, 0x9A4: 0x21, 0x8D0: 0x2A, 0x8D4: 0x2A, 0x830: 0x2C, 0x834: 0x2C,
        0x888: 0x27, 0x874: 0x27, 0x840: 0x27, 0x8D8: 0x27, 0x8AC: 0x27, 0x8A8: 0x27, 0x8A0: 0x27, 0x8A4: 0x27,
    },
}  # fmt: skip
# Pads by function (AM335x data sheet, pin attributes): legacy GPIO number, PWM channel.
PAD_OF_LINE = {
    60: 0x878, 31: 0x874, 48: 0x840, 81: 0x8CC, 73: 0x8AC, 72: 0x8A8, 70: 0x8A0, 71: 0x8A4, 20: 0x9B4, 117: 0x9AC, 69: 0x89C, 68: 0x898,
    66: 0x890, 67: 0x894, 64: 0x888, 10: 0x8D8,
}  # fmt: skip
PAD_OF_PWM = {(0, 0): 0x950, (0, 1): 0x954, (1, 0): 0x848, (1, 1): 0x84C, (2, 0): 0x820, (2, 1): 0x824}
FORBIDDEN = {0x8D8: "MDIR_2B is eQEP1's index", 0x8DC: "eQEP1's strobe", 0x838: "eQEP2's index", 0x83C: "eQEP2's strobe"}

BASE = """/dts-v1/;
/ { #address-cells = <1>; #size-cells = <1>;
  chosen { };
  am33xx_pinmux: pinmux@800 { #pinctrl-cells = <%d>; pinctrl-names = "default"; pinctrl-0 = <&clkout2>; clkout2: clkout2 { }; };
  uart5: serial@481aa000 { status = "disabled"; };
  i2c2: i2c@4819c000 { #address-cells = <1>; #size-cells = <0>; clock-frequency = <100000>; status = "disabled"; %s };
  tscadc: tscadc@0 { status = "disabled"; adc { }; };
%s
};"""
IMU = 'mpu9250@68 { compatible = "invensense,mpu9250"; reg = <0x68>; };'
UNITS = ["epwmss0", "epwmss1", "epwmss2", "eqep0", "eqep1", "eqep2", "ehrpwm0", "ehrpwm1", "ehrpwm2"]


def run(*command, **options):
    return subprocess.run([str(word) for word in command], capture_output=True, check=True, **options).stdout


def pads(blob: bytes, cells: int) -> list[tuple[int, int]]:
    """(pad, value) of all pads in the decompiled overlay; a kernel adds electrical part and mode."""
    found = []
    for text in re.findall(r"pinctrl-single,pins = <([^>]*)>", run("dtc", "-q", "-I", "dtb", "-O", "dts", input=blob).decode()):
        numbers = [int(word, 16) for word in text.split()]
        assert len(numbers) % (cells + 1) == 0
        for at in range(0, len(numbers), cells + 1):
            found.append((0x800 + numbers[at], sum(numbers[at + 1 : at + 1 + cells])))
    return found


@needs_dtc
@pytest.mark.parametrize("cells", [1, 2])
@pytest.mark.parametrize("name", TABLES)
def test_pads_are_those_of_the_documents(name, cells):
    """Prevents a wrong pad, mode or pull, in both ways in which kernels read pads; each pad stands once."""
    found = pads(overlay.compiled(name, cells), cells)
    assert len({pad for pad, _ in found}) == len(found)
    assert {hex(pad): hex(value) for pad, value in found} == {hex(pad): hex(value) for pad, value in TABLES[name].items()}


@needs_dtc
@pytest.mark.parametrize("name", list(BOARDS))
def test_every_pin_of_a_board_is_in_its_overlay(name):
    """Prevents tables and overlays from drifting apart: lines are GPIO pads with a safe pull, PWM pads are low without their driver."""
    board = BOARDS[name]
    table = dict(pads(overlay.compiled(board.overlay, 2), 2))
    outputs = [line for pins in board.motors.values() for line in (pins.a, pins.b) if line] + [board.enable]
    for bank, offset in outputs:
        assert table[PAD_OF_LINE[32 * bank + offset]] == 0x27  # GPIO, pulled down: off, whoever lets go
    for bank, offset in (board.imu_interrupt, board.arm_button, board.mode_button):
        assert table[PAD_OF_LINE[32 * bank + offset]] == 0x37
    for pins in board.motors.values():
        for chip, channel in pins.channels:
            assert table[PAD_OF_PWM[EHRPWM.index(chip), channel]] & 0x38 == 0  # output, pull-down
    for pad, why in FORBIDDEN.items():
        assert table.get(pad, 7) & 7 == 7, why  # index or strobe would reset the count
    assert table[0x9AC] & 7 == 7 and table.get(0x9A8, 7) & 7 == 7  # of eQEP0 likewise


@needs_dtc
@pytest.mark.skipif(shutil.which("fdtoverlay") is None, reason="apt install device-tree-compiler")
@pytest.mark.parametrize("cells", [1, 2])
@pytest.mark.parametrize("name", TABLES)
def test_overlays_apply_to_a_base_tree(tmp_path, name, cells):
    """Prevents an overlay that U-Boot refuses or that leaves a unit off: all labels resolve, and what the robot needs is on."""
    blue = name.endswith("blue")
    nodes = "\n".join(f'{unit}: {unit} {{ status = "disabled"; }};' for unit in UNITS)
    run("dtc", "-q", "-@", "-I", "dts", "-O", "dtb", "-o", tmp_path / "base", "-", input=(BASE % (cells, IMU if blue else "", nodes)).encode())
    (tmp_path / "overlay").write_bytes(overlay.compiled(name, cells))
    run("fdtoverlay", "-i", tmp_path / "base", "-o", tmp_path / "merged", tmp_path / "overlay")

    def get(node, key, kind="s"):
        return run("fdtget", "-t", kind, tmp_path / "merged", node, key).decode().strip()

    on = [unit for unit in UNITS if get(f"/{unit}", "status") == "okay"]
    assert on == [unit for unit in UNITS if unit != "ehrpwm0" or name.endswith("s2")]
    assert get("/i2c@4819c000", "clock-frequency", "u") == "400000" and get("/i2c@4819c000", "status") == "okay"
    assert get("/serial@481aa000", "status") == get("/tscadc@0", "status") == "okay"
    assert get("/tscadc@0/adc", "ti,adc-channels", "u") == "0 1 2 3 4 5 6 7"
    assert get("/chosen/overlays", name) == "1"
    groups = run("fdtget", "-l", tmp_path / "merged", "/pinmux@800").decode().split()
    assert "mip-rt-gpio-pins" in groups and "mip_rt_eqep0-pins" in groups
    assert get("/pinmux@800", "pinctrl-0", "x") == get("/pinmux@800/mip-rt-gpio-pins", "phandle", "x")
    assert get("/eqep0", "pinctrl-0", "x") == get("/pinmux@800/mip_rt_eqep0-pins", "phandle", "x")
    if blue:
        assert get("/i2c@4819c000/mpu9250@68", "status") == "disabled"


def test_missing_compiler_has_a_cure(monkeypatch):
    """Prevents a traceback on a plain image."""
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(FirmwareError) as caught:
        overlay.compiled("mip-rt-beaglebone-blue", 2)
    assert caught.value.code == "dtc_missing" and "apt-get install" in caught.value.cure


@needs_dtc
def test_a_damaged_source_is_refused(monkeypatch, tmp_path):
    """Prevents half an overlay in /lib/firmware."""
    shutil.copytree(overlay.source_folder(), tmp_path / "firmware")
    file = tmp_path / "firmware/mip-rt-beaglebone-blue.dts"
    file.write_text(file.read_text().replace("};", "}", 1))
    monkeypatch.setattr(overlay, "source_folder", lambda: tmp_path / "firmware")
    with pytest.raises(FirmwareError) as caught:
        overlay.compiled("mip-rt-beaglebone-blue", 2)
    assert caught.value.code == "overlay_compile"
