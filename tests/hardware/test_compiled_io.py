"""Counters and pulses through compiled system calls: what Python would have read and written, and nothing else."""

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mip_rt.hardware import compiled_io

ROW = np.dtype([("duty_ns", "<i8", (3,)), ("applied_ns", "<i8", (3,))], align=True)


def rows():
    made = np.zeros(1, ROW)
    return made.view(np.recarray) if compiled_io.JIT_DISABLED else made


def record(dtype, fds, **values):
    made = np.zeros(1, dtype)
    made["number"], made["fd"][0, : len(fds)] = len(fds), fds
    for name, value in values.items():
        made[name] = value
    return made.view(np.recarray) if compiled_io.JIT_DISABLED else made


@pytest.fixture
def files(tmp_path):
    paths = [tmp_path / str(i) for i in range(3)]
    for path in paths:
        path.write_text("0\n")
    fds = [os.open(path, os.O_RDWR) for path in paths]
    yield paths, fds
    for fd in fds:
        os.close(fd)


@pytest.mark.parametrize(
    ("texts", "counts"),
    [
        (("5\n", "-7\n", "0\n"), (5, -7, 0)),
        (("4294967295\n", "2147483647\n", "-2147483648\n"), (-1, 2147483647, -2147483648)),
        (("12", "34\n", "\n"), (12, 34, 0)),  # without newline is whole; empty is an error and keeps the last count
    ],
)
def test_counters_are_read_and_unwrapped(files, texts, counts):
    paths, fds = files
    counters = record(compiled_io.COUNTERS, fds)
    for path, text in zip(paths, texts):
        path.write_text(text)
    compiled_io.read_all(counters[0])
    assert tuple(counters["count"][0, :3]) == counts
    assert list(counters["errors"][0, :3]) == [0, 0, int(texts[2] == "\n")]


@pytest.mark.parametrize("text", ["", "garbage\n", "12x\n", "-\n", "9" * 23, "\0\0\0\n"])
def test_nonsense_keeps_the_last_count_and_is_counted(files, text):
    paths, fds = files
    counters = record(compiled_io.COUNTERS, fds)
    paths[1].write_text("77\n")
    compiled_io.read_all(counters[0])
    paths[1].write_text(text)
    compiled_io.read_all(counters[0])
    assert counters["count"][0, 1] == 77
    assert counters["errors"][0, 1] == 1 and counters["failing"][0, 1] == 1


def test_a_closed_descriptor_is_an_error_not_a_crash(files):
    counters, pulses, made = record(compiled_io.COUNTERS, [-1]), record(compiled_io.PULSES, [-1], period_ns=50000, sign=1), rows()
    compiled_io.read_all(counters[0])
    made["duty_ns"][0, 0] = 5
    assert counters["errors"][0, 0] == 1 and compiled_io.write_pulses(pulses, made, 0) == compiled_io.REFUSED


@given(st.lists(st.integers(-(10**6), 10**6), min_size=1, max_size=20))
def test_any_course_of_a_counter_is_followed(tmp_path_factory, steps):
    path = tmp_path_factory.mktemp("counter") / "count"
    path.write_text("0\n")
    fd = os.open(path, os.O_RDONLY)
    counters, total = record(compiled_io.COUNTERS, [fd]), 0
    for step in steps:
        total += step * 1000
        path.write_text(f"{total % (1 << 32)}\n")
        compiled_io.read_all(counters[0])
        assert counters["count"][0, 0] == total
    os.close(fd)


def test_pulses_are_written_when_they_change_and_after_a_turn(files, monkeypatch):
    paths, fds = files
    pulses, made = record(compiled_io.PULSES, fds, period_ns=50000, written_ns=-1, sign=1), rows()
    made["duty_ns"][0] = 1234, -5, 0
    assert compiled_io.write_pulses(pulses, made, 0) == 0b010  # the second must turn; its pulse was taken away
    assert [path.read_text() for path in paths] == ["1234\n", "0\n", "0\n"] and not made["applied_ns"].any()
    pulses["sign"][0, 1] = -1
    assert compiled_io.write_pulses(pulses, made, 0) == 0
    assert paths[1].read_text() == "5\n" and list(made["applied_ns"][0]) == [1234, -5, 0]
    paths[0].write_text("unchanged pulses are not written\n")
    assert compiled_io.write_pulses(pulses, made, 0) == 0
    assert paths[0].read_text() == "unchanged pulses are not written\n"
    made["duty_ns"][0, 0] = 10**9  # beyond the period
    assert compiled_io.write_pulses(pulses, made, 0) == 0
    assert paths[0].read_text().startswith("50000\n")
