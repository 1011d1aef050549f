"""`mip-rt log spectrum`: lines at their frequency and amplitude, none in noise, the rollers' at the configured factor."""

import json
import math

import numpy as np
import pytest

from mip_rt import cli
from mip_rt.log import open as open_log
from mip_rt.log.codes import Codes
from mip_rt.log.spectrum import balancing, roller_hz, spectra, strongest
from mip_rt.supervisor import State

pytest.importorskip("scipy", reason="scipy computes spectra; it is not installed")
CONFIG = "robot: mbbr\nrealtime: {rate_hz: 200.0}\nmodel: {ball_radius_m: 0.032}\ndry_run: {rollers_per_ball_turn: 6.26}\n"


@pytest.fixture
def driving(make_log, rows):
    """Callable: log of a robot that drives at 0.2 m/s, with a signal in gyro_rad_s[0]."""

    def make(signal, seconds=20.0, speed_m_s=0.2):
        n = round(seconds * 200)
        frames = rows(n)
        frames["state"], frames["request"] = State.BALANCING, 1
        frames["estimates"][:, 0, 6] = 0.6 * speed_m_s / 0.032
        frames["estimates"][:, 0, 7] = -0.8 * speed_m_s / 0.032
        frames["gyro_rad_s"][:, 0] = signal(np.arange(n) * 0.005)
        return open_log(make_log(frames, config=CONFIG))

    return make


def noise(seed, level=0.1):
    return lambda t: level * np.random.default_rng(seed).standard_normal(len(t))


def test_a_line_is_found_at_its_frequency_and_amplitude(driving):
    log = driving(lambda t: 0.3 * np.sin(2 * math.pi * 12.34 * t) + 0.05 * np.sin(2 * math.pi * 40.0 * t) + noise(1)(t))
    first, second = spectra(log, log.frames, "gyro_rad_s[0]")["fields"]["gyro_rad_s[0]"]["lines"][:2]
    assert first["hz"] == pytest.approx(12.34, abs=0.1) and first["amplitude"] == pytest.approx(0.3, rel=0.1)
    assert first["rad_s"] == pytest.approx(2 * math.pi * first["hz"], abs=0.05) and not first["is_roller"]
    assert second["hz"] == pytest.approx(40.0, abs=0.1) and second["amplitude"] == pytest.approx(0.05, rel=0.35)


@pytest.mark.parametrize(("seconds", "segments"), [(2.0, 5), (20.0, 9)])
def test_noise_has_no_lines(seconds, segments):
    """A mean of few segments is uneven: its bumps must not be sold as vibrations."""
    from scipy.signal import welch

    t, found = np.arange(round(seconds * 200)), 0
    for seed in range(100):
        found += len(strongest(*welch(noise(seed)(t), 200.0, "hann", 2 * len(t) // (segments + 1)), segments))
    assert found <= 8, found  # in 100 spectra; one by the chosen chance, more since halves of segments and neighbouring bins are not independent


def test_a_slope_is_no_line(driving):
    log = driving(lambda t: np.cumsum(np.cumsum(noise(3)(t))) * 1e-3)
    assert len(spectra(log, log.frames, "gyro_rad_s[0]")["fields"]["gyro_rad_s[0]"]["lines"]) <= 1


def test_the_rollers_line_of_the_dissertation(driving):
    """At the configured factor, 39.1 rad/s at 0.2 m/s, and in proportion to the speed."""
    for speed in (0.1, 0.2, 0.4):
        log = driving(lambda t, s=speed: 0.2 * np.sin(39.1 * s / 0.2 * t) + noise(2)(t), speed_m_s=speed)
        found = spectra(log, log.frames, "gyro_rad_s[0]")
        assert 2 * math.pi * found["roller_hz"][1] == pytest.approx(39.1 * speed / 0.2, rel=2e-3)
        assert found["ball_speed_m_s"] == pytest.approx(speed)
        first = found["fields"]["gyro_rad_s[0]"]["lines"][0]
        assert first["is_roller"] and first["rad_s"] == pytest.approx(39.1 * speed / 0.2, abs=0.7)
    assert roller_hz(log, [0.0, 0.001, 0.3]) is None


def test_only_the_longest_balancing_part_is_taken(driving):
    log = driving(noise(1))
    frames = log.frames.copy()
    frames["state"][:1000], frames["request"][1000:1010] = State.DISARMED, 0
    frames = np.delete(frames, 1500)
    assert (balancing(frames, Codes({}))["tick"][0], balancing(frames, Codes({}))["tick"][-1]) == (1501, 3999)
    frames["state"] = State.FAULT
    with pytest.raises(Exception, match="does not balance"):
        balancing(frames, Codes({}))


def test_the_simulated_rollers_show_in_a_dry_run(tmp_path, capsys):
    """The whole way: a robot that drives straight at 0.2 m/s; its accelerometer feels the rollers."""
    pytest.importorskip("matplotlib", reason="matplotlib draws the PNG; it is not installed")
    from helpers import DryRun, make_config

    with DryRun(tmp_path, make_config(log__ring_s="20"), "drive") as dry:
        dry.run(8.9)
        path = dry.session.ring.path
    picture = tmp_path / "s.png"
    assert cli.main(["log", "spectrum", str(path), "--from", "5.5", "--json", "-o", str(picture)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert 30.0 < 2 * math.pi * found["roller_hz"][1] < 50.0 and "ball_speed_m_s" in found["fields"]
    assert any(line["is_roller"] for line in found["fields"]["acceleration_m_s2[1]"]["lines"][:1])
    assert picture.stat().st_size > 20_000
    assert cli.main(["log", "spectrum", str(path), "--from", "5.5"]) == 0
    assert "<- rollers" in capsys.readouterr().out


def test_holes_and_constants_do_not_spoil_a_spectrum(driving):
    log = driving(lambda t: 0.3 * np.sin(2 * math.pi * 20.0 * t) + noise(1, 0.01)(t))
    frames = log.frames.copy()
    frames["gyro_rad_s"][100:103, 0] = np.nan
    frames["gyro_rad_s"][:, 1], frames["gyro_rad_s"][:, 2] = np.nan, 5.0
    found = spectra(log, frames, "gyro_rad_s")["fields"]
    assert found["gyro_rad_s[0]"]["lines"][0]["hz"] == pytest.approx(20.0, abs=0.1)
    assert "gyro_rad_s[1]" not in found and found["gyro_rad_s[2]"]["lines"] == []


def test_refusals(fallen, capsys):
    for arguments, words in (
        (["-o", "a.pdf"], "cannot be plotted"),
        (["--fields", "giro"], "no field"),
        (["--from", "8", "--to", "8.1", "--all"], "too few"),
        (["--from", "10"], "does not balance"),
    ):
        assert cli.main(["log", "spectrum", str(fallen), *arguments]) == 3 and words in capsys.readouterr().err
