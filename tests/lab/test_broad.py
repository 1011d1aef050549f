"""The onboard attitude on real recordings, where they are; and that the score is what it claims."""

import numpy as np
import pytest

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


def test_a_worse_filter_does_not_pass():
    good = {name: {"onboard": error - 0.1, "uncompensated": error, "vqf": error} for name, error in broad.VQF.items()}
    assert broad.passed(good)
    good["07"]["onboard"] = 1.03
    assert not broad.passed(good)
