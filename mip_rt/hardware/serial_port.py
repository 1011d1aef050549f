"""A serial port that never blocks the loop: raw 8N1, everything that has arrived, nothing more."""

import os
import termios

from mip_rt.errors import RemoteError

CHUNK = 4096
BAUDS = {rate: getattr(termios, f"B{rate}") for rate in (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)}
EMPTY = b""


class SerialPort:
    """One port.

    Args:
        path: device, or a pty.
        baud: one of BAUDS.

    Attributes:
        fd: becomes readable when something arrives, or when the port is gone.
        errors: reads that failed, as when the device vanished.
    """

    def __init__(self, path, baud: int):
        if baud not in BAUDS:
            raise RemoteError(f"{baud} is no baud rate.", f"Choose one of {', '.join(map(str, BAUDS))}.", "serial_baud")
        try:
            self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
            settings = termios.tcgetattr(self.fd)
            settings[0] = settings[1] = settings[3] = 0
            settings[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
            settings[4] = settings[5] = BAUDS[baud]
            settings[6][termios.VMIN] = settings[6][termios.VTIME] = 0
            termios.tcsetattr(self.fd, termios.TCSANOW, settings)
        except (OSError, termios.error) as error:
            raise RemoteError(
                f"the remote's port {path} cannot be opened: {error}.",
                "Check remote.device, the UART overlay and the group dialout; or run with --remote none.",
                "serial_open",
            ) from error
        self.errors = 0

    def read(self) -> bytes:
        """What has arrived, at most 4096 bytes; empty where nothing has or the port failed."""
        try:
            return os.read(self.fd, CHUNK)
        except BlockingIOError:
            return EMPTY
        except OSError:
            self.errors += 1
            return EMPTY

    def close(self) -> None:
        """Closes the port."""
        os.close(self.fd)
