"""The terminal's view: one page of text, 80 by 24, renewed in place; plain ANSI, so it works over ssh and a serial console."""

import fcntl
import math
import os
import select
import signal
import struct
import sys
import termios
import time
import tty

from mip_rt.monitor.view import HISTORY_S
from mip_rt.summary import STAGES

BARS = " ▁▂▃▄▅▆▇█"
FULL_SCALES_DEG = (2.0, 5.0, 10.0, 20.0, 45.0, 90.0)
WIDTH, HEIGHT = 80, 24
# SGR codes; the state is also written out, so colour is never the only sign.
BOLD, DIM, PLAIN = "1", "2", "0"
STATE_COLOURS = {"BALANCING": "1;30;42", "ARMING": "1;30;46", "DISARMED": "1;30;47", "FAULT": "1;97;41"}


def sparkline(values, columns: int, top: float) -> str:
    """Values as one line of block characters: the largest of each column, so that no peak is lost."""
    if not len(values):
        return ""
    edges = [round(i * len(values) / columns) for i in range(columns + 1)]
    peaks = [max((v for v in values[a:b] if math.isfinite(v)), default=None) for a, b in zip(edges, edges[1:])]
    return "".join(" " if p is None else BARS[max(1, min(8, math.ceil(8.0 * p / top)))] for p in peaks)


def bar(value, half: int = 8) -> str:
    """A number in [-1, 1] as a bar to the left or right of a middle mark."""
    filled = min(half, round(abs(value or 0.0) * half))
    left, right = (filled, 0) if (value or 0.0) < 0 else (0, filled)
    return "·" * (half - left) + "█" * left + "|" + "█" * right + "·" * (half - right)


def _degrees(value_rad, digits: int = 1) -> str:
    return "  --" if value_rad is None else f"{math.degrees(value_rad):+.{digits}f}"


def _or_dash(value, form: str) -> str:
    return "--" if value is None else format(value, form)


def one_line(source) -> str:
    """The view in one line."""
    shown = source.view.show() if source.view is not None else {}
    if not shown:
        return source.trouble or "waiting for the first tick"
    text = (
        f"{shown['time_s']:9.1f} s  {shown['state']:<11} tilt {math.degrees(shown['tilt_rad'] or 0.0):4.1f} deg  "
        f"{_or_dash(shown['rate_hz'], '.1f')} Hz  {_or_dash(shown['battery_v'], '.2f')} V"
    )
    if source.silence:
        text += f"  {source.silence}"
    elif shown["hint"]:
        text += f"  {shown['hint']}"
    if shown["fault"] and shown["fault"]["active"]:
        text += f"  {shown['fault']['code']}: {shown['fault']['sentence']}; {shown['fault']['cure']}"
    return text


def page(source, columns: int = WIDTH, lines: int = HEIGHT) -> list[tuple[str, str]]:
    """The view as lines of (SGR code, text), cut to the terminal's size."""
    shown = source.view.show() if source.view is not None else {}
    if not shown:
        return _cut([(BOLD, "mip-rt monitor"), (PLAIN, ""), (PLAIN, source.trouble or "waiting for the first tick"), *_foot()], columns, lines)
    return _cut([*_head(source, shown), *_motion(source, shown, columns), *_timing(source.view.latency_us()), *_troubles(shown), *_foot()], columns, lines)


def _cut(made, columns, lines):
    """The foot stays where the page is too long: it says how to leave."""
    if len(made) > lines:
        made = [*made[: lines - 1], made[-1]]
    return [(code, text[: max(columns, 1)]) for code, text in made]


def _foot():
    return [(DIM, "q quits")]


def _head(source, shown):
    header = source.view.header
    robot = source.view.config.get("robot", "robot")
    kind = f"dry run of '{header['scenario']}', seed {header['seed']}" if "scenario" in header else "on the robot"
    restarts = f"   the loop was restarted {source.runs - 1} x" if source.runs > 1 else ""
    since = f"for {shown['state_s']:.0f} s" if shown["state_s"] is not None else ""
    status = f" {shown['state']:<11}"
    if source.silence:
        second = (STATE_COLOURS["FAULT"], f"{status} {source.silence}")
    else:
        second = (STATE_COLOURS.get(shown["state"], BOLD), f"{status} {since:<11}{shown['hint']}")
    return [
        (BOLD, f"mip-rt monitor   {robot}, estimator {header.get('estimators', ['?'])[0]}, {kind}{restarts}"),
        second,
        (PLAIN, f"time {shown['time_s']:10.1f} s    rate {_or_dash(shown['rate_hz'], '6.1f')} Hz    missed {shown['missed']} "
                f"in {HISTORY_S:.0f} s    battery {_or_dash(shown['battery_v'], '.2f')} V"),
        (PLAIN, ""),
    ]  # fmt: skip


