"""The onboard attitude on real recordings, where they are; and that the score is what it claims."""

import json

import numpy as np
import pytest

from mip_rt import cli
from mip_rt.lab import broad

FOLDER = next((folder for folder in (broad.FOLDER, *(parent / "shared/data/broad" for parent in broad.Path(__file__).parents)) if folder.is_dir()), None)


@pytest.mark.skipif(FOLDER is None, reason=f"no recordings of BROAD in {broad.FOLDER}")
def test_at_most_the_error_of_vqf_on_each_recording():
    """A filter that was tuned on the simulated robots alone."""
    result = broad.run(FOLDER)
    assert broad.passed(result), broad.render(result)
    assert all(trial["uncompensated"] <= trial["vqf"] for trial in result.values())


def test_heading_does_not_count_and_tilt_does():
    half = np.radians(10.0) / 2
    level, turned = np.array([[1.0, 0, 0, 0]]), np.array([[np.cos(0.7), 0, 0, np.sin(0.7)]])
    leaning = np.array([[np.cos(half), np.sin(half), 0, 0]])
    assert broad.inclination_error_deg(level, turned) == pytest.approx(0.0, abs=1e-5)
    assert broad.inclination_error_deg(level, leaning) == pytest.approx(10.0)
    assert np.isnan(broad.inclination_error_deg(np.full((1, 4), np.nan), level)).all()


def test_missing_and_wrong_recordings_are_named(tmp_path):
    with pytest.raises(broad.RecordingsMissing, match="no recordings") as caught:
        broad.run(tmp_path)
    assert "--data" in caught.value.cure
    np.savez(tmp_path / "x.npz", gyro=np.zeros(3))
    with pytest.raises(broad.RecordingsMissing, match="x.npz"):
        broad.run(tmp_path)


def test_both_verbs_print_the_table_and_tell_by_their_exit_code(tmp_path, capsys):
    """A recording of standing still that shows no lean; one whose truth leans by 10 degrees; and JSON."""
    still = {"gyro": np.zeros((600, 3)), "accel": np.tile([0.0, 0.0, 9.81], (600, 1)), "movement": np.ones(600, bool), "rate_hz": 300.0}
    leaning = [np.cos(np.radians(5.0)), np.sin(np.radians(5.0)), 0.0, 0.0]
    for name, truth, code in (("02_level", [1.0, 0.0, 0.0, 0.0], 0), ("07_leaning", leaning, 1)):
        np.savez(tmp_path / f"{name}.npz", quaternion=np.tile(truth, (600, 1)), **still)
        for verb in ("reproduce", "bench"):
            assert cli.main([verb, "broad", "--data", str(tmp_path)]) == code
            assert f"| {name} | {0.0 if code == 0 else 10.0:.3f} |" in capsys.readouterr().out
    assert cli.main(["reproduce", "broad", "--json", "--data", str(tmp_path)]) == 1
    assert json.loads(capsys.readouterr().out)["07_leaning"]["onboard"] == pytest.approx(10.0, abs=0.01)


def test_a_worse_filter_does_not_pass():
    good = {name: {"onboard": error - 0.1, "uncompensated": error, "vqf": error} for name, error in broad.VQF.items()}
    assert broad.passed(good)
    good["07"]["onboard"] = 1.03
    assert not broad.passed(good)
