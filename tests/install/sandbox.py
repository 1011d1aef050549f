"""A copy of this machine on which changes are made and looked at: an overlay of its root directory, in a mount namespace of its own.

Needs root and Debian 12 with the robot's packages; what is written goes to memory and disappears with the namespace.
"""

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

CHECKOUT = Path(__file__).parents[2]
# The shape of a BeagleBoard image's file, with an overlay that takes pads of ours.
UENV = "uname_r=5.10.168-ti-r72\nenable_uboot_overlays=1\nuboot_overlay_addr5=/lib/firmware/BB-EQEP0-00A0.dtbo\n"
PACKAGES = ("python3-numba", "python3-smbus2", "python3-yaml", "python3-serial", "python3-venv", "python3-setuptools", "python3-wheel",
            "device-tree-compiler", "cpp", "systemd")  # fmt: skip
SET_UP = """
mount -t tmpfs tmpfs "$1" && mkdir "$1/up" "$1/work" "$1/root"
mount -t overlay overlay -o "lowerdir=/,upperdir=$1/up,workdir=$1/work" "$1/root"
mount --rbind /proc "$1/root/proc" && mount --rbind /dev "$1/root/dev" && mount -t tmpfs tmpfs "$1/root/tmp" && mount -t tmpfs tmpfs "$1/root/run"
mkdir -p "$1/root$2" && mount --bind "$2" "$1/root$2" && mount -o remount,bind,ro "$1/root$2"
"""


def why_not() -> str:
    """Why there can be no sandbox here; empty where there can."""
    if os.geteuid() != 0:
        return "needs root"
    if shutil.which("dpkg-query") is None or 'VERSION_ID="12"' not in Path("/etc/os-release").read_text():
        return "this is not Debian 12"
    listed = subprocess.run(["dpkg-query", "-W", "-f", "${Package} ${db:Status-Status}\n", *PACKAGES], capture_output=True, text=True, check=False).stdout
    missing = [name for name in PACKAGES if f"{name} installed" not in listed.splitlines()]
    if missing:
        return f"not installed here: {', '.join(missing)}"
    if subprocess.run(["unshare", "--mount", "true"], capture_output=True, check=False).returncode != 0:
        return "mount namespaces are not allowed here"
    return ""


class Sandbox:
    """The overlay, as long as a process holds its namespace."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._holder = subprocess.Popen(["unshare", "--mount", "--propagation", "private", "sh", "-c", "echo ready; exec sleep 3600"], stdout=subprocess.PIPE)
        self._holder.stdout.readline()
        self._enter = ["nsenter", "--mount", f"--target={self._holder.pid}"]
        subprocess.run([*self._enter, "sh", "-ec", SET_UP, "sh", str(folder), str(CHECKOUT)], check=True)
        self.write("/boot/uEnv.txt", UENV)

    def run(self, *command, code=0, wrapped=()) -> str:
        """Output and messages of a command in there, which must end with this code."""
        result = subprocess.run(
            [*self._enter, *wrapped, "chroot", f"{self.folder}/root", "env", "-i", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "HOME=/nonexistent",
             *map(str, command)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        assert result.returncode == code, result.stdout
        return result.stdout

    def write(self, path: str, text: str) -> None:
        """A file in there."""
        subprocess.run([*self._enter, "sh", "-c", 'mkdir -p "${1%/*}" && cat >"$1"', "sh", f"{self.folder}/root{path}"], input=text, text=True, check=True)

    def read(self, path: str) -> str:
        """A file in there."""
        return self.run("cat", path)

    def changed(self) -> dict:
        """{path: what it is now, with mode and time} of everything that differs from the machine; folders only where they are new."""
        listing = subprocess.run(
            [*self._enter, "find", f"{self.folder}/up", "-mindepth", "1", "-printf", r"%P\t%y\t%m\t%U\t%T@\t%l\0"], capture_output=True, text=True, check=True
        ).stdout  # fmt: skip
        found = {}
        for line in listing.split("\0")[:-1]:
            path, kind, *rest = line.split("\t")
            if kind == "d" and Path("/", path).is_dir():
                continue
            content = subprocess.run([*self._enter, "cat", f"{self.folder}/up/{path}"], capture_output=True, check=True).stdout if kind == "f" else b""
            found[path] = (kind, *rest, hashlib.sha256(content).hexdigest())
        return found

    def close(self) -> None:
        """Ends the namespace, and with it everything in it."""
        self._holder.kill()
        self._holder.wait()
        self._holder.stdout.close()
