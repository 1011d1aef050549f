"""Compiles a board's overlay for the running kernel's way of writing pads."""

import re
import subprocess
import sys
from pathlib import Path

from mip_rt.errors import MipRtError


class FirmwareError(MipRtError):
    """An overlay cannot be compiled, or a file of the system cannot be changed."""

    code = "firmware"


def source_folder() -> Path:
    """Where the overlays' sources, udev rules and modprobe configuration are.

    Raises:
        FirmwareError: they are not installed.
    """
    for folder in (Path(__file__).resolve().parents[2] / "firmware", Path(sys.prefix) / "share/mip-rt/firmware"):
        if (folder / "mip-rt.dtsi").exists():
            return folder
    raise FirmwareError("the sources of the overlays are not installed.", "Install mip-rt again.", "firmware_missing")


def pinctrl_cells(kernel) -> int:
    """1 or 2: #pinctrl-cells of the running device tree; by the kernel's release where there is none to read.

    Source: Linux commit 27c90e5e48d0 (5.10): from 1 to 2.
    """
    for found in kernel.path("proc/device-tree").glob("**/pinmux@*800/#pinctrl-cells"):
        return int.from_bytes(found.read_bytes(), "big")
    try:
        release = kernel.path("proc/sys/kernel/osrelease").read_text()
    except OSError:
        release = ""
    version = re.match(r"(\d+)\.(\d+)", release)
    return 1 if version and (int(version[1]), int(version[2])) < (5, 10) else 2


def compiled(name: str, cells: int) -> bytes:
    """The overlay `name` as a device-tree blob.

    Raises:
        FirmwareError: the compilers are missing or refuse.
    """
    folder = source_folder()
    preprocess = ["cpp", "-nostdinc", "-undef", "-P", "-x", "assembler-with-cpp", f"-DPINCTRL_CELLS={cells}", f"{name}.dts"]
    source = _output(preprocess, folder, None)
    return _output(["dtc", "-q", "-@", "-I", "dts", "-O", "dtb", "-o", "-", "-"], folder, source)


def _output(command, folder: Path, given) -> bytes:
    try:
        result = subprocess.run(command, cwd=folder, input=given, capture_output=True, check=False)
    except FileNotFoundError:
        raise FirmwareError(f"{command[0]} is missing.", "sudo apt-get install device-tree-compiler cpp", "dtc_missing") from None
    if result.returncode != 0:
        words = result.stderr.decode(errors="replace").strip().splitlines()
        raise FirmwareError(f"{' '.join(command[:1])} refuses {command[-1]}: {words[-1] if words else '?'}.", "Install mip-rt again.", "overlay_compile")
    return result.stdout
