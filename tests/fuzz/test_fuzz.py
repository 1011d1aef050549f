"""A few thousand fuzzed inputs for every parser, the kept corpus, and what hypothesis thinks of. A million: see drive.py."""

import pytest
from drive import corpus, drive
from hypothesis import given
from hypothesis import strategies as st
from targets import TARGETS

COUNTS = {"config": 300, "scenario": 500, "serial": 1500, "packet": 5000, "log": 3000, "sysfs_text": 3000}
WORD = st.sampled_from(["at_s", "fault", "i2c_nack", "press", "arm", "set", "for_s", "events", "description", "duration_s", "probability", "wheel", "x"])
SCALAR = st.one_of(WORD, st.integers(), st.floats(), st.booleans(), st.none(), st.text(max_size=8))
TREE = st.recursive(SCALAR, lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(WORD, inner, max_size=5)), max_leaves=20)


@pytest.mark.parametrize("target", TARGETS)
def test_kept_inputs(target):
    kept = corpus(target)
    assert len(kept) >= 4
    for data in kept:
        TARGETS[target](data)


@pytest.mark.parametrize("target", TARGETS)
def test_mutated_inputs(target):
    """No exception but the documented, no command that is not finite, no false frame after lock."""
    assert set(COUNTS) == set(TARGETS)
    assert drive(target, COUNTS[target], 7) > 1000


@given(st.data())
def test_any_structure_is_no_scenario_or_one_that_is_written_back(data):
    import yaml

    events = st.lists(st.one_of(TREE, st.dictionaries(WORD, SCALAR, max_size=5)), max_size=4)
    tree = data.draw(st.one_of(TREE, st.fixed_dictionaries({"events": events})))
    TARGETS["scenario"](yaml.safe_dump(tree).encode())


@given(st.integers(0, 255), st.binary(min_size=6, max_size=6), st.binary(max_size=200))
def test_any_fifo_gives_finite_commands(first, head, fifo):
    TARGETS["packet"](bytes([first]) + head + fifo)


@given(st.one_of(st.binary(max_size=80), st.integers().map(lambda value: f"{value}\n".encode()), st.text(max_size=30).map(str.encode)))
def test_any_text_of_sysfs_is_a_count_or_none(text):
    TARGETS["sysfs_text"](text)


@given(st.data())
def test_any_cut_and_any_changed_bytes_of_a_log(data):
    whole = bytearray(data.draw(st.sampled_from(corpus("log"))))
    for at, value in data.draw(st.lists(st.tuples(st.integers(0, len(whole) - 1), st.integers(0, 255)), max_size=6)):
        whole[at] = value
    TARGETS["log"](bytes(whole[: data.draw(st.integers(0, len(whole)))]))


@given(st.binary(max_size=400))
def test_any_bytes_of_a_remote(data):
    TARGETS["serial"](data)


def test_a_broken_parser_is_noticed_and_its_input_kept(monkeypatch, tmp_path):
    """The driver itself: what a target raises comes out, with the input."""
    import drive as driver
    import targets

    def broken(data):
        assert len(data) < 100

    monkeypatch.setitem(targets.TARGETS, "serial", broken)
    monkeypatch.setattr(driver, "CORPUS", tmp_path)
    with pytest.raises(AssertionError):
        driver.drive("serial", 1000, 1)
    (kept,) = (tmp_path / "serial").iterdir()
    assert len(kept.read_bytes()) >= 100
