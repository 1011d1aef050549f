"""`mip-rt log plot`: the page shows what is in the rows, spikes and single ticks too, for any robot, without a network."""

import math
import re
import struct

import numpy as np
import pytest
from helpers import make_config
from hypothesis import given
from hypothesis import strategies as st

from mip_rt import cli, frame
from mip_rt.errors import LogError
from mip_rt.frame import LIMITS
from mip_rt.log import open as open_log
from mip_rt.log import page as paper
from mip_rt.log.decimation import decimated
from mip_rt.log.plot import build
from mip_rt.log.selection import seconds
from mip_rt.optional import PackageMissing
from mip_rt.supervisor import State

matplotlib = pytest.importorskip("matplotlib", reason="matplotlib draws the PNG; it is not installed")


def page_of(path, fields=None, mask=None):
    log = open_log(path)
    times_s = seconds(log)
    return build(log, times_s, np.ones(len(times_s), bool) if mask is None else mask(times_s), fields), log


def panel(page, title):
    return next(p for column in page.columns for p in column if p.title == title)


def line(page, title, label):
    return next(entry for entry in panel(page, title).lines if entry.label == label)


@given(st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=400), st.integers(1, 50))
def test_decimation_keeps_every_extreme(values, bins):
    """A spike of one tick in a minute is what one looks for."""
    values = np.array(values)
    times_s = np.arange(len(values)) * 0.005
    few_s, few = decimated(times_s, values, bins)
    assert len(few) <= 2 * bins + bins + 3 and (np.diff(few_s) >= 0.0).all()
    assert set(few[~np.isnan(few)]) <= set(values)
    if not np.isnan(values).all():
        assert np.nanmax(few) == np.nanmax(values) and np.nanmin(few) == np.nanmin(values)


def test_a_silence_interrupts_the_lines():
    """A straight line over a gap would be read as data."""
    times_s = np.concatenate((np.arange(100) * 0.005, 2.0 + np.arange(100) * 0.005))
    for bins in (20, 1000):
        few_s, few = decimated(times_s, np.ones(200), bins)
        assert np.isnan(few).sum() == 1 and 0.4 < few_s[np.flatnonzero(np.isnan(few))[0]] <= 2.1


def test_panels_show_the_log(fallen):
    page, log = page_of(fallen)
    frames = log.frames
    assert np.array_equal(line(page, "roll", "dmp_ekf").values, np.degrees(frames["estimates"][:, 0, 0]))
    assert np.array_equal(line(page, "roll", "kf").values, np.degrees(frames["estimates"][:, 2, 0]))
    assert np.allclose(line(page, "pitch", "attitude").values, np.degrees(frames["attitude_rad"][:, 1]))
    assert np.allclose(line(page, "pitch", "reference").values, np.degrees(frames["reference_lean_rad"][:, 1]))
    assert np.array_equal(line(page, "body command z", "applied").values, frames["command_applied"][:, 2])
    assert np.array_equal(line(page, "duty", "wheel 3").values, frames["duty"][:, 2])
    assert np.allclose(line(page, "position", "y").values, -3.2 * frames["estimates"][:, 0, 8])
    assert line(page, "wheel rate", "wheel 1").values is not None and panel(page, "battery").bounds == (make_config().battery.minimum_v,)
    assert all(p.unit for column in page.columns for p in column)
    assert "tipped at" in page.verdict[0] and page.faults[0][1] == "tipped"


def test_bands_cover_exactly_the_ticks_of_their_condition(fallen):
    page, log = page_of(fallen)
    times_s = seconds(log)
    bands = {band.label: band.spans for band in page.bands}
    for label, mask in (
        ("wheel_saturated", log.frames["limits"] & LIMITS["wheel_saturated"] != 0),
        ("state", log.frames["state"] == State.BALANCING),
    ):
        spans = [span for span in bands[label] if span[2] in (label, "BALANCING")]
        covered = np.zeros(len(times_s), bool)
        for begin, end, _, _ in spans:
            covered |= (times_s >= begin) & (times_s < end - 1e-9)
        assert spans and np.array_equal(covered, mask)