def _motion(source, shown, columns):
    roll, pitch, yaw = shown["attitude_rad"]
    history_deg = [math.degrees(value) for value in source.view.tilt_history_rad()]
    top = next((scale for scale in FULL_SCALES_DEG if not any(v > scale for v in history_deg)), 90.0)
    yield PLAIN, (
        f"tilt     {math.degrees(shown['tilt_rad'] or 0.0):5.1f} deg   roll {_degrees(roll)}  pitch {_degrees(pitch)}   "
        f"most in {HISTORY_S:.0f} s {math.degrees(shown['tilt_max_rad'] or 0.0):.1f}"
    )
    yield PLAIN, f"  {sparkline(history_deg, min(columns, WIDTH) - 16, top)} 0..{top:g} deg"
    position = shown.get("position_m")
    where = f"   position {position[0] or 0.0:+.2f} {position[1] or 0.0:+.2f} m" if position else ""
    yield PLAIN, f"yaw      {_degrees(math.remainder(yaw or 0.0, 2.0 * math.pi))} deg   rate {_or_dash((shown['yaw_rate_rad_s'] or 0.0) / 2 / math.pi, '+.2f')} Hz{where}"
    drive = shown["velocity_command_m_s"]
    spin_hz = (shown["yaw_rate_command_rad_s"] or 0.0) / 2 / math.pi
    heard = "never heard" if shown["remote_age_s"] is None else f"heard {shown['remote_age_s']:.2f} s ago"
    yield PLAIN, f"remote   drive {drive[0] or 0.0:+.2f} {drive[1] or 0.0:+.2f} m/s   spin {spin_hz:+.2f} Hz   {heard}"
    bars = "  ".join(f"{value or 0.0:+.2f} {bar(value)}" for value in shown["duty"])
    yield PLAIN, f"motors   {'on ' if shown['motors_on'] else 'off'}  {bars}"
    yield PLAIN, ""


def _timing(latency_us):
    yield DIM, "latency, microseconds  " + "".join(f"{stage:>11}" for stage in STAGES[:-1]) + "        all"
    for name in ("p50", "p99", "max"):
        yield PLAIN, f"  {name:<21}" + "".join(f"{latency_us[stage][name]:>11.0f}" for stage in STAGES[:-1]) \
            + f"{latency_us[STAGES[-1]][name]:>11.0f}"  # fmt: skip
    yield PLAIN, ""


def _troubles(shown):
    refusals = shown["why_not_armed"]
    for check in refusals[:4]:
        yield PLAIN, f"{'not armed' if check['blocks'] else 'warning'}: {check['sentence']} {check['cure']}"
    limits = shown["limits"]
    now = ", ".join(entry["name"] for entry in limits if entry["now"])
    recent = ", ".join(f"{entry['name']} {entry['ago_s']:.0f} s ago" for entry in limits if not entry["now"])
    yield PLAIN, f"limits   now: {now or 'none'}"
    yield PLAIN, f"         recent: {recent or 'none'}"
    fault = shown["fault"]
    if fault:
        ago = "" if fault["ago_s"] is None else f", {fault['ago_s']:.0f} s ago"
        yield BOLD if fault["active"] else PLAIN, f"fault    {fault['code']}{ago}: {fault['sentence']}"
        yield PLAIN, f"         cure: {fault['cure']}"
    else:
        yield PLAIN, "fault    none so far"


class Screen:
    """The terminal while it is ours: other screen, no echo, no cursor; given back however we leave."""

    def __init__(self):
        self._in, self._out = sys.stdin.fileno(), sys.stdout.fileno()

    def __enter__(self):
        self._saved = termios.tcgetattr(self._in)
        # SIGTERM and SIGHUP become an ordinary way out, so that __exit__ runs.
        self._handlers = {number: signal.signal(number, self._leave) for number in (signal.SIGTERM, signal.SIGHUP)}
        tty.setcbreak(self._in)
        self._write("\x1b[?1049h\x1b[?25l\x1b[2J")
        return self

    def __exit__(self, *_):
        try:
            self._write("\x1b[0m\x1b[?25h\x1b[?1049l")
            termios.tcsetattr(self._in, termios.TCSADRAIN, self._saved)
        except OSError:
            pass  # the terminal is gone
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    @staticmethod
    def _leave(*_):
        raise KeyboardInterrupt

    def _write(self, text: str) -> None:
        data = text.encode()
        while data:
            data = data[os.write(self._out, data) :]

    def size(self) -> tuple[int, int]:
        """Columns and lines now: asked each time, so a resized window is right at the next page."""
        try:
            lines, columns = struct.unpack("4H", fcntl.ioctl(self._out, termios.TIOCGWINSZ, b"\0" * 8))[:2]
        except OSError:
            lines = columns = 0
        return columns or WIDTH, lines or HEIGHT

    def draw(self, made) -> None:
        """Shows a page in one write."""
        plain = "NO_COLOR" in os.environ
        # A line is cleared before it is written: after a full one, the cursor still stands on its last character.
        text = "\r\n".join(f"\x1b[K{line}" if plain or code == PLAIN else f"\x1b[K\x1b[{code}m{line}\x1b[0m" for code, line in made)
        self._write(f"\x1b[H{text}\x1b[J")

    def key(self, timeout_s: float) -> str:
        """A key that was pressed within the time, "" for none; "q" where the terminal was hung up."""
        try:
            if not select.select([self._in], [], [], timeout_s)[0]:
                return ""
            return os.read(self._in, 1).decode(errors="replace") or "q"
        except OSError:
            return "q"


def run(source, rate_hz: float) -> None:
    """Shows the view until q or Ctrl-C."""
    with Screen() as screen:
        due_s = time.monotonic()
        while True:
            source.poll()
            columns, lines = screen.size()
            screen.draw(page(source, columns, lines))
            due_s = max(due_s + 1.0 / rate_hz, time.monotonic())
            while (remaining_s := due_s - time.monotonic()) > 0.0:
                if screen.key(remaining_s) in ("q", "Q"):
                    return
