"""`mip-rt log tail`: chosen fields of a running loop, live, without disturbing it; of a dead one its last row."""

import json
import math
import sys
import time

from mip_rt.errors import LogError
from mip_rt.log.folders import usual_folders

EVERY_ROW_S = 0.05  # between looks at the ring where every row is wanted


def add_arguments(parser) -> None:
    """Declares the action's arguments."""
    parser.add_argument("path", nargs="?", metavar="RING", help="ring file or folder of rings (default: the newest ring of this machine)")
    parser.add_argument("--rate", metavar="HZ", type=float, default=1.0, help="lines a second (default: 1)")
    parser.add_argument("--every", action="store_true", help="one line a tick: every row, whatever the rate")
    parser.add_argument("--fields", metavar="A,B[0]", help="columns instead of the usual line")
    parser.add_argument("--follow", action="store_true", help="wait for the next run where the loop has stopped; otherwise that ends the tail")
    parser.add_argument("--lines", metavar="N", type=int, help="end after so many lines")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")


def run(arguments) -> int:
    """Exit code 0, also when the user stops it."""
    from mip_rt.log.live import LiveRing

    if not 0.0 < arguments.rate <= 1000.0:
        raise LogError(f"--rate {arguments.rate:g} is not a rate.", "Give lines a second, for example --rate 10.", "arguments")
    try:
        with LiveRing(arguments.path or usual_folders()) as live:
            _tail(live, arguments)
    except KeyboardInterrupt:
        pass
    return 0


def _tail(live, arguments) -> None:
    import numpy as np

    printer = None
    runs = lines = 0
    told_silent = False
    next_s = time.monotonic()
    while True:
        rows = live.arrived()
        if live.runs != runs:
            runs = live.runs
            printer = _Printer(live, arguments.fields, arguments.json)
            if not arguments.json:
                print(f"{live.path}: {printer.head}", file=sys.stderr)
        if len(rows):
            told_silent = False
            for part in np.array_split(rows, len(rows)) if arguments.every else [rows]:
                print(printer.line(part), flush=True)
                lines += 1
                if lines == arguments.lines:
                    return
        elif live.silent:
            if not told_silent:
                print(_why_silent(live), file=sys.stderr)
                told_silent = True
            if not arguments.follow:
                return
        period_s = EVERY_ROW_S if arguments.every else 1.0 / arguments.rate
        next_s = max(next_s + period_s, time.monotonic())
        time.sleep(max(0.0, next_s - time.monotonic()))


def _why_silent(live) -> str:
    if live.finished:
        return "the loop has ended"
    ago = f"for {live.quiet_s:.1f} s" if math.isfinite(live.quiet_s) else "since before this machine started"
    return f"the loop has stopped: no row {ago}"


class _Printer:
    """Lines of one run."""

    def __init__(self, live, fields: str | None, as_json: bool):
        from mip_rt.log.codes import Codes
        from mip_rt.log.columns import picked
        from mip_rt.log.configuration import value

        self.codes, self.as_json = Codes(live.header), as_json
        self.columns = picked(live.header, fields) if fields else None
        self.rate_hz = float(value(live.header.get("config", ""), "realtime.rate_hz", 200.0))
        rows = live.since(0)
        self.origin_ns = int(rows["edge_ns"][0]) - round(int(rows["tick"][0]) * 1e9 / self.rate_hz) if len(rows) else None

    @property
    def head(self) -> str:
        """Names and units of the columns."""
        return "time_s (s) " + " ".join(c.title for c in self.columns) if self.columns else "newest row"

    def line(self, rows) -> str:
        """The newest of some rows as text or JSON; what is slowest, missed or limited is that of all of them."""
        newest = rows[-1:]
        if self.origin_ns is None:
            self.origin_ns = int(rows["edge_ns"][0]) - round(int(rows["tick"][0]) * 1e9 / self.rate_hz)
        time_s = round((int(newest["edge_ns"][0]) - self.origin_ns) * 1e-9, 6)
        if self.columns is None:
            usual = _usual(rows, time_s, self.codes)
            return json.dumps(usual) if self.as_json else _usual_text(usual)
        values = {c.name: c.of(newest)[0].tobytes().hex() if c.is_bytes else c.of(newest)[0].item() for c in self.columns}
        if self.as_json:
            return json.dumps({"tick": int(newest["tick"][0]), "time_s": time_s, **{n: _json(v) for n, v in values.items()}})
        return f"{time_s:.3f} " + " ".join(v if isinstance(v, str) else f"{v:.6g}" if isinstance(v, float) else str(v) for v in values.values())


def _json(value):
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _usual(rows, time_s: float, codes) -> dict:
    """What one wants to know at a glance, of fields that every robot has."""
    from mip_rt.log.events import bits, limits

    row = rows[-1]
    return {
        "tick": int(row["tick"]),
        "time_s": time_s,
        "state": codes.state(row["state"]),
        "fault": codes.fault(row["fault"]),
        "lean_rad": _json(round(math.hypot(row["attitude_rad"][0], row["attitude_rad"][1]), 6)),
        "yaw_rate_rad_s": _json(round(float(row["gyro_rad_s"][2]), 6)),
        "battery_v": _json(round(float(row["battery_v"]), 4)),
        "remote_age_s": _json(round(float(row["remote_age_s"]), 4)),
        "duty": [_json(round(float(d), 4)) for d in row["duty"]],
        "slowest_us": round(int((rows["write_ns"] - rows["edge_ns"]).max()) / 1000.0, 1),
        "missed": int(rows["missed"].sum()),
        "limits": list(limits(rows, codes)),
        "alarms": list(bits(rows, "alarms", codes)),
    }


def _usual_text(u: dict) -> str:
    duties = " ".join(f"{d:+.2f}" if d is not None else "    -" for d in u["duty"])

    def number(name, width, digits, factor=1.0):
        return f"{u[name] * factor:{width}.{digits}f}" if u[name] is not None else "-".rjust(width)

    text = (
        f"{u['time_s']:9.3f} s  {u['state']:<11} lean {number('lean_rad', 5, 1, 180.0 / math.pi)} deg  "
        f"yaw {number('yaw_rate_rad_s', 6, 2, 0.5 / math.pi)} Hz  duty {duties}  {number('battery_v', 5, 2)} V  "
        f"remote {number('remote_age_s', 5, 2)} s  slowest {u['slowest_us']:5.0f} us"
    )
    text += f"  {u['missed']} missed" if u["missed"] else ""
    text += f"  fault {u['fault']}" if u["fault"] != "none" else ""
    text += f"  alarms: {', '.join(u['alarms'])}" if u["alarms"] else ""
    return text + (f"  limits: {', '.join(u['limits'])}" if u["limits"] else "")
