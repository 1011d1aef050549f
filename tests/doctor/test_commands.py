"""`mip-rt doctor` as a user runs it: a terminal with a person, JSON, and the bundle for support."""

import json
import os
import pty
import select
import socket
import subprocess
import sys
import tarfile
import time

import pytest

from mip_rt.doctor import bundle
from mip_rt.doctor.report import FAIL
from mip_rt.doctor.software import compiler_check
from mip_rt.doctor.realtime import granted
from mip_rt.realtime import Scheduling

LIMIT_S = 120.0
COMMAND = [sys.executable, "-m", "mip_rt", "doctor", "--dry-run"]


def converse(arguments, answers):
    """(exit code, all that was shown): runs the command on a terminal and gives the answer whose words stand in a question."""
    process, terminal = pty.fork()
    if process == 0:
        os.execv(sys.executable, [*COMMAND, *arguments])
    poll = select.poll()
    poll.register(terminal, select.POLLIN)
    shown, answered, end = "", 0, time.monotonic() + LIMIT_S
    while time.monotonic() < end:
        if not poll.poll(1000):
            continue
        try:
            data = os.read(terminal, 4096)
        except OSError:  # the terminal is closed: the command has ended
            break
        if not data:
            break
        shown += data.decode(errors="replace")
        waiting = shown[answered:]
        if ">> " in waiting and waiting.rstrip(" ").endswith(("Enter.", "]")):
            question = waiting[waiting.rindex(">> ") :]
            answer = next((reply for words, reply in answers if words in question), None)
            assert answer is not None, question
            answered = len(shown)
            os.write(terminal, (answer() if callable(answer) else answer).encode() + b"\n")
    else:
        os.kill(process, 9)
        raise AssertionError(f"no end within {LIMIT_S} s: {shown[-500:]}")
    os.close(terminal)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), shown.replace("\r\n", "\n")


@pytest.mark.slow
def test_a_person_at_a_terminal_is_led_through_wheels_motors_and_remote():
    seen = iter("123")
    code, shown = converse(["--interactive"], [("by hand", ""), ("Take the robot off", "yes"), ("type yes, then watch", "yes"),
                                               ("Which wheel", lambda: next(seen)), ("Connect the phone", "")])  # fmt: skip
    assert code == 0, shown
    for line in ("ok   encoders.turn1", "ok   encoders.turn3", "ok   motors.output1", "ok   motors.output4", "moving: byte 1 (x)", "0.92 ms", " 0 fail"):
        assert line in shown, (line, shown)
    assert "FAIL" not in shown


@pytest.mark.slow
def test_json_and_bundle(tmp_path):
    """One JSON object and nothing else; the bundle is small and names neither this machine nor its users."""
    file = tmp_path / "support.tar.gz"
    done = subprocess.run([*COMMAND, "--json", "--fault", "bus-nack", "--bundle", str(file)], capture_output=True, text=True, timeout=LIMIT_S)
    found = json.loads(done.stdout)
    assert done.returncode == 1 and found["counts"][FAIL] >= 1
    (answer,) = (check for check in found["checks"] if (check["layer"], check["name"]) == ("i2c", "answer"))
    assert answer["verdict"] == FAIL and answer["cure"]
    assert file.stat().st_size < 1_000_000
    with tarfile.open(file) as archive:
        texts = {member.name: archive.extractfile(member).read().decode() for member in archive}
    assert json.loads(texts["mip-rt-doctor/report.json"])["counts"] and "exit code 127" in texts["mip-rt-doctor/messages.txt"]
    assert all(socket.gethostname() not in text for text in texts.values()) or len(socket.gethostname()) < 3


def test_redaction():
    """What support must not learn: addresses, names, serial numbers; what it needs stays."""
    names = {"robbie": "<host>", "anna": "<user>", "Anna Balance": "<user>"}
    text = """Serial\t\t: 1234567890abcdef
    usb 1-1: SerialNumber: 4C530001230620
    inet 192.168.7.2/24 brd 192.168.7.255 inet6 fe80::5051:a9ff:fe3e:1/64 2001:db8::1
    link/ether 50:51:a9:3e:00:01 robbie systemd[1]: started by anna (Anna Balance) in /home/anna/mip-rt mail anna@example.org
    root=PARTUUID=1b3d5f7a-0011-2233-4455-66778899aabb machine 0123456789abcdef0123456789abcdef ssid HomeNet
    4819c000.i2c clock 12:34:56 kernel 5.10.168-ti-r79 pad 0x9ac error 121 at 2-0068 mip-rt"""
    found = bundle.redact(text, names)
    for secret in ("1234567890abcdef", "4C53", "192.168", "fe80", "2001:db8", "50:51", "robbie", "anna", "Anna", "example.org", "1b3d5f7a", "0123456789", "HomeNet"):
        assert secret not in found, (secret, found)
    for kept in ("4819c000.i2c", "5.10.168-ti-r79", "0x9ac", "error 121", "2-0068", "mip-rt", "12:34:56"):
        assert kept in found, (kept, found)


def test_the_bundle_is_bounded(tmp_path):
    class Kernel:
        def command(self, *words, timeout_s=10.0):
            return 1, os.urandom(1 << 19).hex()

    class Report:
        def as_dict(self):
            return {}

    class Patient:
        kernel = Kernel()

        class config:
            def to_yaml():
                return ""

    assert bundle.write(tmp_path / "b.tar.gz", Report(), Patient) < 16 * bundle.MOST_BYTES


def test_words_for_what_cannot_be_injected_here():
    """A compiler that takes for ever, one that is broken, and refused privileges."""
    assert "more than" in compiler_check(124, "").sentence and "Reinstall" in compiler_check(1, "ImportError: libLLVM").cure
    (check,) = granted(Scheduling(warnings=["memory is not locked: allow it with LimitMEMLOCK=infinity"]))
    assert check.verdict == "warn" and check.sentence == "memory is not locked." and check.cure == "Allow it with LimitMEMLOCK=infinity."
