"""What a run says while it runs: the banner at its start and the status line."""

import math
import os
import sys

from mip_rt import frame


class Live:
    """The status line: rewritten in place on a terminal, otherwise one line a second; on standard error."""

    def __init__(self, every_ticks: int = 200):
        self._terminal = sys.stderr.isatty()
        self._every = every_ticks // 10 if self._terminal else every_ticks

    def update(self, session) -> None:
        """Called after every tick; writes on few of them."""
        tick = session.loop.ticks
        if tick % self._every:
            return
        row = session.ring.rows[(tick - 1) % session.ring.capacity]
        lean = math.degrees(math.hypot(row["attitude_rad"][0], row["attitude_rad"][1]))
        text = (
            f"{tick / session.config.realtime.rate_hz:7.1f} s  lean {lean:4.1f} deg  yaw {row['gyro_rad_s'][2] / 2 / math.pi:+5.2f} Hz"
            f"  {session.devices.battery_v:4.2f} V  {session.condition()}"
        )
        trouble = session.recorder.trouble()
        text += limits_in_words(int(row["limits"])) + (f"  {trouble}" if trouble else "")
        end = "\x1b[K\r" if self._terminal else "\n"
        os.write(2, (text + end).encode())


def limits_in_words(limits: int) -> str:
    """The limits applied in a tick that an operator wants to know of."""
    shown = ("remote_lost", "spin_down", "drive_reduced", "battery_warning", "battery_unknown", "wheels_disagree")
    return "".join(f"  {frame.LIMIT_SENTENCES[name]}" for name in shown if limits & frame.LIMITS[name])


def banner(session, scenario: str, speed: str) -> str:
    """What is about to run, and how real-time it is."""
    config = session.config
    shadows = ", ".join(session.robot.names[1:]) or "none"
    where = f"dry run of scenario '{scenario}', seed {session.seed}, speed {speed}" if session.bench else "on the robot"
    return (
        f"mip-rt: {config.robot} {where}\n"
        f"  estimator {session.robot.names[0]} (shadows: {shadows}), controller {session.robot.controller}, "
        f"{config.realtime.rate_hz:g} Hz\n"
        f"  log {session.ring.path}" + (f", recorded to {session.recorder.folder}" if session.recorder.folder else "")
        + "".join(f"\n  warning: {problem}" for problem in session.devices.leds.problems)
    )
