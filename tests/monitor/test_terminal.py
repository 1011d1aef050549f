"""The terminal view as a person has it: in a pty of 80 by 24, through a resize, and out of it again."""

import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
from helpers import DryRun

from mip_rt.monitor.source import Source
from mip_rt.monitor.terminal import bar, page, sparkline

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the ring of a run that has ended while balancing."""
    made = tmp_path_factory.mktemp("ring")
    with DryRun(made, scenario="drive-spin-1.0") as dry:
        dry.run(10.0)
    return made


class Terminal:
    """`mip-rt monitor` in a pty."""

    def __init__(self, folder, columns=80, lines=24, **environment):
        self.near, self.far = pty.openpty()
        self.before = termios.tcgetattr(self.far)
        self.resize(columns, lines)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "mip_rt", "monitor", str(folder)], stdin=self.far, stdout=self.far, stderr=self.far, cwd=ROOT,
            env={**os.environ, "TERM": "xterm", **environment}, start_new_session=True,
        )  # fmt: skip
        self.text = ""

    def resize(self, columns, lines):
        fcntl.ioctl(self.near, termios.TIOCSWINSZ, struct.pack("4H", lines, columns, 0, 0))

    def until(self, pattern, limit_s=20.0):
        """Reads until the pattern has appeared in what came since the last call; returns that."""
        self.text = ""
        poll = select.poll()  # select() refuses descriptors above 1023, which a long test run may reach
        poll.register(self.near, select.POLLIN)
        end = time.monotonic() + limit_s
        while not re.search(pattern, self.text, re.S):
            assert time.monotonic() < end, f"no {pattern!r} in {self.text[-2000:]!r}"
            if poll.poll(100):
                try:
                    self.text += os.read(self.near, 65536).decode(errors="replace")
                except OSError:
                    break
        return self.text

    def end(self):
        """Exit code, what was written last, and whether the terminal is as it was."""
        code = self.process.wait(10)
        poll = select.poll()
        poll.register(self.near, select.POLLIN)
        while poll.poll(100):
            self.text += os.read(self.near, 65536).decode(errors="replace")
        restored = termios.tcgetattr(self.far) == self.before
        os.close(self.near)
        os.close(self.far)
        return code, self.text, restored


def plain(text):
    """Lines of the last whole page without escape sequences."""
    last = text.split("\x1b[H")[-2]
    return [re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line.rstrip("\r")) for line in last.split("\n")]


def test_shows_everything_in_80_by_24_and_q_leaves_the_terminal_as_it_was(folder):
    terminal = Terminal(folder)
    lines = plain(terminal.until(r"\x1b\[H.*q quits.*\x1b\[H.*q quits.*\x1b\[H"))
    assert len(lines) <= 24 and max(map(len, lines)) <= 80
    whole = "\n".join(lines)
    for wanted in ("BALANCING", "the loop ended", "200.0 Hz", "tilt", "battery 7.", "drive +0.20", "spin +1.00", "p99", "limits", "fault", "heard"):
        assert wanted in whole, wanted
    os.write(terminal.near, b"q")
    code, text, restored = terminal.end()
    assert code == 0 and restored and text.rstrip().endswith("\x1b[?1049l") and "\x1b[?25h" in text


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_leaves_the_terminal_as_it_was(folder, number):
    """Whoever kills the monitor must not be left without cursor and echo."""
    terminal = Terminal(folder)
    terminal.until("q quits")
    terminal.process.send_signal(number)
    code, text, restored = terminal.end()
    assert code == 0 and restored and "\x1b[?1049l" in text


def test_follows_the_size_of_the_window(folder):
    terminal = Terminal(folder, 200, 50)
    terminal.until("q quits")
    terminal.resize(40, 10)
    terminal.until(r"\x1b\[H")
    lines = plain(terminal.until(r"\x1b\[H.*\x1b\[H.*\x1b\[H"))
    assert len(lines) <= 10 and max(map(len, lines)) <= 40 and lines[-1] == "q quits"
    os.write(terminal.near, b"q")
    assert terminal.end()[0] == 0


def test_no_colours_where_none_are_wanted(folder):
    terminal = Terminal(folder, NO_COLOR="1")
    assert not re.search(r"\x1b\[[0-9;]*m", terminal.until("q quits"))
    os.write(terminal.near, b"q")
    assert terminal.end()[0] == 0


def test_one_line_a_second_where_there_is_no_terminal(folder):
    process = subprocess.Popen([sys.executable, "-m", "mip_rt", "monitor", str(folder)], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    lines = [process.stdout.readline() for _ in range(2)]
    process.send_signal(signal.SIGINT)
    assert process.wait(10) == 0 and all("BALANCING" in line and "\x1b" not in line for line in lines)


def test_json_lines_end_with_their_reader(folder):
    """`mip-rt monitor --json | head -3` must neither hang nor end with a traceback."""
    result = subprocess.run(
        f"set -o pipefail; {sys.executable} -m mip_rt monitor --json --rate 50 {folder} | head -3", shell=True, executable="/bin/bash",
        capture_output=True, text=True, cwd=ROOT, timeout=30, check=False,
    )  # fmt: skip
    assert result.returncode == 0 and result.stderr == ""
    shown = [json.loads(line) for line in result.stdout.splitlines()]
    assert len(shown) == 3 and all(entry["latency_us"] and entry["state"] == "BALANCING" and entry["run"] == 1 for entry in shown)


@pytest.mark.parametrize("arguments", [["/nowhere/at-all.ring"], ["--rate", "0"], ["--rate", "1e9"], [__file__]])
def test_what_cannot_be_watched_is_refused_with_a_cure(arguments):
    result = subprocess.run([sys.executable, "-m", "mip_rt", "monitor", *arguments], capture_output=True, text=True, cwd=ROOT, timeout=30, check=False)
    assert result.returncode in (2, 3) and "Traceback" not in result.stderr and len(result.stderr.splitlines()) <= 3


def test_waits_for_a_loop_that_is_not_yet_there(tmp_path):
    source = Source(tmp_path)
    source.poll()
    assert "there is no ring" in page(source)[2][1]
    with DryRun(tmp_path) as dry:
        dry.run(0.5)
    source.poll()
    assert source.view.row is not None and "mbbr" in page(source)[0][1]


def test_every_size_of_terminal_gets_a_page(folder):
    source = Source(folder)
    source.poll()
    for columns, lines in ((1, 1), (20, 3), (80, 24), (300, 100)):
        made = page(source, columns, lines)
        assert len(made) <= lines and all(len(text) <= columns for _, text in made)


def test_sparkline_keeps_the_peak():
    """One bad tick in two thousand must remain visible in sixty columns."""
    history = [0.1] * 2000
    history[777] = 5.0
    drawn = sparkline(history, 60, 5.0)
    assert len(drawn) == 60 and drawn.count("█") == 1 and drawn[777 * 60 // 2000] == "█"
    assert sparkline([], 60, 5.0) == "" and len(sparkline([1.0] * 7, 60, 5.0)) == 60


def test_bar_shows_sign_and_size():
    assert bar(0.0, 4) == "····|····" and bar(0.5, 4) == "····|██··" and bar(-1.0, 4) == "████|····" and bar(None, 4) == bar(0.0, 4)
