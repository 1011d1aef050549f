"""The scripted operator of a dry run: presses the button, holds and releases the robot, sends the remote's frames.

Everything goes through the kernel boundary: the button is an edge on its GPIO line, the remote a byte stream on a pty. The operator
holds the robot until its motors are enabled, and picks it up again when the arm button is pressed after a fall. `press: recover` is what an
operator does who sees the robot off: he holds it upright and presses until it balances.
"""

import math

from mip_rt.errors import ConfigError

FRAME_EVERY = 4  # IMU samples between frames of the remote: 20 ms, 50 frames a second
FRAME_AT = 2  # which of them: between two looks of the loop, which would wait for a kernel that still carries the bytes through the pty
BUTTONS = {"none": 0, "triangle": 1, "circle": 2, "cross": 4, "square": 8}
START_SELECT = 2
RECOVER_EVERY = 240  # samples between presses of a recovery: acknowledge, arm; engaging takes half a second
RECOVER_PRESSES = 4


class Operator:
    """Runs a scenario against the fakes.

    Args:
        scenario: object with `events`, each with at_s and optionally yaw_rate_hz, speed_m_s, press, set.
        levels: the remote's levels (button, yaw_rate_hz, drive_limit_m_s).
        world: fake.world.World.
        send: callable(x, y, buttons, start_select) that writes one frame; None without a remote.
        press_button: callable(timestamp_ns) that pushes the arm button.
        injector: fake.injection.Injector for the scenario's faults.

    Attributes:
        quiet_until_s: no frames before this time: somebody else holds the remote.
    """

    def __init__(self, scenario, levels, world, send, press_button, injector):
        self._events = sorted(scenario.events, key=lambda event: event.at_s)[::-1]  # the next one last
        self._levels = {round(level.yaw_rate_hz, 6): level for level in levels}
        self._world, self._send, self.press_button = world, send, press_button
        self._injector = injector
        self._recoveries = self._recover_at = 0
        self._x = self._y = 0.0
        self._level = self._level_for(0.0)
        self._speed = (0.0, 0.0)
        self._start_select = 0
        self._enabled = self._gripped = False
        self.quiet_until_s = 0.0

    def _level_for(self, yaw_rate_hz: float):
        level = self._levels.get(round(yaw_rate_hz, 6))
        if level is None:
            known = ", ".join(f"{rate:g}" for rate in sorted(self._levels))
            raise ConfigError(
                f"the scenario asks for {yaw_rate_hz:g} Hz, the remote's levels are {known} Hz.",
                "Choose one of them, or add a level under remote.levels.",
                "scenario_level",
            )
        return level

    def sample(self, now_s: float, now_ns: int, enabled: bool) -> None:
        """Called once per IMU sample, before the sample is taken."""
        world = self._world
        while self._events and self._events[-1].at_s <= now_s:
            self._do(self._events.pop(), now_ns)
        if self._injector.until_ns <= now_ns:
            self._injector.end(now_ns)
        if self._recoveries and world.samples >= self._recover_at:
            self._recover(now_ns, enabled)
        self._enabled = enabled
        if enabled and world.held and not self._gripped:
            world.release()
        if world.samples % FRAME_EVERY == FRAME_AT and self._send is not None and now_s >= self.quiet_until_s:
            self._send(self._x, self._y, BUTTONS[self._level.button], self._start_select)
            self._start_select = 0

    def _recover(self, now_ns: int, enabled: bool) -> None:
        if enabled:
            self._recoveries = 0
            return
        self._recoveries -= 1
        self._recover_at = self._world.samples + RECOVER_EVERY
        self._world.hold()
        self.press_button(now_ns)

    def press_arm(self, now_ns: int) -> None:
        """A person presses the arm button; a robot with its motors off is held upright for it."""
        self._gripped = False
        if not self._enabled:
            self._world.hold()
        self.press_button(now_ns)

    def grip(self) -> None:
        """A person takes the robot and keeps it, motors on or off."""
        self._gripped = True
        self._world.hold()

    def let_go(self) -> None:
        """The person lets go; with the motors off, the robot falls."""
        self._gripped = False
        self._world.release()

    def _do(self, event, now_ns: int) -> None:
        if event.fault is not None:
            self._injector.begin(event.fault, event.parameters, now_ns)
        if event.press in ("arm", "disarm"):
            if event.press == "arm":
                self._world.hold()
            self.press_button(now_ns)
        elif event.press == "recover":
            self._recoveries, self._recover_at = RECOVER_PRESSES, self._world.samples
        elif event.press == "heading_reset":
            self._start_select = START_SELECT
        if event.yaw_rate_hz is not None:
            self._level = self._level_for(event.yaw_rate_hz)
        if event.speed_m_s is not None:
            self._speed = tuple(event.speed_m_s)
        if event.yaw_rate_hz is not None or event.speed_m_s is not None:
            forward, left = (speed / self._level.drive_limit_m_s for speed in self._speed)
            if math.hypot(forward, left) > 1.0 + 1e-9:
                raise ConfigError(
                    f"the scenario drives at {math.hypot(*self._speed):g} m/s, the limit at {self._level.yaw_rate_hz:g} Hz is "
                    f"{self._level.drive_limit_m_s:g} m/s.",
                    "Drive slower, or raise the level's drive_limit_m_s.",
                    "scenario_speed",
                )
            self._x, self._y = -left, forward  # stick units: x to the right, y forward
        for name, value in (event.set or {}).items():
            try:
                self._world.set(name, value)
            except KeyError as error:
                raise ConfigError(f"this robot's world has no {name}.", "Leave it out of the scenario.", "scenario_set") from error
