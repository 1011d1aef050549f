"""Ball odometry: position from encoders and gyro must not drift with what the filter believes of motors and friction."""

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt.estimators import odometry
from mip_rt.models import mbbr


def test_increments_equal_the_rolling_ball_of_the_exact_kinematics():
    """Random attitudes and rates: encoder rate plus gyro, undone, is the ball's own rate."""
    random = np.random.default_rng(3)
    s = np.zeros(1, odometry.STATE).view(np.recarray)[0]
    for _ in range(50):
        x = random.normal(size=10) * 0.4
        gyro, encoder = mbbr.gyro(x), mbbr.encoder_rate(x)
        odometry.reset(s, np.zeros(3), gyro)
        odometry.step(s, encoder * 0.005, gyro, 0.005)
        angle = np.zeros(2)
        c, n = np.cos(x[2]), np.sin(x[2])
        odometry.add(s, x[0], x[1], c, n, 0.0, angle)
        assert angle / 0.005 == pytest.approx([c * x[8] - n * x[9], n * x[8] + c * x[9]], abs=1e-12)


def drive(folder, source):
    """Largest error of the position in 40 s of squares at 0.2 m/s and 1 Hz, with friction 10 % off, yaw of the DMP without drift."""
    config = make_config(
        estimator__shadows="[]", estimator__odometry=source, dry_run__dmp_yaw_drift_rad_s="0", dry_run__model_error__friction="1.1"
    )
    with DryRun(folder, config=config, scenario="drive-spin-1.0") as dry:
        truths, advance, world = [], dry.bench.world.advance, dry.bench.world

        def record(duty, enabled):
            advance(duty, enabled)
            newest = world.truth_rows[world.truth_row]
            truths.append((newest["x_m"], newest["y_m"]))

        world.advance = record
        dry.run(40.0)
        ticks = dry.session.loop.ticks
        rows, truth = dry.session.ring.rows[:ticks], np.array(truths)[-ticks:]
    engaged = np.flatnonzero(rows["request"] & 1)
    angle = rows["estimates"][engaged, 0, 8:10] * config.model.ball_radius_m
    return np.hypot(*(np.column_stack([angle[:, 1], -angle[:, 0]]) - truth[engaged] + truth[engaged[0]]).T).max()


@pytest.mark.slow
def test_position_stays_true_while_driving_and_spinning(tmp_path):
    from_encoders, from_filter = drive(tmp_path / "a", "encoders"), drive(tmp_path / "b", "filter")
    print(f"position at most {from_encoders * 1000:.1f} mm wrong; from the filter's ball rate {from_filter * 1000:.1f} mm")
    assert from_encoders < 0.003 < from_filter
