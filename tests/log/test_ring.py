"""The ring: self-describing, ordered, torn rows recognised, damage reported."""

import lzma
import subprocess
from pathlib import Path

import numpy as np
import pytest

from mip_rt.errors import LogError
from mip_rt.log import open as open_log
from mip_rt.log.ring import Ring, header
from mip_rt.log.ring_reader import VERSION_1
from mip_rt.robots.mbbr_frame import FRAME, LAYOUT

pytestmark = pytest.mark.armhf


def filled(path, ticks, rows=16):
    ring = Ring(path, FRAME, rows, header(LAYOUT, "robot: mbbr\n", {"seed": 5}))
    for tick in range(ticks):
        index = tick % rows
        ring.begin(index)
        ring.rows["tick"][index] = tick
        ring.rows["battery_v"][index] = tick * 0.5
        ring.commit(index, tick)
    ring.close()
    return ring


@pytest.mark.parametrize("ticks", [0, 1, 15, 16, 17, 100])
def test_rows_come_back_in_order(tmp_path, ticks):
    filled(tmp_path / "a.ring", ticks)
    log = open_log(tmp_path / "a.ring")
    assert list(log.frames["tick"]) == list(range(max(0, ticks - 16), ticks))
    assert log.damage == [] and log.config == "robot: mbbr\n" and log.header["seed"] == 5


def test_log_describes_itself(tmp_path):
    filled(tmp_path / "a.ring", 1)
    log = open_log(tmp_path / "a.ring")
    fields = {f["name"]: f for f in log.header["fields"]}
    assert fields["battery_v"]["unit"] == "V" and set(fields) == set(FRAME.names)
    assert log.frames.dtype == FRAME and len(log.header["source_hash"]) == 16


def test_a_row_being_written_is_left_out(tmp_path):
    ring = filled(tmp_path / "a.ring", 10)
    ring.begin(3)
    ring.rows["tick"][3] = 19
    assert 3 not in list(open_log(tmp_path / "a.ring").frames["tick"]) and len(open_log(tmp_path / "a.ring").frames) == 9


def test_a_row_that_lies_about_its_tick_is_damage(tmp_path):
    ring = filled(tmp_path / "a.ring", 10)
    ring.rows["tick"][4] = 99
    log = open_log(tmp_path / "a.ring")
    assert 99 not in log.frames["tick"] and len(log.damage) == 1


def test_truncation_anywhere_loses_only_what_was_cut(tmp_path):
    filled(tmp_path / "a.ring", 16)
    data = (tmp_path / "a.ring").read_bytes()
    cut = tmp_path / "cut.ring"
    for length in np.linspace(0, len(data), 60).astype(int):
        cut.write_bytes(data[:length])
        try:
            log = open_log(cut)
        except LogError:
            continue
        assert set(log.frames["tick"]) <= set(range(16))
        assert (log.frames["battery_v"] == log.frames["tick"] * 0.5).all()
        assert log.damage or length == len(data)
    assert list(log.frames["tick"]) == list(range(16))  # the last length is the whole file


def state(tick):
    return np.full(40, tick % 251, np.uint8), np.full(13, tick % 13, np.uint8)


def test_kept_states_come_back_whole_and_only_whole(tmp_path):
    """A replay that starts from a half-written state would report differences that never were."""
    ring = Ring(tmp_path / "a.ring", FRAME, 16, header(LAYOUT, ""), state_bytes=53, state_rows=4)
    for tick in range(0, 1200, 200):
        ring.keep_state(tick, state(tick))
    log = open_log(tmp_path / "a.ring")
    assert log.states == {tick: b"".join(map(bytes, state(tick))) for tick in (400, 600, 800, 1000)} and log.damage == []
    assert log.header["state_bytes"] == 53
    for wrong in (state(1200)[:1], (*state(1200), state(1200)[0])):
        with pytest.raises(ValueError, match="53 bytes"):
            ring.keep_state(1200, wrong)
        assert set(open_log(tmp_path / "a.ring").states) == {600, 800, 1000}
    ring.close()
    assert set(open_log(tmp_path / "a.ring").states) == {600, 800, 1000}


def test_not_a_log(tmp_path):
    for content in (b"", b"hello" * 100, bytes(5000)):
        (tmp_path / "x").write_bytes(content)
        with pytest.raises(LogError, match="not a mip-rt log"):
            open_log(tmp_path / "x")
    for missing in (tmp_path / "none", tmp_path):
        with pytest.raises(LogError, match="cannot be read|no log in"):
            open_log(missing)
    (tmp_path / "x").write_bytes(VERSION_1.pack(b"MIPRTLOG", 99, 0, 0, 0, 0))
    with pytest.raises(LogError, match="version 99"):
        open_log(tmp_path / "x")
    (tmp_path / "x").write_bytes(VERSION_1.pack(b"MIPRTLOG", 1, 4, 0, 4096, 0) + b"null")
    with pytest.raises(LogError, match="damaged"):
        open_log(tmp_path / "x")


