"""No tracked file holds InvenSense's image, raw or as text; the scanner is shown to find a planted one."""

import base64
import hashlib
import re
import subprocess
from pathlib import Path

import mip_rt
from mip_rt.fake.mpu9250 import stand_in_image

FIRST_16 = "9bbae3fd89744ef63aa9510c053ffdd4f6f704a543ea9a8e794b1ab0b0e28545"
ROOT = Path(mip_rt.__file__).parents[1]
BYTE_LIST = re.compile(rb"(?:0[xX][0-9a-fA-F]{1,2}\s*,\s*){15,}")
HEX_RUN = re.compile(rb"[0-9a-fA-F]{32,}")
BASE64_RUN = re.compile(rb"[A-Za-z0-9+/]{24,}={0,2}")


def holds(data: bytes, wanted: str) -> bool:
    """True where some 16-byte window of data has this SHA-256."""
    return any(hashlib.sha256(data[i : i + 16]).hexdigest() == wanted for i in range(len(data) - 15))


def readings(data: bytes):
    """The bytes themselves, and what their text could mean as lists of bytes, hexadecimal or base64."""
    yield data
    for match in BYTE_LIST.finditer(data):
        yield bytes(int(value, 16) for value in re.findall(rb"0[xX]([0-9a-fA-F]{1,2})", match.group()))
    for match in HEX_RUN.finditer(data):
        text = match.group()
        yield bytes.fromhex(text[: len(text) // 2 * 2].decode())
    for match in BASE64_RUN.finditer(data):
        text = match.group().rstrip(b"=")
        yield base64.b64decode(text[: len(text) // 4 * 4])


def tracked_files():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode == 0:
        return [ROOT / name for name in listed.stdout.decode().split("\0") if name]
    return [path for path in ROOT.rglob("*") if path.is_file() and not {".git", ".venv", "__pycache__"} & set(path.parts)]


def test_no_tracked_file_holds_the_image():
    files = [path for path in tracked_files() if path.is_file()]
    assert len(files) > 50
    guilty = [str(path) for path in files for data in readings(path.read_bytes()) if holds(data, FIRST_16)]
    assert guilty == []


def test_the_scanner_finds_a_planted_image():
    image = stand_in_image()
    wanted = hashlib.sha256(image[:16]).hexdigest()
    disguises = [
        b"padding" + image,
        ("{" + ", ".join(f"0x{byte:02x}" for byte in image[:64]) + "}").encode(),
        image[:64].hex().encode(),
        base64.b64encode(image[:96]),
    ]
    for disguise in disguises:
        assert any(holds(data, wanted) for data in readings(disguise))
