"""The verb `mip-rt firmware`."""

import json
import sys
from pathlib import Path

from mip_rt.firmware import files
from mip_rt.hardware import boards
from mip_rt.hardware.kernel import Kernel

AFTERWARDS = "then: sudo update-initramfs -u; sudo udevadm control --reload; sudo reboot"


def add_arguments(parser) -> None:
    """Declares the verb's arguments."""
    parser.add_argument("action", choices=("show", "diff", "apply", "revert"),
                        help="what is installed; what apply would change; change it; take everything back")  # fmt: skip
    parser.add_argument("--board", choices=("auto", *boards.NAMES), default="auto", help="default: by the device tree, the cape for a Black")
    parser.add_argument("--root", metavar="DIR", type=Path, default=Path("/"), help="another system than the running one, mounted there")
    parser.add_argument("--json", action="store_true", help="show: one JSON object")


def run(arguments) -> int:
    """Exit code 0; refusals are MipRtErrors."""
    kernel = Kernel()
    kernel.root = arguments.root.resolve()
    if arguments.action == "revert":
        changes = files.plan_back(kernel)
    else:
        board = boards.board(arguments.board, kernel)
        changes = files.plan(kernel, board)
        if arguments.action == "show":
            return _show(kernel, board, changes, arguments.json)
    needed = [change for change in changes if change.needed]
    for change in needed:
        sys.stdout.write(change.diff())
    if not needed:
        print("nothing to change")
    elif arguments.action == "diff":
        print("nothing is changed yet; do it: sudo mip-rt firmware apply")
    else:
        files.carry_out(kernel, needed)
        print(f"{len(needed)} file(s) changed; {AFTERWARDS}")
    return 0


def _show(kernel, board, changes, as_json: bool) -> int:
    words = {change.name: "installed" if not change.needed else "missing" if change.before is None else "differs" for change in changes}
    words.pop(files.BACKUP, None)
    loaded = board.overlay in boards.loaded_overlays(kernel)
    if as_json:
        print(json.dumps({"board": board.name, "overlay": board.overlay, "loaded": loaded, "files": {f"/{name}": word for name, word in words.items()}}))
        return 0
    print(f"{board.name}: overlay {board.overlay} {'is loaded' if loaded else 'is not loaded'}")
    for name, word in words.items():
        print(f"  {word:<10} /{name}")
    return 0
