"""What the loop calls as ready machine code: numbers in and out, errors, files, and a start without numba."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mip_rt import compiled, machine_code
from mip_rt.compiled import JIT_DISABLED, direct, entry, span

pytestmark = pytest.mark.skipif(JIT_DISABLED, reason="no machine code")
POINT = np.dtype([("x", "f8"), ("count", "i8")], align=True)


@entry("int64", "float64", "uint64")
def combined(a, b, c):
    """All three can be seen in the result."""
    return a * 1.0 + 2.0 * b + 4.0 * (c >> np.uint64(63))


@entry("int64")
def same(a):
    """An integer."""
    return a


@entry("float64", "float64")
def less(a, b):
    """A boolean."""
    return a < b


@entry(POINT, np.dtype("f8"), "int64")
def scale(points, factors, index):
    """Nothing is returned."""
    points[index].x *= factors[index]
    points[index].count += 1


@entry("int64")
def allocating(n):
    """Needs numba's memory."""
    return np.zeros(n).sum()


@pytest.mark.armhf
@given(st.integers(-(1 << 63), (1 << 63) - 1), st.floats(-1e6, 1e6), st.integers(0, (1 << 64) - 1), st.floats(), st.floats())
def test_numbers_pass(a, b, c, x, y):
    assert direct_combined(a, b, c) == a * 1.0 + 2.0 * b + 4.0 * (c >> 63)
    assert direct_same(a) == a and direct_same(-1) == -1
    assert direct_less(x, y) is (x < y)


if not JIT_DISABLED:
    direct_combined, direct_same, direct_less = direct(combined), direct(same), direct(less)


@pytest.mark.armhf
def test_what_is_no_such_number_is_refused_and_the_next_call_works():
    for wrong in ((), (1,), (1, 1.0), (1, 1.0, 1, 1), ("1", 1.0, 1), (1, "1", 1), (1, 1.0, None), (1.5, 1.0, 1), (1, 1.0, np.uint64(1))):
        with pytest.raises(TypeError):
            direct_combined(*wrong)
    for wrong in ((1 << 63, 1.0, 1), (1, 1.0, 1 << 64), (1, 1.0, -1)):
        with pytest.raises(OverflowError):
            direct_combined(*wrong)
    assert direct_combined(-1, -1.0, 0) == -3.0 and math.isnan(direct_combined(0, math.nan, 0))
    assert direct_combined(np.int64(1), np.float64(1.0), 1 << 63) == 7.0 and direct_combined(True, 1, 0) == 3.0


@pytest.mark.armhf
def test_arrays_pass_as_address_and_length():
    points, factors = np.zeros(3, POINT), np.array([1.0, 2.0, 3.0])
    points["x"] = 5.0
    call, before = direct(scale), sys.getrefcount(None)
    for _ in range(100):
        assert call(*span(points), *span(factors), 1) is None
    assert points["x"].tolist() == [5.0, 5.0 * 2.0**100, 5.0] and points["count"].tolist() == [0, 100, 0]
    assert abs(sys.getrefcount(None) - before) < 50


def test_code_that_allocates_is_refused_when_it_is_compiled():
    with pytest.raises(RuntimeError, match="allocating cannot be kept as machine code: it calls .*NRT"):
        compiled.machine_code.function("allocating", ("int64",), None, lambda: (allocating.dispatcher, ["int64"]))


@pytest.mark.armhf
def test_a_damaged_file_is_made_anew(tmp_path):
    made = []

    def function():
        def build():
            made.append(1)
            return same.dispatcher, ["int64"]

        return machine_code.function("same", ("int64",), tmp_path, build)

    assert function()(7) == 7 and function()(8) == 8 and len(made) == 1
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    for damaged in (b"", whole[:3], whole[: len(whole) // 2], whole[:99] + bytes([whole[99] ^ 1]) + whole[100:]):
        file.write_bytes(damaged)
        made.clear()
        assert function()(9) == 9 and len(made) == 1 and file.read_bytes() == whole


def test_without_a_folder_to_write_to_everything_works(tmp_path):
    file = tmp_path / "no-folder"
    file.write_text("")
    function = machine_code.function("same", ("int64",), file, lambda: (same.dispatcher, ["int64"]))
    assert function(3) == 3 and machine_code.function("same", ("int64",), None, lambda: (same.dispatcher, ["int64"]))(4) == 4


FORBID = """
import sys
class Forbid:
    def find_spec(self, name, path, target=None):
        assert name != "numba.core", "numba is imported"
if "--forbid" in sys.argv:
    sys.argv.remove("--forbid")
    sys.meta_path.insert(0, Forbid())
from mip_rt import cli
code = cli.main(sys.argv[1:])
sys.exit(code)
"""


def run(cache, *arguments):
    environment = {**os.environ, "MIP_RT_CACHE": str(cache)}
    return subprocess.run([sys.executable, "-c", FORBID, *arguments], check=True, capture_output=True, text=True, timeout=900, env=environment)


@pytest.mark.parametrize("robot", ["mbbr", "edumip"])
def test_a_second_start_does_not_import_numba(robot, tmp_path):
    arguments = ("--dry-run", "--robot", robot, "--speed", "max", "--duration", "3", "--json", "--log", str(tmp_path))
    folder = compiled.CACHE_FOLDER.parent if compiled.CACHE_FOLDER else tmp_path
    first, second = run(folder, *arguments), run(folder, *arguments, "--forbid")
    assert '"fell": false' in second.stdout and first.stdout.split('"log"')[0] == second.stdout.split('"log"')[0]


@pytest.mark.slow
@pytest.mark.robot_packages
def test_after_warm_up_nothing_that_the_robot_needs_is_missing(tmp_path):
    """Everything that is not simulated is in the cache: a start then keeps only what the fakes need."""
    assert "kept in" in run(tmp_path, "warm-up").stdout
    (folder,) = tmp_path.glob("numba-*")
    kept = {file.name for file in folder.glob("*.code")}
    for robot in ("mbbr", "edumip"):
        run(tmp_path, "--dry-run", "--robot", robot, "--speed", "max", "--duration", "1", "--json", "--log", str(tmp_path))
    added = {file.name for file in folder.glob("*.code")} - kept
    assert len(kept) >= 14 and added and all(name.startswith("mip_rt.fake.") for name in added)
