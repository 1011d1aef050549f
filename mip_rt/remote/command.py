"""What the operator wants: the newest frame as velocity and yaw rate, and the dead-man that takes it away.

The stick commands an inertial velocity (forward is +x, left +y); exactly one held button chooses spin and drive limit, none or a combination
means no spin. A remote that is silent for `timeout_s` is lost: its command goes to zero within `ramp_s`. An operating system may take half a
minute to notice a lost Bluetooth link, so only the age of the last valid frame counts.
"""

import math

from mip_rt.remote.fourjoy import BUTTONS


class RemoteCommand:
    """The commands of a remote.

    Args:
        port: object with `read() -> bytes`, or None for no remote (all zero, not lost).
        decoder: frame decoder.
        settings: the configuration's remote section.

    Attributes:
        velocity_x_m_s, velocity_y_m_s, yaw_rate_rad_s: commands of this tick.
        age_s: age of the last valid frame, infinity before the first.
        alive: a frame is recent, or there is no remote to lose.
        losses: how often the remote was lost.
    """

    def __init__(self, port, decoder, settings):
        self._port, self._decoder = port, decoder
        self._timeout_s, self._ramp_s = settings.timeout_s, max(settings.ramp_s, 1e-6)
        levels = {}
        for level in settings.levels:
            levels[BUTTONS.get(level.button, 0)] = (2.0 * math.pi * level.yaw_rate_hz, level.drive_limit_m_s)
        self._levels, self._idle = levels, levels[0]
        self._frame_ns = None
        self._wanted = (0.0, 0.0, 0.0)
        self._start_was_down = self._heading_reset = False
        self.velocity_x_m_s = self.velocity_y_m_s = self.yaw_rate_rad_s = 0.0
        self.age_s = math.inf
        self.alive = port is None
        self.losses = 0

    def receive(self, now_ns: int) -> None:
        """Takes in what has arrived; only the newest frame counts."""
        if self._port is None:
            return
        data = self._port.read()
        if not data or not self._decoder.feed(data):
            return
        decoder = self._decoder
        self._frame_ns = now_ns
        yaw_rate, limit = self._levels.get(decoder.buttons, self._idle)
        self._wanted = (decoder.y * limit, -decoder.x * limit, yaw_rate)
        down = decoder.start_select != 0
        if down and not self._start_was_down:
            self._heading_reset = True
        self._start_was_down = down

    def update(self, now_ns: int) -> None:
        """The commands of this tick, after the dead-man."""
        if self._frame_ns is None:
            return
        age = (now_ns - self._frame_ns) * 1e-9
        self.age_s = age
        late = age - self._timeout_s
        if late <= 0.0:
            self.alive = True
            self.velocity_x_m_s, self.velocity_y_m_s, self.yaw_rate_rad_s = self._wanted
            return
        if self.alive:
            self.alive = False
            self.losses += 1
        rest = max(0.0, 1.0 - late / self._ramp_s)
        x, y, yaw_rate = self._wanted
        self.velocity_x_m_s, self.velocity_y_m_s, self.yaw_rate_rad_s = rest * x, rest * y, rest * yaw_rate

    @property
    def centred(self) -> bool:
        """No drive and no spin is commanded."""
        return self.velocity_x_m_s == 0.0 and self.velocity_y_m_s == 0.0 and self.yaw_rate_rad_s == 0.0

    def heading_reset(self) -> bool:
        """True once after start or select was pressed."""
        wanted, self._heading_reset = self._heading_reset, False
        return wanted
