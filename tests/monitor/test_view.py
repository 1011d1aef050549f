"""What the monitor says is what the rows say."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt import log
from mip_rt.config.scenario import Event, Scenario
from mip_rt.monitor import pose
from mip_rt.monitor.source import Source
from mip_rt.monitor.view import HISTOGRAM_US, HISTORY_S, View
from mip_rt.supervisor import State

ROOT = Path(__file__).parents[2]


def strict(shown):
    """What a browser's JSON parser takes: no NaN, no infinity."""
    return json.loads(json.dumps(shown, allow_nan=False))


@pytest.fixture(scope="module")
def fallen(tmp_path_factory):
    """A run that calibrates, arms at 2 s, drives at 4 s, and whose battery is gone at 5 s: it falls."""
    events = ({"at_s": 2.0, "press": "arm"}, {"at_s": 4.0, "speed_m_s": [0.2, 0.0], "yaw_rate_hz": 0.0}, {"at_s": 5.0, "set": {"battery_v": 3.0}})
    folder = tmp_path_factory.mktemp("fallen")
    with DryRun(folder, scenario=Scenario("fallen", "", 10.0, [Event(**event) for event in events])) as dry:
        dry.run(8.0)
    return log.open(dry.session.ring.path)


def view_until(run, time_s):
    """A view that saw the run up to this time, in the portions of a live stream."""
    view = View(run.header, run.frames.dtype)
    for begin in range(0, round(time_s * 200), 7):
        view.take(run.frames[begin : min(begin + 7, round(time_s * 200))])
    return view


def test_states_and_what_to_do_next(fallen):
    """A user must always read what the robot waits for."""
    calibrating = strict(view_until(fallen, 0.8).show())
    assert calibrating["state"] == "CALIBRATING" and "still" in calibrating["hint"]
    assert {check["code"] for check in calibrating["why_not_armed"]} >= {"calibrating"}
    assert all(check["sentence"] and check["cure"] and check["blocks"] for check in calibrating["why_not_armed"])
    states = fallen.frames["state"]
    arming, balancing_since = (int(np.argmax(states == state)) / 200 for state in (State.ARMING, State.BALANCING))
    ready = strict(view_until(fallen, arming).show())
    assert ready["state"] == "DISARMED" and ready["why_not_armed"] == [] and "arm button" in ready["hint"]
    balancing = strict(view_until(fallen, 4.8).show())
    assert balancing["state"] == "BALANCING" and balancing["hint"] == "" and balancing["motors_on"]
    assert balancing["velocity_command_m_s"][0] == pytest.approx(0.2, abs=0.003) and balancing["fault"] is None
    assert balancing["state_s"] == pytest.approx(4.8 - balancing_since, abs=0.06)


def test_a_fall_is_told_with_cause_and_cure(fallen):
    shown = strict(view_until(fallen, 8.0).show())
    assert shown["state"] == "FAULT" and shown["fault"]["code"] == "tipped" and shown["fault"]["active"] and shown["fault"]["cure"]
    fell_at = fallen.frames["tick"][np.argmax(fallen.frames["state"] == State.FAULT)] / 200
    assert shown["fault"]["ago_s"] == pytest.approx(shown["time_s"] - fell_at, abs=0.06)
    limits = {entry["name"]: entry for entry in shown["limits"]}
    assert limits["tipped"]["now"] and limits["tipped"]["ago_s"] == 0.0
    assert limits["battery_unknown"]["now"] and all(entry["sentence"] for entry in limits.values())
    # A limit that is over stays in the list for ten seconds, with its age.
    saturated = np.flatnonzero(fallen.frames["limits"] & 1 << 5)
    assert not limits["wheel_saturated"]["now"]
    assert limits["wheel_saturated"]["ago_s"] == pytest.approx((len(fallen.frames) - 1 - saturated[-1]) / 200, abs=0.06)
    assert [entry["ago_s"] for entry in shown["limits"]] == sorted(entry["ago_s"] for entry in shown["limits"])


def test_numbers_are_those_of_the_rows(fallen):
    """Latency, rate and tilt are derived in portions; they must equal the same over the whole window."""
    view = view_until(fallen, 4.8)
    rows = fallen.frames[: round(4.8 * 200)]
    shown = view.show()
    assert shown["rate_hz"] == 200.0 and shown["missed"] == 0 and shown["tick"] == rows["tick"][-1]
    assert shown["time_s"] == pytest.approx(rows["tick"][-1] / 200)
    tilt = np.hypot(rows["estimates"][:, 0, 0], rows["estimates"][:, 0, 1])
    assert shown["tilt_rad"] == pytest.approx(tilt[-1], abs=1e-5) and shown["tilt_max_rad"] == pytest.approx(tilt.max(), abs=1e-5)
    assert np.array_equal(view.tilt_history_rad(), tilt)
    radius = make_config().model.ball_radius_m
    assert shown["position_m"] == pytest.approx([radius * rows["estimates"][-1, 0, 9], -radius * rows["estimates"][-1, 0, 8]], abs=1e-5)


def test_latencies_of_the_last_ten_seconds(fallen):
    """A late tick shows for ten seconds, then no more; the histogram counts every tick once, the late ones too."""
    rows = np.concatenate([fallen.frames[:200]] * 15)
    rows["edge_ns"] = 10_000_000_000 + 5_000_000 * np.arange(len(rows))
    for offset, name in ((50, "wake_ns"), (80, "read_ns"), (90, "step_ns"), (100, "write_ns")):
        rows[name] = rows["edge_ns"] + 1000 * offset
    rows["write_ns"][5] += 3_000_000
    view = View(fallen.header, rows.dtype)
    view.take(rows[:1500])
    shown = view.latency_us()
    assert shown["edge_to_write"] == {"p50": 100.0, "p99": 100.0, "max": 3100.0} and shown["read"]["p50"] == 30.0 and shown["write"]["max"] == 3010.0
    counts = view.histograms()["edge_to_write"]
    assert sum(counts) == 1500 and counts[np.searchsorted(HISTOGRAM_US, 3100.0, "right") - 1] == 1
    view.take(rows[1500:])
    assert view.latency_us()["edge_to_write"]["max"] == 100.0 and sum(view.histograms()["wake"]) == HISTORY_S * 200