@pytest.mark.parametrize("version", [1, 2])
def test_log_without_header_is_empty_and_says_so(tmp_path, version):
    """The remains of a log are not an error of the user's."""
    (tmp_path / "x").write_bytes(VERSION_1.pack(b"MIPRTLOG", version, 9000, 0, 16384, 0) + b"{" + bytes(3000))
    log = open_log(tmp_path / "x")
    assert len(log.frames) == 0 and {"tick", "state", "edge_ns"} <= set(log.frames.dtype.names)
    assert log.header == {} and log.config == "" and "nothing can be read" in log.damage[0]


@pytest.mark.parametrize("content", [b"", bytes(100_000)])
def test_file_whose_content_never_reached_the_disk_is_an_empty_log(tmp_path, content):
    """What a power cut right after the start leaves behind; the ring of the same folder is then what there is."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "00000001.miplog").write_bytes(content)
    for path in (tmp_path / "run" / "00000001.miplog", tmp_path / "run", tmp_path):
        log = open_log(path)
        assert len(log.frames) == 0 and log.damage
    filled(tmp_path / "a.ring", 5)
    assert len(open_log(tmp_path).frames) == 5


def test_damaged_header_is_replaced_by_its_copy(tmp_path):
    """One bad sector at the start must not cost the whole log."""
    filled(tmp_path / "a.ring", 16)
    whole = open_log(tmp_path / "a.ring")
    data = bytearray((tmp_path / "a.ring").read_bytes())
    data[:4096] = bytes(4096)
    (tmp_path / "a.ring").write_bytes(data)
    log = open_log(tmp_path / "a.ring")
    assert log.frames.tobytes() == whole.frames.tobytes() and log.header == whole.header
    assert log.damage == ["the header is damaged, its copy at the end was used"]


def test_flipped_bit_in_a_closed_ring_is_found(tmp_path):
    """A row that differs from what was written is left out and named; whoever wants it all the same (replay) gets it."""
    filled(tmp_path / "a.ring", 16)
    whole = open_log(tmp_path / "a.ring")
    at = (tmp_path / "a.ring").read_bytes().index(whole.frames[7].tobytes()) + LAYOUT.offset["battery_v"]
    with (tmp_path / "a.ring").open("r+b") as file:
        file.seek(at)
        file.write(b"\x01")
    log = open_log(tmp_path / "a.ring")
    assert list(log.frames["tick"]) == [0, 1, 2, 3, 4, 5, 6, *range(8, 16)] and log.damage == ["the row of tick 7 does not match its checksum"]
    unchecked = open_log(tmp_path / "a.ring", check=False)
    assert list(unchecked.frames["tick"]) == list(range(16)) and unchecked.damage == log.damage


def test_ring_of_a_running_loop_is_not_damaged(tmp_path):
    """Seals of the previous run of the same slot must not be taken for this row's."""
    ring = filled(tmp_path / "a.ring", 20)
    for tick in range(20, 30):
        ring.begin(tick % 16)
        ring.rows["tick"][tick % 16] = tick
        ring.commit(tick % 16, tick)
    log = open_log(tmp_path / "a.ring")
    assert list(log.frames["tick"]) == list(range(14, 30)) and log.damage == []


def test_log_of_version_1_is_read(tmp_path):
    """Logs outlive programs: this one was written by the first program that had a log, 60 ticks of a dry run."""
    data = lzma.decompress((Path(__file__).parent / "samples" / "version-1.ring.xz").read_bytes())
    (tmp_path / "old.ring").write_bytes(data)
    log = open_log(tmp_path / "old.ring")
    assert list(log.frames["tick"]) == list(range(len(log.frames))) and len(log.frames) == 60 and log.damage == []
    assert log.header["log_version"] == 1 and log.header["state_bytes"] == 0 and log.states == {} and "body_mass_kg" in log.config
    assert np.allclose(np.diff(log.frames["edge_ns"]), 5e6) and 7.0 < log.frames["battery_v"][-1] < 9.0
    for length in range(40, len(data), 4999):
        (tmp_path / "cut.ring").write_bytes(data[:length])
        cut = open_log(tmp_path / "cut.ring")
        assert cut.damage and cut.frames.tobytes() == log.frames[: len(cut.frames)].tobytes()


def test_unwritable_folder_is_a_refusal():
    with pytest.raises(LogError, match="cannot be created"):
        Ring(Path("/proc/nowhere/a.ring"), FRAME, 4, {})


def test_a_full_file_system_is_a_refusal_not_a_crash(tmp_path):
    """A sparse file would take the loop down by SIGBUS at its first row."""
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "mip-rt-test", str(tmp_path)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no right to mount a small file system")
    try:
        with pytest.raises(LogError, match="No space left"):
            Ring(tmp_path / "a.ring", FRAME, 2000, header(LAYOUT, ""))
        assert not list(tmp_path.iterdir())
        Ring(tmp_path / "b.ring", FRAME, 4, header(LAYOUT, "")).close()
    finally:
        subprocess.run(["umount", "-l", str(tmp_path)], check=True)


def test_every_field_has_unit_and_meaning():
    for field in LAYOUT.fields:
        assert field.unit and field.meaning, field.name
    assert len({f.name for f in LAYOUT.fields}) == len(LAYOUT.fields)
