"""What a healthy board shows beside its chips: device tree, kernel release, pads, device files, services. For doctor's dry run.

The contents are those of a BeagleBone with the project's overlay on 5.10-ti; `ailments` takes single things away.
"""

import sys

from mip_rt.hardware.boards import Board
from mip_rt.hardware.kernel import Kernel

MODELS = {"beaglebone-blue": "TI AM335x BeagleBone Blue", "beaglebone-black-cape": "TI AM335x BeagleBone Black",
          "beaglebone-black-mc33926": "TI AM335x BeagleBone Black"}  # fmt: skip
# Pad registers at 0x44e10800 + (offset - 0x800): mode in the low three bits, receiver 0x20.
PADS = {0x9A0: 0x31, 0x9A4: 0x31, 0x8D0: 0x32, 0x8D4: 0x32, 0x830: 0x34, 0x834: 0x34, 0x848: 0x06, 0x84C: 0x06, 0x820: 0x04, 0x824: 0x04,
        0x9AC: 0x37}  # fmt: skip


def pads_text(pads: dict) -> str:
    """debugfs' list of pinctrl-single."""
    lines = [f"registered pins: {len(pads)}"]
    for offset, value in sorted(pads.items()):
        number = (offset - 0x800) // 4
        lines.append(f"pin {number} (PIN{number}) 0:? {0x44E10000 + offset:08x} {value:08x} pinctrl-single ")
    return "\n".join(lines) + "\n"


def furnish(root, pins: Board) -> None:
    """Writes the files below the root; those that are there already stay."""
    files = {
        "proc/device-tree/model": MODELS[pins.name] + "\0",
        f"proc/device-tree/chosen/overlays/mip-rt-{pins.name}": "",
        "proc/sys/kernel/osrelease": "5.10.168-ti-r79\n",
        "sys/kernel/debug/pinctrl/44e10800.pinmux-pinctrl-single/pins": pads_text(PADS),
        "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "performance\n",
        "sys/bus/i2c/devices/2-0055/name": "24c256\n",
        "dev/i2c-2": "",
    }
    for name, content in files.items():
        path = root / name
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)


class Commands:
    """Answers for a Kernel's `command`: services by name, the compiler's probe by the real one.

    Attributes:
        active: names of the units that run.
        probe: (exit code, output) in the place of the real compiler's; None for the real one.
    """

    def __init__(self):
        self.active, self.probe = set(), None

    def __call__(self, *words, timeout_s: float = 10.0) -> tuple[int, str]:
        if words[:2] == ("systemctl", "is-active"):
            on = words[2] in self.active
            return (0, "active\n") if on else (3, "inactive\n")
        if words[0] == sys.executable:
            return self.probe or Kernel().command(*words, timeout_s=timeout_s)
        return 127, f"{words[0]}: not on the simulated board"
