"""What the operator wants: the newest frame as velocity and yaw rate, and the dead-man that takes it away.

The stick commands an inertial velocity (forward is +x, left +y); exactly one held button chooses spin and drive limit, none or a combination
means no spin. What a silent remote has said last is taken away by `remote.dead_man`, which the loop runs in every tick.
"""

import math
from functools import partial

from mip_rt.compiled import direct
from mip_rt.remote import dead_man
from mip_rt.remote.fourjoy import BUTTONS


class RemoteCommand:
    """The commands of a remote.

    Args:
        port: object with `read() -> bytes`, or None for no remote (all zero, not lost).
        decoder: frame decoder.
        settings: the configuration's remote section.

    Attributes:
        state: (1,) dead_man.STATE: the newest frame, and what is left of it.
        update: update(now_ns) brings the state to this time, as the loop does it.
    """

    def __init__(self, port, decoder, settings):
        self._port, self._decoder = port, decoder
        levels = {}
        for level in settings.levels:
            levels[BUTTONS.get(level.button, 0)] = (2.0 * math.pi * level.yaw_rate_hz, level.drive_limit_m_s)
        self._levels, self._idle = levels, levels[0]
        self._start_was_down = self._heading_reset = False
        self.state = dead_man.fresh(port is None, settings.timeout_s, settings.ramp_s)
        self._state = memoryview(self.state).cast("B")
        self.update = partial(direct(dead_man.step_at), self.state.ctypes.data)

    def receive(self, now_ns: int) -> None:
        """Takes in what has arrived; only the newest frame counts."""
        if self._port is None:
            return
        data = self._port.read()
        if not data or not self._decoder.feed(data):
            return
        decoder = self._decoder
        yaw_rate, limit = self._levels.get(decoder.buttons, self._idle)
        dead_man.FRAME.pack_into(self._state, 0, 1, now_ns, decoder.y * limit, -decoder.x * limit, yaw_rate)
        down = decoder.start_select != 0
        if down and not self._start_was_down:
            self._heading_reset = True
        self._start_was_down = down

    @property
    def command(self) -> tuple[float, float, float]:
        """Velocity forward and left (m/s), yaw rate (rad/s)."""
        return tuple(map(float, self.state["command"][0]))

    @property
    def age_s(self) -> float:
        """Age of the last valid frame, infinity before the first."""
        return float(self.state["age_s"][0])

    @property
    def alive(self) -> bool:
        """A frame is recent, or there is no remote to lose."""
        return bool(self.state["alive"][0])

    @property
    def losses(self) -> int:
        """How often the remote was lost."""
        return int(self.state["losses"][0])

    @property
    def centred(self) -> bool:
        """No drive and no spin is commanded."""
        return not any(self.command)

    def heading_reset(self) -> bool:
        """True once after start or select was pressed."""
        wanted, self._heading_reset = self._heading_reset, False
        return wanted
