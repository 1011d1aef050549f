"""One fixed series of ticks through the compiled step, for comparing machines: `python -m mip_rt.lab.golden write|compare FILE`.

The inputs (packets, counts, commands) come from a seeded simulation on the machine that writes; the other machine runs the same
inputs through its own compiled step, and every output must agree to 1e-9 relative.
"""

import sys

import numpy as np

from mip_rt import config as configuration
from mip_rt import frame
from mip_rt.fake.world import World
from mip_rt.robots import mbbr_frame, mbbr_setup

TICKS = 1500
TOLERANCE = 1e-9
OUTPUTS = ("estimates", "state_estimate", "state_variance", "command_feedback", "command_applied", "duty", "reference_lean_rad",
           "wheel_rate_rad_s", "error")  # fmt: skip
INPUTS = tuple(f.name for f in mbbr_frame.LAYOUT.input_fields) + ("imu_packet",)


def _robot():
    config = configuration.load(configuration.default_path("mbbr"), {"estimator.shadows": "[ekf, ekf_printed, kf, kf_printed, dmp_kf]"})
    return config, mbbr_setup.build(config)


def simulate():
    """(TICKS,) frames of a closed loop on the simulated world, spinning and driving."""
    config, robot = _robot()
    world = World(config, 11)
    rows = np.zeros(TICKS, mbbr_frame.FRAME)
    robot.attach(rows)
    signs, period = np.array(config.motors.signs), 1e9 / config.motor.pwm_frequency_hz
    duty = np.zeros(3)
    world.release()
    for k in range(TICKS):
        world.advance(duty, True)
        row = rows[k : k + 1]
        row["tick"], row["imu_status"], row["battery_v"], row["drive_scale"] = k, 1, 7.8, 1.0
        row["request"], row["encoder_count"] = frame.REQUEST_ENGAGED, world.counts
        row["imu_packet"][0] = np.frombuffer(world.packet, np.uint8)
        row["remote_yaw_rate_rad_s"] = 6.0 if k > 300 else 0.0
        row["remote_velocity_m_s"] = (0.2 if k // 400 % 2 else -0.2, 0.0)
        robot.step(k)
        duty[:] = rows["duty_ns"][k] * signs / period
    return rows


def replay(inputs) -> np.ndarray:
    """The same inputs through this machine's step.

    The command in force is an input, too: controller and filters alone, without the plant that answers, are an unstable system
    that would blow rounding up.
    """
    _, robot = _robot()
    rows = np.zeros(len(inputs), mbbr_frame.FRAME)
    for name in INPUTS:
        rows[name] = inputs[name]
    robot.attach(rows)
    for k in range(len(rows)):
        if k:
            robot.state[0].applied[:] = inputs["command_applied"][k - 1]
        robot.step(k)
    return rows


def differences(recorded, computed) -> dict:
    """Largest difference of each output, relative to the largest value of that column."""
    found = {}
    for name in OUTPUTS:
        a, b = recorded[name].reshape(len(recorded), -1), computed[name].reshape(len(recorded), -1)
        scale = np.maximum(np.abs(a).max(axis=0), 1e-12)
        found[name] = float((np.abs(a - b) / scale).max())
    return found


def main(action: str, file: str) -> int:
    """Exit code 0, or 1 where an output differs by more than the tolerance."""
    if action == "write":
        with open(file, "wb") as handle:
            np.save(handle, simulate())
        return 0
    recorded = np.load(file)
    found = differences(recorded, replay(recorded))
    for name, value in found.items():
        print(f"{name:<22} largest relative difference {value:.1e}")
    worst = max(found.values())
    print(f"{'ok' if worst <= TOLERANCE else 'TOO LARGE'}: {worst:.1e} over {len(recorded)} ticks, allowed {TOLERANCE:g}")
    return 0 if worst <= TOLERANCE else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
