"""The page's server: our own files, one stream of events a viewer, and in a dry run the way of the page's remote to the pty.

Each open page has one thread with a reader of its own; without a page nothing is read. A viewer that is slow gets gaps, never a backlog.

Who may ask: the server listens on this machine only unless told otherwise. Requests must name it by address, "localhost" or this machine's
name: a foreign site that points its own name at us (DNS rebinding) is refused. Commands must be JSON from a page of ours, which a
foreign page cannot send without asking first, and is then not allowed.
"""

import ipaddress
import json
import math
import socket
import sys
import time
import urllib.parse
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources

from mip_rt.errors import MipRtError
from mip_rt.log.columns import columns
from mip_rt.monitor.pose import number
from mip_rt.monitor.source import Source
from mip_rt.monitor.view import HISTOGRAM_US
from mip_rt.remote.fourjoy import BUTTONS, START, frame

TYPES = {"html": "text/html", "js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
ACTS = ("arm", "hold", "release")
MOST_SERIES = 24
LATENCY_EVERY_S = 0.5
LONGEST_COMMAND = 1024
POLICY = "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"


class Page(ThreadingHTTPServer):
    """The server.

    Args:
        where: what monitor.source.Source takes.
        address: (host, port).
        rate_hz: events a second to each viewer.

    Attributes:
        entrance: where a dry run takes a remote of ours; None where there is none. Set by the streams as runs come and go.

    Raises:
        MipRtError: the address cannot be listened on.
    """

    daemon_threads = True

    def __init__(self, where, address, rate_hz: float):
        self.where, self.rate_hz, self.entrance = where, rate_hz, None
        if ":" in address[0]:
            self.address_family = socket.AF_INET6
        try:
            super().__init__(address, Handler)
        except (OSError, OverflowError) as error:
            raise MipRtError(
                f"the page cannot be served at {address[0]} port {address[1]}: {error}.", "Name another with --port or --host.", "page_address"
            ) from error

    def handle_error(self, request, client_address):
        """A viewer that left is no error; anything else is shown."""
        if not isinstance(sys.exc_info()[1], (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)

    def send(self, message: bytes) -> None:
        """One datagram to the dry run's entrance.

        Raises:
            OSError: nobody is there.
        """
        if self.entrance is None:
            raise FileNotFoundError("no dry run")
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
            out.setblocking(False)
            out.sendto(message, self.entrance)


class Handler(BaseHTTPRequestHandler):
    """One connection."""

    protocol_version = "HTTP/1.1"
    server_version = "mip-rt"
    timeout = 30  # a connection that neither sends nor takes anything for so long is closed

    def log_message(self, *_):
        """Requests are not worth a line."""

    def do_GET(self):  # noqa: N802
        """Files of the page, and the stream."""
        if not self._host_is_ours():
            return
        path, _, query = self.path.partition("?")
        if path == "/stream":
            self._stream(urllib.parse.parse_qs(query))
            return
        name = path.lstrip("/") or "index.html"
        folder = resources.files("mip_rt.monitor") / "page"
        if name not in {entry.name for entry in folder.iterdir()}:
            self._answer(HTTPStatus.NOT_FOUND, b"there is no such page\n")
            return
        self._answer(HTTPStatus.OK, (folder / name).read_bytes(), TYPES.get(name.rpartition(".")[2], "application/octet-stream"))

    def do_POST(self):  # noqa: N802
        """Commands for a dry run: /pad (stick and buttons) and /hand (what a person beside the robot does)."""
        if not self._host_is_ours() or not self._page_is_ours():
            return
        try:
            length = int(self.headers.get("Content-Length", ""))
            if not 0 < length <= LONGEST_COMMAND:
                raise ValueError("length")
            message = {"/pad": _pad, "/hand": _hand}[self.path](json.loads(self.rfile.read(length)))
        except (ValueError, KeyError, TypeError, AttributeError):
            self.close_connection = True  # an unread body must not be taken for the next request
            self._answer(HTTPStatus.BAD_REQUEST, b"this is no command\n")
            return
        try:
            self.server.send(message)
        except BlockingIOError:
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE, b"the dry run does not keep up\n")
        except OSError:
            self._answer(HTTPStatus.CONFLICT, b"there is no dry run that takes commands\n")
        else:
            self._answer(HTTPStatus.NO_CONTENT, b"")

    # -- who asks --------------------------------------------------------------------------------------------------------
    def _host_is_ours(self) -> bool:
        if is_own_name(self.headers.get("Host", "")):
            return True
        self._refuse("requests must name this server by its address or as localhost")
        return False

    def _page_is_ours(self) -> bool:
        origin = self.headers.get("Origin")
        if self.headers.get_content_type() != "application/json" or (origin is not None and origin != f"http://{self.headers['Host']}"):
            self._refuse("commands come from this server's own page, as JSON")
            return False
        return True

    def _refuse(self, sentence: str) -> None:
        self.close_connection = True
        self._answer(HTTPStatus.FORBIDDEN, sentence.encode() + b"\n")

    def _answer(self, status: HTTPStatus, body: bytes, kind: str = "text/plain") -> None:
        self.send_response(status)
        if status is not HTTPStatus.NO_CONTENT:
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-cache")
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    # -- the stream ------------------------------------------------------------------------------------------------------
    def _stream(self, query: dict) -> None:
        """Server-sent events until the viewer leaves: `run` at the start of each run, then `view` and, twice a second, `latency`."""
        try:
            source = Source(self.server.where)
        except MipRtError as error:
            self._answer(HTTPStatus.NOT_FOUND, str(error).encode())
            return
        self.close_connection = True
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Connection", "close")
        self.end_headers()
        asked = query.get("fields", [""])[0].split(";")[:MOST_SERIES]
        try:
            self.wfile.write(b"retry: 1000\n\n")
            self._follow(source, asked)
        except (ConnectionError, TimeoutError):
            pass  # the viewer left
        finally:
            source.close()

    def _follow(self, source: Source, asked: list[str]) -> None:
        known, runs, latency_due_s = {}, 0, 0.0
        period_s = 1.0 / self.server.rate_hz
        due_s = time.monotonic()
        while True:
            rows = source.poll()
            if source.runs != runs:
                runs = source.runs
                self.server.entrance = source.view.header.get("remote_entrance")
                known = {column.name: column for column in columns(source.view.header) if not column.is_bytes}
                self._event("run", describe(source, known))
                latency_due_s = 0.0
            view = source.view
            if view is None or view.row is None:
                self._event("waiting", {"sentence": source.trouble or "The loop has not made its first tick yet."})
            else:
                self._event("view", {**view.show(), "silence": source.silence, "samples": samples(view, rows, known, asked)})
                if due_s >= latency_due_s:
                    latency_due_s = due_s + LATENCY_EVERY_S
                    self._event("latency", {"stages": view.latency_us(), "counts": view.histograms()})
            idle = view is None or view.row is None or source.silence
            due_s = max(due_s + (0.5 if idle else period_s), time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))

    def _event(self, name: str, data: dict) -> None:
        self.wfile.write(f"event: {name}\ndata: {json.dumps(data, separators=(',', ':'))}\n\n".encode())