def test_missed_ticks_do_not_make_the_rate_look_low(fallen):
    rows = fallen.frames[:400].copy()
    rows["edge_ns"][200:] += 3 * 5_000_000
    rows["missed"][200] = 3
    view = View(fallen.header, rows.dtype)
    view.take(rows)
    shown = view.show()
    assert shown["rate_hz"] == 200.0 and shown["missed"] == 3


def test_a_number_that_is_none_does_not_break_the_json(fallen):
    """A remote never heard is infinitely old, a battery may be NaN: browsers refuse both."""
    rows = fallen.frames[:50].copy()
    rows["remote_age_s"], rows["battery_v"], rows["estimates"] = math.inf, math.nan, math.nan
    view = View(fallen.header, rows.dtype)
    view.take(rows)
    shown = strict(view.show())
    assert shown["remote_age_s"] is None and shown["battery_v"] is None and shown["attitude_rad"] == [None, None, None]


def test_a_log_with_states_faults_and_checks_of_another_version(fallen):
    """A monitor may be older than the loop, and a loop older than the monitor."""
    rows = fallen.frames[-50:].copy()
    rows["state"], rows["fault"], rows["limits"] = 77, 99, 1 << 60
    view = View(fallen.header, rows.dtype)
    view.take(rows)
    shown = strict(view.show())
    assert shown["state"] == "state 77" and shown["fault"]["code"] == "fault 99" and [entry["name"] for entry in shown["limits"]] == ["bit 60"]
    without = [name for name in rows.dtype.names if name != "refusals"]
    old = np.zeros(5, [(name, rows.dtype.fields[name][0]) for name in without])
    view = View(fallen.header, old.dtype)
    view.take(old)
    assert view.show()["why_not_armed"] == []


def test_a_new_run_is_followed_and_told_apart(tmp_path):
    """After a restart the monitor must not go on with the dead ring, nor mix two runs in one window."""
    with DryRun(tmp_path) as dry:
        dry.run(1.5)
    source = Source(tmp_path)
    rows = source.poll()
    assert source.runs == 1 and len(rows) == 300 and source.silence.startswith("the loop ended")
    assert len(source.poll()) == 0
    with DryRun(tmp_path, seed=2) as dry:
        dry.run(0.5)
        source._live._looked_s = 0.0
        rows = source.poll()
    assert source.runs == 2 and list(rows["tick"]) == list(range(100)) and source.view.header["seed"] == 2
    source.close()


def test_the_monitor_needs_no_compiler(tmp_path):
    """numba takes ten seconds to load on the robot's processor, which the loop would feel."""
    with DryRun(tmp_path) as dry:
        dry.run(0.5)
    program = (
        "import sys\nfrom mip_rt.monitor import commands, terminal, web\nfrom mip_rt.monitor.source import Source\n"
        f"source = Source({str(tmp_path)!r})\nsource.poll()\nassert terminal.page(source)\nprint('numba' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=True)
    assert result.stdout.strip() == "False"


def test_the_place_of_a_robot_on_wheels_is_the_sum_of_its_ways():
    """Straight, then a quarter circle to the left, in portions; a reset of the estimator moves nothing."""
    names = ("pitch_rad", "phi_rad", "yaw_rad")
    rows = np.zeros(401, [("estimates", "<f8", (8, 3)), ("wheel_angle_rad", "<f8", (2,))])
    way_m = 0.005 * np.arange(401)
    yaw = np.clip((way_m - 1.0) / 1.0, 0.0, 1.0) * math.pi / 2
    pitch = 0.1 * np.sin(way_m)
    rows["estimates"][:, 0] = np.stack((pitch, way_m / 0.035 - pitch, yaw), axis=1)
    rows["estimates"][200:, 0, 1] -= 77.0
    robot = pose.of_robot({"estimate_names": names}, {"model": {"wheel_radius_m": 0.035}})
    for begin in range(0, 401, 33):
        robot.follow(rows[begin : begin + 33])
    shown = robot.show(rows[-1])
    radius_m = 1.0 / (math.pi / 2)
    assert shown["position_m"] == pytest.approx([1.0 - 0.005 + radius_m, radius_m], abs=1e-3)
    assert shown["attitude_rad"][0] == 0.0 and shown["attitude_rad"][1] == pytest.approx(pitch[-1], abs=1e-5)
    assert robot.tilt_rad(rows) == pytest.approx(np.abs(pitch))


def test_the_same_fault_a_second_time_is_a_new_one(fallen):
    """Its number in the row does not change, so a fall just now would be shown as one of long ago."""
    rows = fallen.frames[:1600].copy()
    rows["fault"][200:], rows["state"] = 4, State.DISARMED
    rows["state"][200:300] = rows["state"][1400:1500] = State.FAULT
    view = View(fallen.header, rows.dtype)
    view.take(rows[:1000])
    assert view.show()["fault"]["ago_s"] == pytest.approx(799 / 200, abs=0.06) and not view.show()["fault"]["active"]
    view.take(rows[1000:])
    assert view.show()["fault"]["ago_s"] == pytest.approx(199 / 200, abs=0.06)
