"""The 4joy decoder: splits, slips, garbage, all axis values; and the command with its dead-man."""

import math
from pathlib import Path

import pytest
from helpers import make_config
from hypothesis import given
from hypothesis import strategies as st

from mip_rt.remote.command import RemoteCommand
from mip_rt.remote.fourjoy import BUTTONS, LONGEST, FourJoyDecoder, axis, frame

CORPUS = Path(__file__).parent / "corpus"
STICK = st.floats(-1, 1)
FRAMES = st.lists(st.tuples(STICK, STICK, st.sampled_from([0, *BUTTONS.values()]), st.sampled_from([0, 2, 4])), min_size=4, max_size=30)


def stream(frames):
    return b"".join(frame(*entry) for entry in frames)


def test_axis_is_monotone_in_signed_order_and_bounded():
    ordered = [axis(value & 0xFF) for value in range(-128, 128)]
    assert ordered == sorted(ordered) and min(ordered) == -1.0 and max(ordered) == 1.0
    assert axis(128) == -1.0 and axis(0) == 0.0


def test_forward_and_right_are_positive():
    decoder = FourJoyDecoder()
    decoder.feed(frame(0.5, 0.25) * 2)
    assert decoder.x == pytest.approx(0.5, abs=0.005) and decoder.y == pytest.approx(0.25, abs=0.005)


def test_stick_is_limited_to_the_unit_circle():
    decoder = FourJoyDecoder()
    decoder.feed(frame(1.0, 1.0) * 2)
    assert math.hypot(decoder.x, decoder.y) == pytest.approx(1.0)


@given(FRAMES, st.data())
def test_any_split_gives_the_same_frames(frames, data):
    whole = stream(frames)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(whole)), max_size=10)))
    decoder = FourJoyDecoder()
    found = sum(decoder.feed(whole[a:b]) for a, b in zip([0, *cuts], [*cuts, len(whole)]))
    assert found == len(frames) and decoder.dropped_bytes == 0
    assert decoder.buttons == frames[-1][2] and decoder.start_select == frames[-1][3]


@given(st.binary(max_size=600))
def test_garbage_never_raises_and_stays_within_range(garbage):
    decoder = FourJoyDecoder()
    decoder.feed(garbage)
    assert math.hypot(decoder.x, decoder.y) <= 1.0 + 1e-12
    assert decoder.buttons <= 15 and len(decoder._data) <= LONGEST


@given(st.floats(0.2, 1), st.floats(0.2, 1), st.integers(0, 6), st.booleans(), st.integers(6, 255))
def test_a_slipped_byte_costs_at_most_three_frames(x, y, at, insert, noise):
    """After a lock, one byte is lost or added; with a deflected stick the phase is found again within three frames."""
    decoder = FourJoyDecoder()
    one = frame(x, y)
    decoder.feed(one * 5)
    damaged = one[:at] + (bytes([noise]) + one[at:] if insert else one[at + 1 :])
    decoder.feed(damaged)
    before = decoder.frames
    decoder.feed(one * 5)
    assert decoder.frames >= before + 2
    assert decoder.y == pytest.approx(y, abs=0.3)


def test_lock_needs_two_frames():
    decoder = FourJoyDecoder()
    assert decoder.feed(frame(0, 0)) == 0 and decoder.feed(frame(0, 0)) == 2


@pytest.mark.parametrize("file", sorted(CORPUS.glob("*.bin")), ids=lambda file: file.stem)
def test_corpus(file):
    decoder = FourJoyDecoder()
    data = file.read_bytes()
    for at in range(0, len(data), 5):
        decoder.feed(data[at : at + 5])
    assert decoder.frames <= len(data) // 7
    found = decoder.feed(frame(0.0, 1.0) * 4)
    assert found >= 2 and decoder.y == 1.0


def test_corpus_is_there():
    assert len(list(CORPUS.glob("*.bin"))) >= 4


class Port:
    def __init__(self):
        self.data = b""

    def read(self):
        data, self.data = self.data, b""
        return data


def command():
    port = Port()
    return port, RemoteCommand(port, FourJoyDecoder(), make_config().remote)


def test_stick_and_button_become_velocity_and_spin():
    port, remote = command()
    port.data = frame(0.0, 1.0, BUTTONS["circle"]) * 2
    remote.receive(1_000)
    remote.update(1_000)
    assert remote.command == pytest.approx((0.25, 0.0, 2 * math.pi))
    port.data = frame(-1.0, 0.0, BUTTONS["circle"] | BUTTONS["cross"])
    remote.receive(2_000)
    remote.update(2_000)
    assert remote.command[1] == pytest.approx(0.25)  # stick to the left
    assert remote.command[2] == 0.0  # two buttons mean no spin


def test_dead_man_ramps_to_zero_by_the_age_of_the_last_valid_frame():
    port, remote = command()
    port.data = frame(0.0, 1.0) * 2
    remote.receive(0)
    samples = []
    for ms in range(0, 600, 5):
        port.data = b"\x55"  # the link is open and noisy, but nothing valid comes
        remote.receive(ms * 1_000_000)
        remote.update(ms * 1_000_000)
        samples.append((ms, remote.command[0]))
    assert [v for ms, v in samples if ms <= 300] == pytest.approx([0.25] * 61)
    falling = [v for ms, v in samples if ms > 300]
    assert falling == sorted(falling, reverse=True)
    assert max(abs(a - b) for a, b in zip(falling, falling[1:])) < 0.02
    assert all(v == 0.0 for ms, v in samples if ms >= 460) and not remote.alive and remote.losses == 1


def test_heading_reset_comes_once_per_press():
    port, remote = command()
    port.data = frame(0, 0, 0, 2) * 3
    remote.receive(0)
    assert remote.heading_reset() and not remote.heading_reset()
    port.data = frame(0, 0, 0, 2)
    remote.receive(1)
    assert not remote.heading_reset()


def test_without_remote_nothing_is_lost_and_nothing_moves():
    remote = RemoteCommand(None, FourJoyDecoder(), make_config().remote)
    remote.receive(10**12)
    remote.update(10**12)
    assert remote.alive and remote.centred
