"""Finds InvenSense's DMP image in what a user holds: source trees and archives of librobotcontrol or MotionDriver 6.12, or a compiled library.

The image is found by its hash alone, so neither names of arrays nor symbols matter: in a file's bytes (a library has it in one piece,
at any alignment), and in the numbers that stand in a file's text (a C array, hexadecimal or decimal).
"""

import hashlib
import re
import tarfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

from mip_rt.config.published import DMP_SHA256
from mip_rt.hardware.mpu9250_registers import DMP_IMAGE_BYTES

WINDOW = 16
LARGEST = 64 << 20  # a file beyond this is not looked into
# Images of other programs, changed in advance; they hold other settings at places that this program relies on.
OTHERS = {
    "ae42d0be801847e53e77a96ca74961d3063a21f1c0006c556b13d0e305a3c1ec": "the image of i2cdevlib (MotionApps612), which is changed in 282 bytes",
    "9984e56726f313d2bc7329a1c5d84e91e5860261bb88376a46c9349045acb387": "the image of Simple_MPU6050, which is changed in 282 bytes",
}
_COMMENT = re.compile(rb"/\*.*?\*/|//[^\n]*", re.DOTALL)
_NUMBERS = re.compile(rb"(?:\b(?:0[xX][0-9a-fA-F]{1,2}|[0-9]{1,3})\b\s*(?:,\s*)?)+")
_NUMBER = re.compile(rb"0[xX][0-9a-fA-F]{1,2}|[0-9]{1,3}")


@dataclass(frozen=True)
class Identity:
    """What an image is known by: SHA-256 of all its bytes and of the first 16; the latter makes a search 50 times faster, "" does without."""

    sha256: str
    start_sha256: str = ""


DMP = Identity(DMP_SHA256, "9bbae3fd89744ef63aa9510c053ffdd4f6f704a543ea9a8e794b1ab0b0e28545")


def identity(sha256: str) -> Identity:
    """The identity of the configuration's hash."""
    return DMP if sha256 == DMP.sha256 else Identity(sha256)


def find_in_bytes(data: bytes, wanted: Identity) -> bytes | None:
    """The image where it lies in one piece in data."""
    digest = hashlib.sha256
    start = bytes.fromhex(wanted.start_sha256)
    view = memoryview(data)
    for at in range(len(data) - DMP_IMAGE_BYTES + 1):
        if start and digest(view[at : at + WINDOW]).digest() != start:
            continue
        found = data[at : at + DMP_IMAGE_BYTES]
        if digest(found).hexdigest() == wanted.sha256:
            return found
    return None


def number_lists(data: bytes):
    """Every list of at least 3062 numbers of a byte each that stands in a text, as bytes; comments between the numbers do not matter."""
    for run in _NUMBERS.finditer(_COMMENT.sub(b" ", data)):
        if run.end() - run.start() < 2 * DMP_IMAGE_BYTES:
            continue
        values = [int(text, 16 if text[:2].lower() == b"0x" else 10) for text in _NUMBER.findall(run.group())]
        if len(values) >= DMP_IMAGE_BYTES and max(values) < 256:
            yield bytes(values)


def find(data: bytes, wanted: Identity) -> tuple[bytes | None, str]:
    """(image, "") where data holds it, as bytes or as text; otherwise (None, a remark about another image that is there, or "")."""
    if b"\0" in data:
        return find_in_bytes(data, wanted), ""
    remark = ""
    for values in number_lists(data):
        image = find_in_bytes(values, wanted)
        if image is not None:
            return image, ""
        remark = OTHERS.get(hashlib.sha256(values).hexdigest(), remark)
    return None, remark


def contents(path: Path):
    """(name, reader of the bytes) of everything below a path: files, files of folders, members of zip and tar archives."""
    if path.is_dir():
        for entry in sorted(path.rglob("*")):
            if entry.is_file() and not entry.is_symlink():
                yield from contents(entry)
        return
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                if not member.is_dir() and member.file_size <= LARGEST:
                    yield f"{path}: {member.filename}", lambda archive=archive, member=member: archive.read(member)
        return
    if path.stat().st_size <= LARGEST and tarfile.is_tarfile(path):
        with tarfile.open(path) as archive:
            for member in archive:
                if member.isfile() and member.size <= LARGEST:
                    yield f"{path}: {member.name}", lambda archive=archive, member=member: archive.extractfile(member).read()
        return
    if DMP_IMAGE_BYTES <= path.stat().st_size <= LARGEST:
        yield str(path), path.read_bytes


def search(paths, wanted: Identity, watch=None):
    """(image, name of the file) of the first place that holds it, or (None, remarks).

    Args:
        paths: files, folders, archives.
        watch: callable(name), called before each file.

    Raises:
        OSError: a path cannot be read.
    """
    remarks = []
    for path in paths:
        for name, read in contents(Path(path)):
            if watch is not None:
                watch(name)
            image, remark = find(read(), wanted)
            if image is not None:
                return image, name
            if remark:
                remarks.append(f"{name} holds {remark}")
    return None, remarks
