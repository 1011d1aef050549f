"""Files put under a driver's descriptor: several at a time, taken away in any order, and never under somebody else's."""

import itertools
import os

import pytest

from mip_rt.fake.descriptors import READS_FAIL, opened, replace

MODES = (os.O_RDONLY,)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "in_voltage0_raw"
    path.write_text("42\n")
    return path


def reads(fd):
    try:
        return os.pread(fd, 8, 0)
    except OSError:
        return None


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_overlapping_errors_end_with_the_last_of_them(file, order):
    before = set(os.listdir("/proc/self/fd"))
    fd = os.open(file, os.O_RDONLY)
    restores = []
    for _ in range(3):
        assert opened(file, MODES) == [fd]
        restores.append(replace(opened(file, MODES), READS_FAIL, os.O_RDONLY))
        assert reads(fd) is None
    for k, which in enumerate(order):
        restores[which]()
        assert reads(fd) == (b"42\n" if k == 2 else None)
    os.close(fd)
    assert set(os.listdir("/proc/self/fd")) == before


def test_a_descriptor_that_the_driver_has_closed_is_left_alone(file, tmp_path):
    fd = os.open(file, os.O_RDONLY)
    restore = replace([fd], READS_FAIL, os.O_RDONLY)
    os.close(fd)
    other = os.open(tmp_path, os.O_RDONLY | os.O_DIRECTORY)
    assert other == fd and opened(file, MODES) == []
    restore()
    assert os.path.samestat(os.fstat(other), os.stat(tmp_path))
    os.close(other)
