"""`mip-rt dmp`: the image is found in sources, archives and compiled libraries; only ever with the generated stand-in."""

import hashlib
import io
import shutil
import subprocess
import tarfile
import time
import zipfile

import pytest

from mip_rt import cli
from mip_rt.fake.mpu9250 import stand_in_image, stand_in_sha256
from mip_rt.hardware import dmp_image
from mip_rt.hardware.dmp_image import Identity, find, search

IMAGE = stand_in_image()
WANTED = Identity(stand_in_sha256(), hashlib.sha256(IMAGE[:16]).hexdigest())


def listing(form, per_line=16, image=IMAGE):
    """A C source as the image's holders write it: comments between the banks, other numbers around."""
    lines = ["/* 1, 2, 3 */", "#define SIZE (3062)", "static const unsigned short sizes[4] = {1, 2, 3, 4};", "static const unsigned char dmp[SIZE] = {"]
    for at in range(0, len(image), per_line):
        if at % 256 == 0:
            lines.append(f"    /* bank # {at // 256}: 0x00, 1, 2 */")
        lines.append("    " + ", ".join(form(byte) for byte in image[at : at + per_line]) + ("," if at + per_line < len(image) else ""))
        lines[-1] += " // end of a line, 7, 8" if at % 1024 == 0 else ""
    return "\n".join([*lines, "};", "static const int more[] = { 300, 1 };", ""]).encode()


FORMS = {"hex": "0x{:02x}".format, "HEX": "0X{:X}".format, "decimal": "{:d}".format, "padded": "{:3d}".format}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("per_line", [1, 7, 16, 4000])
def test_found_in_sources(form, per_line):
    """Prevents dependence on how an array is written or called."""
    assert find(listing(FORMS[form], per_line), WANTED) == (IMAGE, "")


@pytest.mark.parametrize("before", [0, 1, 3, 4097])
def test_found_at_any_alignment_in_a_binary(before):
    """Prevents an assumption about alignment."""
    data = b"\0" * before + IMAGE + b"\x7f" * 99
    assert find(data, WANTED)[0] == IMAGE
    assert find(data, Identity(WANTED.sha256))[0] == IMAGE  # with another hash than the known one: slower, no less


def test_found_in_a_stripped_library(tmp_path):
    """Prevents reliance on a symbol: a library is stripped, and the compiler places the array."""
    if shutil.which("gcc") is None:
        pytest.skip("there is no compiler")
    source = listing(FORMS["hex"]).decode() + "int sum(int i) { return dmp[i] + more[i & 1] + sizes[i & 3]; }\n"
    (tmp_path / "a.c").write_text(source)
    subprocess.run(["gcc", "-O2", "-fPIC", "-shared", "-s", "-o", "lib.so", "a.c"], cwd=tmp_path, check=True)
    (tmp_path / "a.c").unlink()
    assert search([tmp_path], WANTED) == (IMAGE, str(tmp_path / "lib.so"))


def test_found_in_archives(tmp_path):
    """Prevents that a downloaded zip or tar must be unpacked first."""
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("README", "text " * 1000)
        archive.writestr("lib/dmp.h", listing(FORMS["hex"]))
    with tarfile.open(tmp_path / "a.tgz", "w:gz") as archive:
        member = tarfile.TarInfo("lib/dmp.h")
        content = listing(FORMS["hex"])
        member.size = len(content)
        archive.addfile(member, io.BytesIO(content))
    for name in ("a.zip", "a.tgz"):
        image, where = search([tmp_path / name], WANTED)
        assert image == IMAGE and where.endswith(f"{name}: lib/dmp.h")


@pytest.mark.parametrize("change", [lambda i: i[:-1], lambda i: i[:99] + bytes([i[99] ^ 1]) + i[100:], lambda i: i[1:] + i[:1]])
def test_a_changed_image_is_not_taken(tmp_path, change, monkeypatch):
    """Prevents a wrong image in the chip: one bit, one byte less, or another program's version are refused, the last by name."""
    image = change(IMAGE)
    assert find(listing(FORMS["hex"], image=image), WANTED)[0] is None and find(b"\0\0" + image, WANTED)[0] is None
    monkeypatch.setitem(dmp_image.OTHERS, hashlib.sha256(image).hexdigest(), "the image of somebody else")
    (tmp_path / "x.c").write_bytes(listing(FORMS["hex"], image=image))
    found, remarks = search([tmp_path], WANTED)
    assert found is None and (len(image) < 3062 or remarks == [f"{tmp_path / 'x.c'} holds the image of somebody else"])


def test_many_numbers_do_not_take_for_ever():
    """Prevents a search that hangs on a table of numbers: it is linear."""
    table = (b"1, 2, 3, 0x11, " * 200 + b"1000, ") * 300
    begin = time.process_time()
    assert find(table, WANTED) == (None, "")
    assert time.process_time() - begin < 5.0


# -- as a user -------------------------------------------------------------------------------------------------------
def dmp(tmp_path, *words, target="state/dmp.bin"):
    return cli.main(["dmp", *map(str, words), "--set", f"imu.dmp_image={tmp_path / target}", "--set", f"imu.dmp_image_sha256={stand_in_sha256()}"])


def test_extract_stores_and_verify_checks(tmp_path, capsys):
    """Prevents an image that is stored but not the right one, and one that went bad unnoticed."""
    (tmp_path / "dmp.h").write_bytes(listing(FORMS["hex"]))
    assert dmp(tmp_path, "verify") == 3 and "dmp_image_missing" in capsys.readouterr().err
    assert dmp(tmp_path, "extract", tmp_path / "dmp.h") == 0 and "dmp.h" in capsys.readouterr().out
    stored = tmp_path / "state/dmp.bin"
    assert stored.read_bytes() == IMAGE and stored.stat().st_mode & 0o777 == 0o644
    assert dmp(tmp_path, "verify") == 0
    stored.write_bytes(IMAGE[:-1] + b"\0")
    assert dmp(tmp_path, "verify") == 3 and "dmp_image_hash" in capsys.readouterr().err


@pytest.mark.parametrize("words", [(), ("/nowhere",), ("empty",)])
def test_refusals_say_what_to_do(tmp_path, capsys, words):
    """Prevents a user who does not know where to get the image, or that there is a way without it."""
    (tmp_path / "empty").mkdir()
    assert dmp(tmp_path, "extract", *(tmp_path / word for word in words)) == 3
    error = capsys.readouterr().err
    assert "cure" in error and (words != ("empty",) or ("dmp_image_not_found" in error and "imu.attitude: onboard" in error))


def test_a_place_that_cannot_be_written_is_said(tmp_path, capsys):
    """Prevents a traceback where the state folder belongs to root."""
    (tmp_path / "dmp.h").write_bytes(listing(FORMS["hex"]))
    (tmp_path / "state").write_text("a file, no folder")
    assert dmp(tmp_path, "extract", tmp_path / "dmp.h") == 3 and "dmp_image_write" in capsys.readouterr().err
