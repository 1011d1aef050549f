"""What a log survives, in small; `mip-rt bench log-damage` does the same in full."""

import pytest

from mip_rt.lab import log_damage


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    folder = tmp_path_factory.mktemp("samples")
    return dict(zip(("ring", "recorded"), log_damage.sample(folder, 3.0)))


@pytest.mark.parametrize("kind", ["ring", "recorded"])
def test_cut_anywhere(samples, kind):
    """A power cut ends a file anywhere: nothing before the cut is lost, nothing is invented, nothing raises."""
    result = log_damage.cut(samples[kind], 500, 1)
    assert result == {"count": 500, "raised": 0, "invented": 0, "worst": 0}


@pytest.mark.parametrize(("kind", "most"), [("ring", 1), ("recorded", log_damage.ONE_SECOND)])
def test_any_flipped_bit(samples, kind, most):
    """Bad memory and bad cards: one bit costs one row of a ring, one block of a recorded file, and never changes a number unseen."""
    result = log_damage.flip(samples[kind], 500, 2)
    assert result["raised"] == result["invented"] == 0 and result["worst"] <= most


@pytest.mark.slow
def test_killed_at_any_moment(tmp_path):
    """kill -9 of the loop, the recorder or both: at most the last second is missing on disk, and nothing was invented."""
    verdicts = log_damage.kill(9, 3, together=3)
    assert len(verdicts) == 9
    for verdict in verdicts:
        assert verdict["invented"] == 0 and verdict["ring_lost"] == 0 and verdict["lost"] <= log_damage.ONE_SECOND, verdict
        if verdict["victim"] == "loop":
            assert verdict["lost"] == 0, verdict
