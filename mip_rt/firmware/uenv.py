"""The lines of U-Boot's /boot/uEnv.txt: added in one marked block, conflicting lines switched off by a mark, both taken back exactly.

Source: BeagleBoard's uEnv.txt and U-Boot environment: an overlay may be named by its full path; slots 0 to 3 are capes, 4 to 7 are free.
"""

import re

from mip_rt.errors import MipRtError

BEGIN, END = "# mip-rt begin (taken back by: mip-rt firmware revert)", "# mip-rt end"
OFF = "#mip-rt off# "
# Overlays that take pads or units of ours: their names begin like this.
CONFLICTS = (
    "BB-EQEP", "bone_eqep", "BB-EHRPWM", "BB-PWM", "BB-ECAP", "AM3359-PWM", "BB-UART2", "BB-UART4", "BB-UART5", "BB-I2C2-MPU", "BBBLUE-",
    "BB-HDMI", "RoboticsCape", "mip-rt-", "cape-univ", "univ-",
)  # fmt: skip
_ASSIGNMENT = re.compile(r"\s*([A-Za-z0-9_]+)\s*=(.*)")


def settings(board) -> dict:
    """Assignments that the board needs beside its overlay: HDMI gives its pads to encoders, UART5 and direction lines."""
    common = {"enable_uboot_overlays": "1"}
    return common if "Blue" in board.model else {**common, "disable_uboot_overlay_video": "1", "disable_uboot_overlay_audio": "1"}


def removed(text: str) -> str:
    """The text without anything that `added` did."""
    lines, inside = [], False
    for line in text.splitlines(keepends=True):
        if line.strip() == BEGIN:
            inside = True
        elif inside:
            inside = line.strip() != END
        else:
            lines.append(line.removeprefix(OFF))
    return "".join(lines)


def added(text: str, board, overlay_path: str) -> str:
    """The text with the board's overlay and settings; adding twice is adding once. Everything else stays as it is.

    Raises:
        MipRtError: all overlay slots are in use.
    """
    wanted = settings(board)
    lines, used = [], set()
    for line in removed(text).splitlines(keepends=True):
        found = _ASSIGNMENT.match(line)
        if found and _conflicts(found[1], found[2].strip(), wanted):
            line = OFF + line
        elif found:
            used.add(found[1])
        lines.append(line)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    slot = next((name for name in (f"uboot_overlay_addr{n}" for n in (4, 5, 6, 7, 0, 1, 2, 3)) if name not in used), None)
    if slot is None:
        raise MipRtError("all eight overlay slots of uEnv.txt are in use.", "Remove an uboot_overlay_addr line that is not needed.", "uenv_full")
    block = [BEGIN, *(f"{key}={value}" for key, value in wanted.items()), f"{slot}={overlay_path}", END]
    return "".join(lines) + "\n".join(block) + "\n"


def _conflicts(key: str, value: str, wanted: dict) -> bool:
    if key in wanted:
        return value != wanted[key]
    if key == "enable_uboot_cape_universal":
        return True
    name = value.rsplit("/", 1)[-1].lower()
    return key.startswith("uboot_overlay_addr") and name.startswith(tuple(prefix.lower() for prefix in CONFLICTS))