def test_the_default_window_is_around_the_last_fault(fallen, tmp_path, capsys, monkeypatch):
    shown = []
    monkeypatch.setattr("mip_rt.log.picture.write", lambda page, output: shown.append(page))
    fault_s = page_of(fallen)[0].faults[0][0]
    for arguments, begin, end in (([], fault_s - 3.0, fault_s + 1.0), (["--all"], 0.0, 10.995), (["--from", "2", "--to", "3"], 2.0, 3.0),
                                  (["--last", "1"], 10.0, 10.995)):  # fmt: skip
        assert cli.main(["log", "plot", str(fallen), "-o", str(tmp_path / "a.png"), *arguments]) == 0
        assert shown[-1].times_s[0] == pytest.approx(begin, abs=0.006) and shown[-1].times_s[-1] == pytest.approx(end, abs=0.006)
    assert "tipped at" in capsys.readouterr().err
    assert cli.main(["log", "plot", str(fallen), "--from", "50", "-o", str(tmp_path / "a.png")]) == 3 and "no row lies" in capsys.readouterr().err


def picture(path):
    """(height, width, 3 or 4) pixels of a PNG."""
    return (matplotlib.image.imread(path) * 255).astype(int)


def test_png(fallen, tmp_path, capsys):
    """The picture has the page's size, marks the fault, and its lines are where the data are."""
    import matplotlib.image  # noqa: F401

    path = tmp_path / "a.png"
    assert cli.main(["log", "plot", str(fallen), "-o", str(path)]) == 0 and capsys.readouterr().out.strip() == str(path)
    width, height = struct.unpack(">II", path.read_bytes()[16:24])
    assert width == 1650 and 1200 < height < 2400
    pixels = picture(path)[:, :, :3]
    vermillion = np.array([int(paper.VERMILLION[i : i + 2], 16) for i in (1, 3, 5)])
    marked = (np.abs(pixels - vermillion).max(axis=2) < 12)[height // 3 :]  # below the bands
    column = marked.sum(axis=0)
    # The fault is three quarters into the window, in both columns of panels.
    assert sum(column > 0.6 * len(marked)) in range(2, 9)
    positions = np.flatnonzero(column > 0.6 * len(marked)) / width
    assert abs(positions.min() - (0.115 + 0.75 * 0.403)) < 0.02


def test_html_needs_no_network_and_shows_the_same(fallen, tmp_path):
    pytest.importorskip("plotly", reason="plotly makes the interactive plot; it is not installed")
    from mip_rt.log.interactive import figure

    path = tmp_path / "a.html"
    assert cli.main(["log", "plot", str(fallen), "-o", str(path)]) == 0
    text = path.read_text()
    assert len(text) > 1_000_000 and "Plotly.newPlot" in text and "tipped" in text
    assert not re.search(r"<(script|link|img)[^>]*(src|href)\s*=", text)
    page, _ = page_of(fallen, mask=lambda t: (t > 6.0) & (t < 7.0))
    sheet = figure(page)
    duty = [trace for trace in sheet.data if trace.legendgroup == "duty"]
    assert [trace.name for trace in duty] == ["wheel 1", "wheel 2", "wheel 3"]
    assert np.array_equal(np.asarray(duty[1].y, float), line(page, "duty", "wheel 2").values)
    assert {a.text for a in sheet.layout.annotations} >= {"roll (deg)", "battery (V)", "ground speed (m/s)"}


def test_chosen_fields_by_index_element_and_estimator_name(fallen):
    page, log = page_of(fallen, "estimates[ekf].pitch_rad+attitude_rad[1],gyro_rad_s,battery_v")
    (column,) = page.columns
    assert [[entry.label for entry in p.lines] for p in column] == [
        ["estimates[1].pitch_rad", "attitude_rad[1]"], ["gyro_rad_s[0]", "gyro_rad_s[1]", "gyro_rad_s[2]"], ["battery_v"]]  # fmt: skip
    assert [p.unit for p in column] == ["rad", "rad/s", "V"]
    assert np.array_equal(column[0].lines[0].values, log.frames["estimates"][:, 1, 1])
    for wrong, hint in (("gyro_rad", "gyro_rad_s"), ("duty[7]", "duty"), ("estimates[0].roll", "estimates[0].roll_rad"), ("a b", "")):
        with pytest.raises(LogError, match="no field") as refused:
            page_of(fallen, wrong)
        assert hint in str(refused.value)


def field(name, shape=()):
    return frame.Field(name, "<f8", shape, "1", "of this test")


def test_the_robot_on_two_wheels(make_log, rows, tmp_path):
    """The eduMIP leans about its first axis, knows its way from phi + pitch, and compensates friction by wheel."""
    own = (field("reference_velocity_rad_s"), field("reference_angle_rad"), field("reference_yaw_rad", (2,)), field("reference_lean_rad"),
           field("command_feedback", (2,)), field("command_friction", (2,)), field("command_applied", (2,)))  # fmt: skip
    layout = frame.Layout(2, ("pitch_rad", "phi_rad", "yaw_rad", "pitch_rate_rad_s", "phi_rate_rad_s", "yaw_rate_rad_s"), own)
    frames = rows(300, layout)
    frames["estimates"][:, 0, 0], frames["estimates"][:, 0, 1] = 0.1, np.linspace(0.0, 1.0, 300)
    frames["reference_angle_rad"], frames["reference_lean_rad"], frames["attitude_rad"][:, 0] = 2.0, 0.2, 0.3
    path = make_log(frames, layout, "robot: edumip\nmodel: {wheel_radius_m: 0.035}\n")
    page, _ = page_of(path)
    assert [p.title for p in page.columns[0]] == ["lean, forward", "tilt, sideways", "yaw rate", "way", "ground speed", "latency"]
    right = [p.title for p in page.columns[1]]
    assert right == ["body command x (forward)", "body command z (left)", "friction compensation", "duty", "wheel rate", "battery"]
    assert line(page, "lean, forward", "attitude").values[0] == pytest.approx(math.degrees(0.3))
    assert line(page, "lean, forward", "one").values[0] == pytest.approx(math.degrees(0.1))
    assert line(page, "lean, forward", "reference").values[0] == pytest.approx(math.degrees(0.2))
    assert line(page, "way", "one").values[-1] == pytest.approx(3.5 * 1.1) and line(page, "way", "reference").values[0] == pytest.approx(7.0)
    assert cli.main(["log", "plot", str(path), "-o", str(tmp_path / "b.png")]) == 0


def test_a_robot_that_this_program_does_not_know(make_log, rows):
    """Its page has the panels that the common fields allow."""
    layout = frame.Layout(2, ("pitch_rad", "pitch_rate_rad_s"), (field("command_feedback", (2,)),))
    page, _ = page_of(make_log(rows(300, layout), layout))
    titles = [p.title for column in page.columns for p in column]
    assert titles == ["roll", "pitch", "yaw rate", "ground speed", "latency", "body command 1", "body command 2", "duty", "wheel rate", "battery"]
    assert [entry.label for entry in panel(page, "duty").lines] == ["wheel 1", "wheel 2"]
    assert [entry.label for entry in panel(page, "pitch").lines] == ["attitude", "two", "one"]


def test_rows_full_of_nan_are_no_reason_to_fail(make_log, rows, tmp_path):
    """Of all logs, those of a run that went wrong must be shown."""
    frames = rows(50)
    for name in frames.dtype.names:
        if frames[name].dtype.kind == "f":
            frames[name] = np.nan
    frames["remote_age_s"] = np.inf
    assert cli.main(["log", "plot", str(make_log(frames, name="many")), "-o", str(tmp_path / "c.png")]) == 0
    assert cli.main(["log", "plot", str(make_log(frames[:1], name="one")), "--fields", "limits,gains", "-o", str(tmp_path / "d.png")]) == 0


def test_refusals(fallen, tmp_path, capsys, monkeypatch):
    assert cli.main(["log", "plot", str(fallen), "-o", "a.pdf"]) == 3 and "cannot be written as" in capsys.readouterr().err
    assert cli.main(["log", "plot", str(fallen), "--fields", "tick", "-o", str(tmp_path / "no" / "a.png")]) == 3
    assert "cannot be written" in capsys.readouterr().err
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(PackageMissing, match="mip-rt"):
        panels_to_png(fallen, tmp_path)


def panels_to_png(path, folder):
    from mip_rt.log.picture import write

    write(page_of(path)[0], folder / "a.png")
