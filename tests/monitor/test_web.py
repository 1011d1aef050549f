"""The page's server: what it hands out, whom it refuses, and that it rests while nobody looks."""

import gc
import http.client
import json
import os
import socket
import threading
import time
from pathlib import Path

import pytest
from helpers import DryRun

from mip_rt.monitor import web
from mip_rt.remote.fourjoy import CIRCLE, START, frame

FILES = sorted(path.name for path in (Path(web.__file__).parent / "page").iterdir())


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    made = tmp_path_factory.mktemp("ring")
    with DryRun(made) as dry:
        dry.run(5.0)
    path = dry.session.ring.path
    del dry
    gc.collect()  # the loop's own mapping holds the file open
    return path


@pytest.fixture
def page(ring):
    """The server in a thread, at a free port."""
    with web.Page(ring.parent, ("127.0.0.1", 0), 30.0) as made:
        threading.Thread(target=made.serve_forever, args=(0.02,), daemon=True).start()
        yield made
        made.shutdown()


def ask(page, method, path, body=None, **headers):
    """(status, body, headers) of one request."""
    connection = http.client.HTTPConnection("127.0.0.1", page.server_address[1], timeout=10)
    connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    data = answer.read()
    connection.close()
    return answer.status, data, answer.headers


class Events:
    """A viewer: one open stream."""

    def __init__(self, page, fields=""):
        self.connection = http.client.HTTPConnection("127.0.0.1", page.server_address[1], timeout=10)
        self.connection.request("GET", f"/stream?fields={fields}")
        self.answer = self.connection.getresponse()
        assert self.answer.headers["Content-Type"] == "text/event-stream"

    def next(self, name):
        """Data of the next event of this name."""
        while True:
            line = self.answer.readline().decode()
            assert line, "the stream ended"
            if line == f"event: {name}\n":
                return json.loads(self.answer.readline().decode().removeprefix("data: "), parse_constant=pytest.fail)

    def close(self):
        self.answer.close()
        self.connection.close()


def wait_for_readers(ring, wanted, limit_s=10.0):
    """Waits until this process has the ring open so many times."""
    end = time.monotonic() + limit_s
    while True:
        found = 0
        for entry in os.scandir("/proc/self/fd"):
            try:
                found += os.readlink(entry.path) == str(ring)
            except OSError:
                pass
        if found == wanted:
            return
        assert time.monotonic() < end, f"{found} readers, not {wanted}"
        time.sleep(0.05)


def test_every_file_of_the_page_is_served_and_nothing_else(page):
    assert {"index.html", "monitor.js", "robot3d.js", "style.css"} <= set(FILES)
    for name in FILES:
        status, body, headers = ask(page, "GET", f"/{name}")
        assert status == 200 and body == (Path(web.__file__).parent / "page" / name).read_bytes()
        assert headers["Content-Type"].split(";")[0] in ("text/html", "text/javascript", "text/css", "image/svg+xml")
        assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert ask(page, "GET", "/")[1] == ask(page, "GET", "/index.html")[1]
    for path in ("/nothing", "/../web.py", "/%2e%2e/web.py", "//etc/passwd", "/page/index.html", "/."):
        assert ask(page, "GET", path)[0] == 404, path


def test_the_page_needs_no_network_and_no_inline_script():
    """It must work beside a robot without internet, and under its own content security policy."""
    for name in FILES:
        text = (Path(web.__file__).parent / "page" / name).read_text()
        assert "https://" not in text and "//cdn" not in text, name
        assert "http://" not in text.replace("http://www.w3.org/2000/svg", ""), name
        if name.endswith(".html"):
            assert "style=" not in text and "onclick" not in text and text.count("<script") == text.count("<script type=\"module\" src=")


@pytest.mark.parametrize("host", ["localhost:80", "127.0.0.1", "[::1]:8200", "192.168.7.2:8200", socket.gethostname(), f"{socket.gethostname()}.local:1"])
def test_own_names_are_served(page, host):
    assert ask(page, "GET", "/", Host=host)[0] == 200


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8200", "127.0.0.1.evil.example", "localhost.evil.example", "", "localhost@evil.example"])
def test_foreign_names_are_refused(page, host):
    """DNS rebinding: a site that points its own name at this machine must get neither data nor commands."""
    for method, path in (("GET", "/"), ("GET", "/stream"), ("POST", "/pad")):
        assert ask(page, method, path, b"{}" if method == "POST" else None, Host=host, Content_Type="application/json")[0] == 403


