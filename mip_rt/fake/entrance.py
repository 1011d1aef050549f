"""A second way into a dry run: another process plays the person beside the robot, through the same boundary as the scenario's operator.

A datagram at the entrance (a Unix socket; its path stands in the ring's header as `remote_entrance`) is one act:

    remote BYTES   what a phone sends; they go into the remote's pty as they are
    arm            the arm button; a robot whose motors are off is held upright first, as a person would
    hold, release  grip the robot, let it go

While a phone at the entrance sends, the scenario's operator does not, so that two sticks never fight. Only the user who runs the dry run can reach
the entrance: it lies in a folder that is closed to others.
"""

import os
import socket
from pathlib import Path

QUIET_S = 0.5  # after the last bytes from the entrance, the operator's own remote speaks again
LONGEST = 256
MOST = 16  # datagrams a sample; a flood must not hold up the world


class Entrance:
    """The receiving end, served by the kernel's stand-in once a sample.

    Args:
        path: where the socket is made.
        operator: fake.operator.Operator.
        send_bytes: callable(bytes) that writes into the remote's pty.

    Attributes:
        path: of the socket.
        refused: datagrams that were none of the above.
    """

    def __init__(self, path: Path, operator, send_bytes):
        self.path, self.refused = Path(path), 0
        self._operator, self._send_bytes = operator, send_bytes
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(os.fspath(path))

    def serve(self, now_s: float, now_ns: int) -> None:
        """Does what has arrived; never waits."""
        for _ in range(MOST):
            try:
                message = self._socket.recv(LONGEST)
            except BlockingIOError:
                return
            act, _, data = message.partition(b" ")
            if act == b"remote" and data:
                self._operator.quiet_until_s = now_s + QUIET_S
                self._send_bytes(data)
            elif act == b"arm":
                self._operator.press_arm(now_ns)
            elif act == b"hold":
                self._operator.grip()
            elif act == b"release":
                self._operator.let_go()
            else:
                self.refused += 1

    def close(self) -> None:
        """Shuts the entrance."""
        self._socket.close()
        self.path.unlink(missing_ok=True)
