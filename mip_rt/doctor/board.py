"""Board, kernel, overlays, pads, GPIO banks.

Sources: the device trees and overlays of BeagleBoard (pads), drivers/pinctrl/pinctrl-single.c (the list in debugfs), AM335x manual 9.2.2 (pad bits).
"""

import os
import re

from mip_rt.doctor.patient import as_check
from mip_rt.doctor.report import fail, ok, skip, warn
from mip_rt.errors import HardwareError
from mip_rt.hardware.boards import EHRPWM, EQEP, GPIO, board
from mip_rt.hardware.sysfs import find_by_address

# Stock overlays that take pads of this robot: {part of the name: (what happens, cure)}.
WRONG_OVERLAYS = {
    "BB-EQEP0": ("takes P9_25, the IMU's interrupt, and a pad of the motors' enable line (index resets the count)", "the project's overlay"),
    "bone_eqep0": ("takes P9_25, the IMU's interrupt, and a pad of the motors' enable line", "the project's overlay"),
    "BB-EQEP2-": ("puts eQEP 2 on P8_41 and P8_42, the wrong pair", "the project's overlay (or BB-EQEP2B)"),
    "BB-EQEP2.": ("puts eQEP 2 on P8_41 and P8_42, the wrong pair", "the project's overlay (or BB-EQEP2B)"),
    "AM3359-PWM012": ("puts the motors' PWM on the wrong pins", "the project's overlay"),
    "BB-I2C2-MPU6050": ("gives the IMU to a kernel driver", "nothing: remove it"),
    "BBBLUE-MPU9250": ("gives the IMU to a kernel driver", "nothing: remove it"),
}
PAD_BASE = 0x44E10800
PADS_ENCODER = {EQEP[0]: ((0x9A0, 1), (0x9A4, 1)), EQEP[1]: ((0x8D0, 2), (0x8D4, 2)), EQEP[2]: ((0x830, 4), (0x834, 4))}
PADS_PWM = {(EHRPWM[1], 0): (0x848, 6), (EHRPWM[1], 1): (0x84C, 6), (EHRPWM[2], 0): (0x820, 4), (EHRPWM[2], 1): (0x824, 4)}
PAD_IMU, RECEIVER = (0x9AC, 7), 0x20
_PAD = re.compile(r"(?:^|\W)(44e1[0-9a-f]{4})\b.*?\b([0-9a-f]{8})\s+pinctrl", re.IGNORECASE)


def examine(patient):
    """Yields the layer's Checks."""
    model = patient.text("proc/device-tree/model") or "unknown"
    try:
        patient.pins = board(patient.config.board, patient.kernel)
        yield _model(model, patient.pins.name)
        if "BeagleBone" not in model:
            return  # nothing below would mean anything
    except HardwareError as error:
        yield as_check("model", error)
        return
    yield _kernel(patient)
    yield from _overlays(patient)
    yield _pads(patient)
    yield _gpio(patient)


def _model(model: str, name: str):
    if "BeagleBone" not in model:
        return fail("model", f"this is {model}, the configuration names the board {name}.", "Run it on the BeagleBone; on a PC: mip-rt doctor --dry-run.")
    if ("Blue" in model) != name.endswith("blue"):
        return fail("model", f"this is {model}, the configuration names the board {name}: other pins.", "Set board to auto, or to the board's name.")
    return ok("model", f"{model}; pin table {name}.")


def _kernel(patient):
    release = patient.text("proc/sys/kernel/osrelease")
    found = re.match(r"(\d+)\.(\d+)", release)
    version = tuple(map(int, found.groups())) if found else (0, 0)
    if version < (4, 14):
        return fail("kernel", f"Linux {release or 'unknown'} is older than 4.14; some of those fault when an eQEP is read.",
                    "Install a BeagleBoard kernel of 5.10 or later (bbb.io-kernel-5.10-ti-am335x).")  # fmt: skip
    if "armmp" in release:
        return fail("kernel", f"Linux {release} is Debian's own kernel: it has no eQEP driver.", "Install a BeagleBoard kernel (bbb.io-kernel-6.12-bone).")
    if (4, 19) < version < (5, 10):
        return warn("kernel", f"Linux {release} is between the two generations that are tested (4.14 to 4.19, 5.10 and later).", "Use 5.10-ti or later.")
    return ok("kernel", f"Linux {release}.")


