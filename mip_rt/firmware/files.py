"""Changes of system files: planned as a whole, shown as a diff, written one by one so that a power cut leaves the old or the new file."""

import difflib
import hashlib
from dataclasses import dataclass
from pathlib import Path

from mip_rt.atomic_file import replace_file
from mip_rt.errors import MipRtError
from mip_rt.firmware import uenv
from mip_rt.firmware.overlay import FirmwareError, compiled, pinctrl_cells, source_folder

UENV = "boot/uEnv.txt"
BACKUP = "boot/uEnv.txt.before-mip-rt"
OVERLAYS = "lib/firmware"
COPIED = {"90-mip-rt.rules": "etc/udev/rules.d/90-mip-rt.rules", "mip-rt.conf": "etc/modprobe.d/mip-rt.conf"}


@dataclass(frozen=True)
class Change:
    """One file: content now and then; None where there is none.

    Attributes:
        name: path below the root.
    """

    name: str
    before: bytes | None
    after: bytes | None

    @property
    def needed(self) -> bool:
        """Now and then differ."""
        return self.before != self.after

    def diff(self) -> str:
        """As `diff -u` shows it; a binary file by its length and hash."""
        sides = [content or b"" for content in (self.before, self.after)]
        names = [f"/{self.name}" if content is not None else "/dev/null" for content in (self.before, self.after)]
        if any(b"\0" in side for side in sides):
            words = [f"{len(side)} bytes, SHA-256 {hashlib.sha256(side).hexdigest()[:16]}..." if side else "nothing" for side in sides]
            return f"--- {names[0]}: {words[0]}\n+++ {names[1]}: {words[1]}\n"
        texts = [side.decode(errors="replace").splitlines(keepends=True) for side in sides]
        return "".join(line if line.endswith("\n") else line + "\n" for line in difflib.unified_diff(*texts, *names))


def _content(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None


def _change(kernel, name: str, after: bytes | None) -> Change:
    return Change(name, _content(kernel.path(name)), after)


def _uenv(kernel) -> str:
    content = _content(kernel.path(UENV))
    if content is None:
        raise FirmwareError(
            f"there is no {kernel.path(UENV)}.", "This works with BeagleBoard images, whose U-Boot reads it; see README for others.", "uenv_missing"
        )
    return content.decode("utf-8", "surrogateescape")


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def _our_overlays(kernel, but: str = "") -> list[Change]:
    folder = kernel.path(OVERLAYS)
    found = sorted(path.name for path in folder.glob("mip-rt-*.dtbo")) if folder.is_dir() else []
    return [_change(kernel, f"{OVERLAYS}/{name}", None) for name in found if name != but]


def plan(kernel, board) -> list[Change]:
    """What applying changes, in the order of writing: U-Boot's file comes last, when all that it names is there.

    Raises:
        FirmwareError: no uEnv.txt; the overlay cannot be compiled.
        MipRtError: no free slot.
    """
    file = f"{board.overlay}.dtbo"
    before = _uenv(kernel)
    after = uenv.added(before, board, f"/{OVERLAYS}/{file}")
    changes = [_change(kernel, f"{OVERLAYS}/{file}", compiled(board.overlay, pinctrl_cells(kernel)))]
    changes += [_change(kernel, name, (source_folder() / source).read_bytes()) for source, name in COPIED.items()]
    if _content(kernel.path(BACKUP)) is None and before != after:
        changes.append(_change(kernel, BACKUP, _bytes(before)))
    changes.append(_change(kernel, UENV, _bytes(after)))
    return changes + _our_overlays(kernel, file)


def plan_back(kernel) -> list[Change]:
    """What taking back changes: first U-Boot's file, then what it named. The copy of the first uEnv.txt stays."""
    changes = []
    if _content(kernel.path(UENV)) is not None:
        changes.append(_change(kernel, UENV, _bytes(uenv.removed(_uenv(kernel)))))
    return changes + _our_overlays(kernel) + [_change(kernel, name, None) for name in COPIED.values()]


def carry_out(kernel, changes) -> list[Change]:
    """Writes what is needed; returns that.

    Raises:
        MipRtError: a file cannot be written; those before it are.
    """
    done = []
    for change in changes:
        if not change.needed:
            continue
        path = kernel.path(change.name)
        try:
            if change.after is None:
                path.unlink()
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                replace_file(path, change.after)
        except OSError as error:
            raise MipRtError(f"{path} cannot be changed: {error.strerror}.", "Run it with sudo.", "firmware_write") from error
        done.append(change)
    return done
