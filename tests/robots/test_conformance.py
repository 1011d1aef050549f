"""What every estimator and every controller of every robot keeps, through the compiled step that the loop calls.

Inputs are the raw sensors of a robot that stands in a dry run, played forwards and backwards, so that counts and attitude have no seam; the
commands in force, of which estimators are told, are those that moved it then, as in a replay. That x86 and 32-bit ARM agree to 1e-9 is shown by `tests/replay/test_shipped_logs.py` for each of them, on both machines.
"""

import tracemalloc

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt import frame, robots
from mip_rt.compiled import JIT_DISABLED
from mip_rt.estimators import ekf
from mip_rt.hardware.imu_status import IMU_BUS_ERROR

PERIOD_NS = 5_000_000
CASES = [(name, "estimator", estimator) for name in robots.NAMES for estimator in robots.setup(name).ESTIMATORS]
CASES += [(name, "controller", controller) for name in robots.NAMES for controller in getattr(robots.setup(name), "CONTROLLERS", ())]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """{robot: (n,) rows} of a robot that stands."""
    found = {}
    for name in robots.NAMES:
        with DryRun(tmp_path_factory.mktemp(name), make_config(name, estimator__shadows="[]", dry_run__gyro_bias_rad_s="[0, 0, 0]")) as dry:
            dry.until(lambda: dry.session.supervisor.drive_scale >= 1.0)
            for _ in range(500):
                dry.session.loop.tick()
            ring, last = dry.session.ring, dry.session.loop.ticks
            rows = np.array([ring.rows[k % ring.capacity] for k in range(last - 300, last)])
        back = rows[-2:0:-1].copy()
        rates = back["imu_packet"][:, 22:28].copy().view(">i2")  # what goes back turns the other way
        back["imu_packet"][:, 22:28] = (-rates).astype(">i2").view(np.uint8)
        found[name] = np.concatenate([rows, back])
    return found


@pytest.fixture(params=CASES, ids=lambda case: "-".join(case))
def robot(request, recordings):
    """(robot with this estimator in control or this controller, one lap of its inputs, the commands of then), attached and engaged."""
    name, what, choice = request.param
    key = {"estimator": "estimator__control", "controller": "control__controller"}[what]
    built = robots.setup(name).build(make_config(name, estimator__shadows="[]", **{key: choice}))
    rows = recordings[name].copy()
    rows["edge_ns"] = PERIOD_NS * (1 + np.arange(len(rows)))
    built.attach(rows)
    return built, rows, recordings[name]["command_applied"]


def run(robot, first, count):
    """Ticks first ... first + count - 1; returns the union of the slot's flags."""
    built, rows, commands = robot
    flags = 0
    for tick in range(first, first + count):
        index = tick % len(rows)
        rows["edge_ns"][index] = PERIOD_NS * (tick + 1)
        built.step(index)
        built.command_in_force[:] = commands[index]
        flags |= int(rows["estimator_flags"][index, 0])
    return flags


def sound(rows, index=slice(None)):
    """Every estimate of the slot and every command is finite."""
    names = ("estimates", "error", "command_feedback", "command_wheel", "command_applied", "duty")
    return all(np.isfinite(rows[name][index][..., :1, :] if name == "estimates" else rows[name][index]).all() for name in names)


def leans(rows):
    """Largest lean that the slot estimates."""
    axes = 2 if "body_angle_rad" in rows.dtype.names else 1
    return float(np.abs(rows["estimates"][:, 0, :axes]).max())


@pytest.mark.armhf
def test_stands_as_the_robot_does(robot):
    rows = robot[1]
    flags = run(robot, 0, 2 * len(rows))
    assert sound(rows) and leans(rows) < 0.15 and not flags & (ekf.UNHEALTHY | ekf.NOT_FINITE)
    assert np.abs(rows["duty"]).max() > 0.0


@pytest.mark.armhf
def test_a_missing_packet_or_a_jumping_count_is_no_harm(robot):
    """One tick without the IMU, then eight; then an encoder's count that a wheel cannot have made."""
    rows = robot[1]
    run(robot, 0, len(rows))
    whole = rows.copy()
    rows["imu_status"][50], rows["imu_status"][100:108] = IMU_BUS_ERROR, IMU_BUS_ERROR
    rows["encoder_count"][200:, 0] += 100_000
    flags = run(robot, len(rows), len(rows))
    assert sound(rows) and not flags & ekf.UNHEALTHY
    assert rows["limits"][[50, 100, 107]].astype(bool).all() and rows["limits"][200] & frame.LIMIT_ENCODER_JUMP
    assert leans(rows[300:]) < leans(whole) + 0.05


@pytest.mark.armhf
def test_a_number_that_is_not_finite_stays_out(robot):
    """Through what is a float on its way in: the gyro's bias, and the battery."""
    rows = robot[1]
    run(robot, 0, len(rows))
    clean = rows["gyro_bias_rad_s"].copy()
    for axis, bad in enumerate((np.nan, np.inf, -np.inf)):
        rows["gyro_bias_rad_s"][100 * axis + 50, axis] = bad
    rows["battery_v"][20:40] = np.nan
    for tick in range(len(rows), 2 * len(rows)):
        run(robot, tick, 1)
        assert sound(rows, tick % len(rows))
    rows["gyro_bias_rad_s"], rows["battery_v"] = clean, 7.4
    run(robot, 2 * len(rows), len(rows))
    assert sound(rows) and leans(rows) < 0.15


@pytest.mark.skipif(JIT_DISABLED, reason="plain Python allocates")
def test_allocates_nothing(robot):
    """Neither Python's memory nor that of compiled code."""
    from numba.core.runtime import _nrt_python, rtsys

    getattr(_nrt_python, "memsys_enable_stats", lambda: None)()  # numba 0.56 counts always
    built = robot[0]
    run(robot, 0, 100)
    step = built.step
    before = rtsys.get_allocation_stats()
    tracemalloc.start()
    held = tracemalloc.get_traced_memory()[0]
    for _ in range(2000):
        step(5)
    grown = tracemalloc.get_traced_memory()[0] - held
    tracemalloc.stop()
    after = rtsys.get_allocation_stats()
    assert after.alloc == before.alloc and grown < 2000  # a byte a step


@pytest.mark.slow
@pytest.mark.skipif(JIT_DISABLED, reason="hours of plain Python")
def test_thirty_minutes_of_standing(robot):
    built, rows, commands = robot
    laps = 30 * 60 * 200 // len(rows)
    flags = 0
    for lap in range(laps):
        rows["edge_ns"] = PERIOD_NS * (1 + lap * len(rows) + np.arange(len(rows)))
        for index in range(len(rows)):
            built.step(index)
            built.command_in_force[:] = commands[index]
        flags |= int(np.bitwise_or.reduce(rows["estimator_flags"][:, 0]))
    variance = rows["state_variance"]
    assert sound(rows) and leans(rows) < 0.15 and not flags & (ekf.UNHEALTHY | ekf.NOT_FINITE)
    assert np.isfinite(variance).all() and variance.min() >= 0.0
