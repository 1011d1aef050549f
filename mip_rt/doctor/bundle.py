"""A file for support: the report, the configuration, and what the system says; bounded, and without names, addresses and serial numbers.

A command that fails is evidence, too: its exit code and words are kept.
"""

import getpass
import io
import ipaddress
import json
import pwd
import re
import socket
import tarfile
import time

MOST_BYTES = 65536  # of each part; its end is kept
COMMANDS = {
    "kernel": ("uname", "-srvm"),
    "release": ("cat", "/etc/os-release"),
    "cpu": ("cat", "/proc/cpuinfo"),
    "modules": ("lsmod",),
    "messages": ("dmesg",),
    "u-boot": ("cat", "/boot/uEnv.txt"),
    "service": ("systemctl", "status", "--no-pager", "--full", "mip-rt.service"),
    "journal": ("journalctl", "--no-pager", "--unit", "mip-rt.service", "--lines", "400"),
    "packages": ("dpkg-query", "--show", "python3-numba", "python3-llvmlite", "python3-numpy", "python3-smbus2"),
    "disk": ("df", "-h"),
    "memory": ("free", "-m"),
    "devices": ("ls", "-l", "/dev/i2c-2", "/dev/gpiochip0", "/dev/gpiochip1", "/dev/gpiochip2", "/dev/gpiochip3", "/dev/ttyS5"),
    "overlays": ("ls", "/proc/device-tree/chosen/overlays"),
    "interrupts": ("cat", "/proc/interrupts"),
}
# Every repetition is bounded, or begins at a boundary: a part may be one word of 64 kB.
_PATTERNS = (
    (re.compile(r"\b(?:[0-9a-f]{2}[:-]){5}[0-9a-f]{2}\b", re.I), "<hardware address>"),
    (re.compile(r"\b\d{1,3}(?:\.\d{1,3}){3}(?:/\d{1,2})?\b"), "<network address>"),
    (re.compile(r"\b[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}\b", re.I), "<identifier>"),
    (re.compile(r"\b[0-9a-f]{32}\b", re.I), "<identifier>"),
    (re.compile(r"(serial(?:[ _-]?(?:number|no))?[ \t]*[:=#]?[ \t]*)(?=\S{0,40}\d)[0-9a-z-]{6,}", re.I), r"\1<serial number>"),
    (re.compile(r"(ssid[ \t]*[:=]?[ \t]*)\S+", re.I), r"\1<network>"),
    (re.compile(r"(/home/)[^/\s:]+"), r"\1<user>"),
    (re.compile(r"(?<![\w.+-])[\w.+-]{1,64}@[\w-]{1,64}\.[\w.-]{1,64}"), "<mail address>"),
)

_COLONS = re.compile(r"(?<![\w:.])[0-9a-f:]{3,45}(?![\w:])", re.I)  # perhaps an IPv6 address, perhaps a time of day


def _network_address(found) -> str:
    try:
        ipaddress.IPv6Address(found[0])
    except ValueError:
        return found[0]
    return "<network address>"


def names_here() -> dict:
    """{name on this machine: what stands for it}: host and users."""
    found = {socket.gethostname(): "<host>", socket.gethostname().partition(".")[0]: "<host>"}
    try:
        found[getpass.getuser()] = "<user>"
    except (KeyError, OSError):
        pass  # a user without a name
    for entry in pwd.getpwall():
        if 1000 <= entry.pw_uid < 60000:
            found[entry.pw_name] = "<user>"
            real = entry.pw_gecos.partition(",")[0]
            if len(real) > 2:
                found[real] = "<user>"
    return {name: stands for name, stands in found.items() if name and name not in ("root", "mip-rt", "localhost")}


def redact(text: str, names: dict) -> str:
    """Without host and user names, addresses, serial numbers and other identifiers."""
    for pattern, stands in _PATTERNS:
        text = pattern.sub(stands, text)
    text = _COLONS.sub(_network_address, text)
    for name in sorted(names, key=len, reverse=True):
        text = re.sub(rf"(?<![\w]){re.escape(name)}(?![\w])", names[name], text)
    return text


def write(path, report, patient) -> int:
    """Writes the bundle (tar.gz); returns its size in bytes.

    Raises:
        OSError: it cannot be written.
    """
    names = names_here()
    parts = {"report.json": json.dumps(report.as_dict(), indent=1), "configuration.yaml": patient.config.to_yaml()}
    for name, words in COMMANDS.items():
        code, text = patient.kernel.command(*words)
        parts[f"{name}.txt"] = f"$ {' '.join(words)}\nexit code {code}\n{text[-MOST_BYTES:]}"
    with tarfile.open(path, "w:gz") as archive:
        for name, text in parts.items():
            data = redact(text, names).encode()[-MOST_BYTES:]
            entry = tarfile.TarInfo(f"mip-rt-doctor/{name}")
            entry.size, entry.mtime = len(data), int(time.time())
            archive.addfile(entry, io.BytesIO(data))
    return path.stat().st_size
