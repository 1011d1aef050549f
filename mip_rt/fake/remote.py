"""The phone: a pty whose far end the driver opens as its serial port."""

import os
import tty

from mip_rt.remote.fourjoy import frame


class FakeRemote:
    """A pty.

    Attributes:
        device: path for the driver.
        lost: bytes that did not fit because nobody read.
    """

    def __init__(self):
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        self.device = os.ttyname(self._far)
        self.lost = 0

    def send(self, x: float, y: float, buttons: int = 0, start_select: int = 0) -> None:
        """One 4joy frame; x to the right, y forward."""
        self.send_bytes(frame(x, y, buttons, start_select))

    def send_bytes(self, data: bytes) -> None:
        """Any bytes."""
        try:
            os.write(self._near, data)
        except BlockingIOError:
            self.lost += len(data)

    def close(self) -> None:
        """Hangs up."""
        os.close(self._near)
        os.close(self._far)
