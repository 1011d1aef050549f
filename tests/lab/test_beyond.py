"""The comparison beyond the papers: draws repeat, margins are those of the worst draw, and one robot is enough to see who is better."""

import copy

import pytest

from mip_rt import config as configuration
from mip_rt.lab import beyond

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found():
    patch = pytest.MonkeyPatch()
    patch.setattr(beyond, "DURATION_S", 14.0)
    patch.setattr(beyond, "ALONE_S", 14.0)
    errors = beyond.follow((3, 1.0))
    alone = beyond.alone((3, beyond.ALONE[0]))
    patch.undo()
    return errors, alone


def test_every_setting_of_a_draw_is_a_key_and_draws_repeat_and_differ():
    drawn = [beyond.draw(index) for index in (0, 0, 1)]
    assert drawn[0] == drawn[1] != drawn[2]
    config = configuration.load(configuration.default_path("mbbr"), drawn[2])
    assert all(getattr(config.dry_run.model_error, name) in (0.9, 1.1) for name in ("mass", "inertia", "com_height", "friction", "motor"))
    assert sum(value**2 for value in config.dry_run.input_error) <= 0.01


def test_ours_is_better_than_all_that_ship_and_all_candidates_saw_the_robot(found):
    errors, alone = found
    assert set(errors) == {beyond.OURS, *beyond.SHIPPED, *beyond.CANDIDATES}
    for name in beyond.SHIPPED:
        assert errors[beyond.OURS][0] < errors[name][0] and errors[beyond.OURS][1] < 0.49 * errors[name][1]
    # No candidate is broken: each knows the ball's rate, of 6 rad/s, better than the papers' EKF does.
    assert all(errors[name][1] < errors["ekf_printed"][1] for name in beyond.CANDIDATES)
    assert not alone["fell"] and alone["yaw_rate_hz"] > 1.8


def test_passes_only_with_its_margins():
    good = {"margins": {0.0: (0.5, 0.2), 1.0: (0.99, 0.7)}, "alone": {"2 Hz": {"fell": 0}}}
    assert beyond.passed(good)
    for change in (("margins", 1.0, (1.01, 0.2)), ("margins", 1.0, (0.5, 0.71)), ("alone", "2 Hz", {"fell": 1})):
        bad = copy.deepcopy(good)
        bad[change[0]][change[1]] = change[2]
        assert not beyond.passed(bad)