def test_commands_from_foreign_pages_are_refused(page):
    """A page of another site can send simple requests to localhost; none of those may drive the robot."""
    body = json.dumps({"act": "arm"})
    port = page.server_address[1]
    page.entrance = "/nowhere/entrance"
    assert ask(page, "POST", "/hand", body, Content_Type="text/plain")[0] == 403
    assert ask(page, "POST", "/hand", body)[0] == 403
    assert ask(page, "POST", "/hand", body, Content_Type="application/json", Origin="http://evil.example")[0] == 403
    assert ask(page, "POST", "/hand", body, Content_Type="application/json", Origin=f"http://localhost:{port}", Host=f"127.0.0.1:{port}")[0] == 403
    assert ask(page, "OPTIONS", "/hand", Origin="http://evil.example")[0] == 501  # so that a browser never sends what it asked for
    assert ask(page, "POST", "/hand", body, Content_Type="application/json", Origin=f"http://127.0.0.1:{port}")[0] == 409


@pytest.mark.parametrize("path, body", [
    ("/pad", "{}"), ("/pad", "[]"), ("/pad", "5"), ("/pad", "x"), ("/pad", '{"x": NaN, "y": 0}'), ("/pad", '{"x": 1e400, "y": 0}'), ("/hand", '{"act": "explode"}'),
    ("/hand", '{"act": ["arm"]}'), ("/other", "{}"), ("/pad", ""), ("/pad", '{"x": 0, "y": 0, "junk": "' + 2000 * "x" + '"}'),
])  # fmt: skip
def test_what_is_no_command_is_refused(page, path, body):
    assert ask(page, "POST", path, body, Content_Type="application/json")[0] == 400


def test_commands_arrive_as_the_bytes_of_a_phone(page, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as entrance:
        entrance.bind(str(tmp_path / "entrance"))
        entrance.settimeout(5.0)
        page.entrance = str(tmp_path / "entrance")
        for path, command, expected in (
            ("/pad", {"x": 0.5, "y": -1.0, "button": "circle"}, b"remote " + frame(0.5, -1.0, CIRCLE)),
            ("/pad", {"x": 0, "y": 0, "button": "none", "heading_reset": True}, b"remote " + frame(0.0, 0.0, 0, START)),
            ("/hand", {"act": "arm"}, b"arm"),
            ("/hand", {"act": "release"}, b"release"),
        ):
            assert ask(page, "POST", path, json.dumps(command), Content_Type="application/json")[0] == 204
            assert entrance.recv(100) == expected


def test_a_viewer_gets_the_run_the_view_and_the_asked_series(page):
    events = Events(page, "gyro_rad_s%5B2%5D;duty%5B0%5D;no_such_field")
    run = events.next("run")
    assert run["robot"] == "mbbr" and run["drivable"] is False and run["estimators"][0] == "dmp_ekf" and run["levels"][0]["button"] == "none"
    assert ["battery_v", "V"] in [entry[:2] for entry in run["series"]]
    view = events.next("view")
    assert view["state"] == "BALANCING" and view["silence"].startswith("the loop ended")
    samples = view["samples"]
    assert set(samples["values"]) == {"gyro_rad_s[2]", "duty[0]"} and len(samples["time_s"]) == 1000 == len(samples["values"]["duty[0]"])
    latency = events.next("latency")
    assert sum(latency["counts"]["edge_to_write"]) == 1000 and len(latency["counts"]["wake"]) == len(run["histogram_us"]) - 1
    assert events.next("view")["samples"] == {}
    events.close()


def test_nothing_is_read_while_nobody_looks(page, ring):
    """A monitor that is left running on the robot must cost nothing."""
    wait_for_readers(ring, 0)
    ask(page, "GET", "/")
    wait_for_readers(ring, 0)
    viewers = [Events(page), Events(page)]
    for viewer in viewers:
        viewer.next("view")
    wait_for_readers(ring, 2)
    for viewer in viewers:
        viewer.close()
    wait_for_readers(ring, 0)


def test_a_port_that_is_taken_is_refused_with_a_cure(page):
    with pytest.raises(web.MipRtError, match="--port"):
        web.Page(None, page.server_address, 30.0)