def _overlays(patient):
    folder = patient.kernel.path("proc/device-tree/chosen/overlays")
    names = sorted(entry.name for entry in folder.iterdir() if entry.name != "name") if folder.is_dir() else []
    for name in names:
        for part, (harm, instead) in WRONG_OVERLAYS.items():
            if f"{name}.".startswith(part):
                yield fail("overlay", f"the overlay {name} {harm}.", f"Take it out of /boot/uEnv.txt and load {instead}; reboot.")
    if any(name.startswith("mip-rt") for name in names):
        yield ok("overlays", f"loaded: {', '.join(names)}.")
    else:
        yield warn("overlays", f"the project's overlay is not loaded (loaded: {', '.join(names) or 'none'}).",
                   "Run tools/install, which puts it into /boot/uEnv.txt, and reboot; without it every pad must be right by other means.")  # fmt: skip


def expected_pads(pins, config) -> dict:
    """{pad's offset in the control module: (mode, what it is for)} of a board with this configuration."""
    wanted = {PAD_IMU[0]: (PAD_IMU[1], "the IMU's interrupt")}
    for channel in config.encoders.channels:
        for offset, mode in PADS_ENCODER[pins.encoders[channel - 1]]:
            wanted[offset] = (mode, f"encoder {channel}")
    for output in config.motors.channels:
        offset, mode = PADS_PWM[pins.motors[output].pwm]
        wanted[offset] = (mode, f"PWM of motor output {output}")
    return wanted


def _pads(patient):
    root = patient.kernel.path("sys/kernel/debug/pinctrl")
    try:
        listed = [text.read_text() for text in sorted(root.glob("44e10800.pinmux*/pins"))]
    except OSError:
        listed = []
    if not listed:
        return skip("pads", "debugfs can only be read by root", "sudo mip-rt doctor looks at the pads, too.")
    pads = {int(address, 16) - PAD_BASE + 0x800: int(value, 16) for address, value in _PAD.findall("\n".join(listed).replace("\n", " \n"))}
    wrong = []
    for offset, (mode, purpose) in expected_pads(patient.pins, patient.config).items():
        value = pads.get(offset)
        if value is None:
            continue
        if value & 7 != mode:
            wrong.append(f"pad 0x{offset:03x} ({purpose}) is in mode {value & 7}, not {mode}")
        elif "PWM" not in purpose and not value & RECEIVER:
            wrong.append(f"pad 0x{offset:03x} ({purpose}) has its receiver off")
    if wrong:
        extra = " On this device tree channel A of E1 is on another pad (0x998)." if any("0x9a0" in each for each in wrong) else ""
        return fail("pads", "; ".join(wrong) + "." + extra, "Load the project's overlay (tools/install) and reboot.")
    return ok("pads", f"{len(expected_pads(patient.pins, patient.config))} pads are in their modes.")


def _gpio(patient):
    chips, refused = [], []
    for bank, address in enumerate(GPIO):
        entry = find_by_address(patient.kernel.path("sys/bus/gpio/devices"), "gpiochip*", address)
        if entry is None:
            return fail("gpio", f"there is no GPIO chip at {address} (bank {bank}).", "Is this an AM335x? Update the kernel.")
        chips.append(f"gpio{bank} = {entry.name}")
        if not os.access(patient.kernel.path("dev", entry.name), os.R_OK | os.W_OK):
            refused.append(entry.name)
    if refused:
        return fail("gpio", f"/dev/{refused[0]} cannot be opened by this user.", "Install the project's udev rules (tools/install) and join the group gpio.")
    return ok("gpio", f"{', '.join(chips)} (found by address; the numbers differ between kernels).")