def is_own_name(host: str) -> bool:
    """Whether a Host header names this machine in a way that no foreign site can: an address, "localhost" or the machine's own name."""
    name = urllib.parse.urlsplit(f"//{host}").hostname or ""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        return name in ("localhost", own, f"{own}.local")
    return True


def describe(source: Source, known: dict) -> dict:
    """What the page needs to know of a run once."""
    view = source.view
    header, config = view.header, view.config
    model, remote = config.get("model", {}), config.get("remote", {})
    return {
        "started": header.get("clock"),
        "log": str(source.path),
        "robot": config.get("robot", ""),
        "estimators": header.get("estimators", []),
        "scenario": header.get("scenario"),
        "seed": header.get("seed"),
        "rate_hz": view.rate_hz,
        "ball_radius_m": model.get("ball_radius_m"),
        "wheel_radius_m": model.get("wheel_radius_m"),
        "track_m": model.get("track_m"),
        "body_from_wheel": config.get("wheels", {}).get("body_from_wheel"),
        "tip_rad": config.get("limits", {}).get("tip_rad"),
        "levels": remote.get("levels", []),
        "drivable": "remote_entrance" in header,
        "series": [[column.name, column.unit, column.meaning] for column in known.values()],
        "histogram_us": [number(edge) for edge in HISTOGRAM_US],
    }


def samples(view, rows, known: dict, asked: list[str]) -> dict:
    """The asked series of new rows: times and one list of numbers each; series that this run does not have are left out."""
    found = [name for name in asked if name in known]
    if not len(rows) or not found:
        return {}
    return {
        "time_s": [number(t, 3) for t in view.time_s(rows)],
        "values": {name: [number(v, 6) for v in known[name].of(rows)] for name in found},
    }


def _pad(command: dict) -> bytes:
    x, y = float(command["x"]), float(command["y"])
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError("stick")
    return b"remote " + frame(x, y, BUTTONS.get(command.get("button"), 0), START if command.get("heading_reset") else 0)


def _hand(command: dict) -> bytes:
    if command["act"] not in ACTS:
        raise ValueError("act")
    return command["act"].encode()


def serve(where, host: str, port: int, rate_hz: float) -> None:
    """Serves the page until interrupted.

    Raises:
        MipRtError: the port is taken, or what was named is no ring.
    """
    Source(where).close()  # a wrong name is refused here, not in the browser
    with Page(where, (host, port), rate_hz) as page:
        shown = f"[{host}]" if ":" in host else host
        print(f"mip-rt monitor: http://{shown}:{page.server_address[1]}/ (Ctrl-C ends)", file=sys.stderr, flush=True)
        if not _is_local(host):
            print("warning: anyone who can reach this address can watch, and drive a dry run; without --host it is this machine only",
                  file=sys.stderr, flush=True)  # fmt: skip
        page.serve_forever()


def _is_local(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
