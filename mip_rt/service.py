"""What systemd wants to know: ready, alive, and in what state. Plain datagrams to $NOTIFY_SOCKET, as sd_notify(3) describes them.

The watchdog's ping comes from the loop itself, each time that it has come round, never from a thread that would live on beside a loop that
hangs. A loop that waits in vain for the IMU's interrupt still comes round: its motors are off, and a restart would not help.
"""

import os
import socket

from mip_rt.hardware.imu_status import IMU_OK

READY_TICKS = 200  # in a row with a good packet: interrupt, bus, DMP and compiled step work
STATUS_S = 1.0


class Service:
    """The running unit. Nothing here blocks or raises: what cannot be sent is counted.

    Args:
        address: $NOTIFY_SOCKET.
        watchdog_s: $WATCHDOG_USEC in seconds; 0 for none.

    Attributes:
        lost: datagrams that the manager did not take.
        ready: READY=1 was sent.
    """

    def __init__(self, address: str, watchdog_s: float = 0.0):
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)
        self._every_ns = round(min(0.4 * watchdog_s, STATUS_S) * 1e9) if watchdog_s > 0.0 else round(STATUS_S * 1e9)
        self._next_ns = self._good = 0
        self.lost, self.ready = 0, False

    def send(self, *assignments: str) -> None:
        """Such as "READY=1"."""
        try:
            self._socket.sendto("\n".join(assignments).encode(), self._address)
        except OSError:
            self.lost += 1

    def status(self, text: str) -> None:
        """One line for `systemctl status`."""
        self.send(f"STATUS={text}")

    def turn(self, session, ticked: bool) -> None:
        """The loop has come round, with a tick or without."""
        now_ns = session.kernel.monotonic_ns()
        if not self.ready:
            self._count(session, ticked)
        if now_ns >= self._next_ns:
            self._next_ns = now_ns + self._every_ns
            self.send("WATCHDOG=1", f"STATUS={session.condition()}")

    def _count(self, session, ticked: bool) -> None:
        row = (session.loop.ticks - 1) % session.ring.capacity
        self._good = self._good + 1 if ticked and session.ring.rows["imu_status"][row] & IMU_OK else 0
        if self._good >= READY_TICKS:
            self.ready = True
            self.send("READY=1")

    def close(self) -> None:
        """Tells that the stop is meant."""
        self.send("STOPPING=1")
        self._socket.close()


def from_environment() -> Service | None:
    """The unit that this process is the main process of; None outside systemd."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return None
    mine = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    microseconds = os.environ.get("WATCHDOG_USEC", "") if mine else ""
    return Service(address, float(microseconds) * 1e-6 if microseconds.isdigit() else 0.0)
