"""`mip-rt log info`: what happened in a log, in one report."""

import json
from datetime import datetime, timezone

from mip_rt.log.selection import add_log, open_named, seconds

WORST = 10
SHOWN = 20  # entries of a list in the text; the JSON has all
EDGES_US = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, float("inf"))
BAR = " ▏▎▍▌▋▊▉█"
BAR_CELLS = 6


def add_arguments(parser) -> None:
    """Declares the action's arguments."""
    add_log(parser)
    parser.add_argument("--config", metavar="FILE", help="compare the log's configuration with this one (default: the installed or shipped one)")
    parser.add_argument("--fields", action="store_true", help="list the log's fields with units and meanings instead")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments) -> int:
    """Exit code 0."""
    log = open_named(arguments)
    if arguments.fields:
        print(json.dumps(log.header["fields"]) if arguments.json else field_table(log.header))
        return 0
    found = report(log, arguments.config)
    print(json.dumps(found) if arguments.json else render(found))
    return 0


def field_table(header: dict) -> str:
    """One line a field, with the elements of estimates by name."""
    from mip_rt.log.columns import columns

    lines = []
    for entry in header["fields"]:
        shape = "".join(f"[{n}]" for n in entry["shape"])
        lines.append(f"{entry['name'] + shape:<28} {entry['unit']:<20} {entry['meaning']}")
    lines += ["", "estimators: " + ", ".join(f"[{i}] {name}" for i, name in enumerate(header.get("estimators", [])))]
    lines += ["estimates: " + ", ".join(c.name.partition(".")[2] for c in columns(header) if c.field == "estimates" and c.index[0] == 0)]
    return "\n".join(lines)


def report(log, config_path=None) -> dict:
    """Everything that `mip-rt log info --json` prints: times in seconds since the loop's first tick, latencies in microseconds.

    Raises:
        ConfigError: `config_path` was given and is not a valid configuration.
    """
    import numpy as np

    from mip_rt.log import events
    from mip_rt.log.codes import Codes

    frames, times_s, codes = log.frames, seconds(log), Codes(log.header)
    stages = events.stage_ns(frames)
    latency, histogram = {}, {}
    for stage, values in stages.items():
        us = values / 1000.0
        percentiles = np.percentile(us, (50.0, 99.0, 99.9, 100.0))
        latency[stage] = dict(zip(("p50", "p99", "p999", "max"), (round(float(p), 1) for p in percentiles), strict=True))
        histogram[stage] = np.histogram(np.maximum(us, 0.0), EDGES_US)[0].tolist()
    slowest = np.argsort(stages["edge_to_write"], kind="stable")[::-1][:WORST]
    span_s = float(frames["edge_ns"][-1] - frames["edge_ns"][0]) * 1e-9
    missed, lost = events.missed(frames, times_s), events.gaps(frames, times_s)
    passed = int(frames["tick"][-1] - frames["tick"][0]) + int(frames["missed"][1:].sum())
    changes = events.transitions(frames, times_s, codes)
    resting = frames["state"] != codes.balancing_state
    idle = frames[resting]
    header = log.header
    return {
        "log": str(log.path),
        "robot": _robot(log),
        "estimators": header.get("estimators", []),
        "started": _realtime(header, int(frames["edge_ns"][0])),
        "ticks": len(frames),
        "first_tick": int(frames["tick"][0]),
        "begin_s": round(float(times_s[0]), 6),
        "span_s": round(span_s, 6),
        "rate_hz": round(passed / span_s, 4) if span_s > 0 else 0.0,
        "missed": sum(entry["missed"] for entry in missed),
        "missed_at": missed,
        "lost": sum(entry["lost"] for entry in lost),
        "lost_at": lost,
        "latency_us": latency,
        "histogram_us": {"edges": [*EDGES_US[:-1], None], **histogram},
        "worst": [
            {**events.moment(frames, times_s, row), "state": codes.state(frames["state"][row]),
             **{stage: round(float(values[row]) / 1000.0, 1) for stage, values in stages.items()}}
            for row in slowest.tolist()
        ],
        "states": changes,
        "faults": events.faults(frames, times_s, codes),
        "limits": events.limits(frames, codes, times_s),
        "alarms": events.bits(frames, "alarms", codes, times_s),
        "refusals": events.bits(idle, "refusals", codes, times_s[resting]),
        "imu": events.bits(frames, "imu_status", codes, times_s),
        "configuration": _configuration(log, config_path),
        "recorder": _recorder(log),
        "calibration": header.get("calibration", {}),
        "code": {key: header[key] for key in ("mip_rt", "commit", "source_hash", "versions") if key in header},
        "host": header.get("host", {}),
        "run": {key: header[key] for key in ("scenario", "seed") if key in header},
        "damage": list(log.damage),
    }  # fmt: skip


def _robot(log) -> str:
    from mip_rt.log.configuration import value

    return str(value(log.config, "robot", "unknown"))


def _recorder(log) -> dict:
    """The recorder's last counters, and why it ended; empty for a ring."""
    counters = log.end or (log.recorder[-1] if log.recorder else {})
    kept = ("reason", "recorded", "dropped", "torn", "backlog_max", "errors", "sync_max_ns", "faults_kept", "faults_refused", "faults_lost")
    return {key: counters[key] for key in kept if key in counters}


def _realtime(header: dict, edge_ns: int) -> str | None:
    clock = header.get("clock", {})
    if not {"monotonic_ns", "realtime_ns"} <= set(clock):
        return None
    moment_s = (edge_ns - clock["monotonic_ns"] + clock["realtime_ns"]) * 1e-9
    return datetime.fromtimestamp(moment_s, timezone.utc).isoformat(timespec="milliseconds")


def _configuration(log, path) -> dict:
    """Differences against a file: against the one that was named, else the one that this machine would use."""
    from mip_rt import config as configuration
    from mip_rt.errors import ConfigError
    from mip_rt.log.configuration import as_dict, differences

    try:
        used = path or configuration.default_path(_robot(log))
        other = as_dict(configuration.load(used).to_yaml())
    except ConfigError:
        if path:
            raise
        return {"file": None, "differences": []}
    return {"file": str(used), "differences": [{"key": d["key"], "log": d["a"], "file": d["b"]} for d in differences(as_dict(log.config), other)]}


def render(report: dict) -> str:
    """The report for people."""
    from mip_rt.log.events import before_in_words

    r = report
    lines = [f"{r['log']}: {r['robot']}, {r['ticks']} ticks from {r['begin_s']:.3f} s on, {r['span_s']:.3f} s at {r['rate_hz']:.2f} Hz"]
    about = [f"estimators {', '.join(r['estimators']) or 'unknown'}"] + [f"{key} {value}" for key, value in r["run"].items() if value not in ("", None)]
    lines.append(f"began {r['started'] or 'at an unknown time'}; " + "; ".join(about))
    lines.append(f"{r['missed']} ticks missed, {r['lost']} rows lost")
    lines += _listed(r["missed_at"], lambda e: f"  {_when(e)}: {e['missed']} missed before")
    lines += _listed(r["lost_at"], lambda e: f"  {_when(e)}: {e['lost']} rows are not in the log before")
    lines += _recorder_line(r["recorder"])
    lines += [f"damage: {sentence}" for sentence in r["damage"]]
    lines += ["", "faults" if r["faults"] else "no fault"]
    for entry in r["faults"]:
        lines.append(f"  {_when(entry)}: {entry['code']}: {entry['sentence']}" + (f"; cure: {entry['cure']}" if entry["cure"] else ""))
        lines += [f"    {before}" for before in [before_in_words(entry)] if before]
    lines += ["", "states"]
    lines += _listed(r["states"], lambda e: f"  {_when(e)}: {e['state']}")
    for title, key in (("limits applied", "limits"), ("alarms", "alarms"), ("IMU troubles", "imu"), ("not armed because of", "refusals")):
        if r[key]:
            lines += ["", f"{title:<24} {'ticks':>8}  {'first':>10}  {'last':>10}"]
            lines += [f"  {name:<22} {e['ticks']:>8}  {e['first_s']:>8.3f} s  {e['last_s']:>8.3f} s" for name, e in r[key].items()]
    lines += ["", *_latency_table(r), *_worst_table(r), "", *_configuration_lines(r["configuration"]), "", *_code_lines(r)]
    return "\n".join(lines)


def _when(entry: dict) -> str:
    return f"{entry['time_s']:9.3f} s (tick {entry['tick']})"


def _listed(entries: list, words) -> list[str]:
    shown = [words(entry) for entry in entries[:SHOWN]]
    return shown + ([f"  ... and {len(entries) - SHOWN} more (--json has all)"] if len(entries) > SHOWN else [])


def _latency_table(r: dict) -> list[str]:
    """Percentiles and histogram: stages are columns, classes of duration are rows; bars are linear within a stage, a mark for the rarest."""
    stages = list(r["latency_us"])
    heads = [stage.replace("_", " ") for stage in stages]
    if not any(r["latency_us"][stage]["max"] for stage in stages):
        return ["latency: none, time was virtual"]
    lines = ["latency (us)".ljust(15) + "".join(f"{head:>16}" for head in heads)]
    for name in ("p50", "p99", "p999", "max"):
        lines.append(f"  {name.replace('p999', 'p99.9'):<13}" + "".join(f"{r['latency_us'][stage][name]:>16.1f}" for stage in stages))
    histogram = {stage: r["histogram_us"][stage] for stage in stages}
    used = [i for i in range(len(EDGES_US) - 1) if any(histogram[stage][i] for stage in stages)]
    for i in range(used[0], used[-1] + 1):
        low, high = EDGES_US[i], EDGES_US[i + 1]
        label = f"{low} to {high}" if high < float("inf") else f"over {low}"
        cells = "".join(f"{_bar(histogram[s][i], max(histogram[s])):>{BAR_CELLS + 1}}{histogram[s][i] or '':>9}" for s in stages)
        lines.append(f"  {label:<13}{cells}".rstrip())
    return lines


def _bar(count: int, most: int) -> str:
    eighths = max(1, round(8 * BAR_CELLS * count / most)) if count else 0
    return (BAR[8] * (eighths // 8) + BAR[eighths % 8].strip()).ljust(BAR_CELLS)


def _worst_table(r: dict) -> list[str]:
    stages = list(r["latency_us"])
    if not r["worst"][0]["edge_to_write"]:
        return []
    lines = ["", f"slowest {len(r['worst'])} ticks (us)".ljust(36) + "".join(f"{s.replace('_', ' '):>14}" for s in stages)]
    return lines + [f"  {_when(e)} {e['state']:<12}".ljust(36) + "".join(f"{e[s]:>14.1f}" for s in stages) for e in r["worst"]]


def _configuration_lines(found: dict) -> list[str]:
    from mip_rt.log.configuration import shown

    if found["file"] is None:
        return ["configuration: this machine has no valid one to compare with"]
    if not found["differences"]:
        return [f"configuration: as {found['file']}"]
    lines = [f"configuration: {len(found['differences'])} values differ from {found['file']} (log / file)"]
    return lines + [f"  {d['key']}: {shown(d['log'])} / {shown(d['file'])}" for d in found["differences"]]


def _recorder_line(counters: dict) -> list[str]:
    if not counters:
        return []
    c = {"recorded": 0, "dropped": 0, "backlog_max": 0, "errors": 0, "sync_max_ns": 0, **counters}
    line = (f"recorder: {c['recorded']} rows written, {c['dropped']} dropped, at most {c['backlog_max']} waiting, {c['errors']} refused writes, "
            f"slowest sync {c['sync_max_ns'] / 1e6:.0f} ms")  # fmt: skip
    refused = counters.get("faults_refused", 0) + counters.get("faults_lost", 0)
    line += f"; {refused} fault files not kept" if refused else ""
    return [f"{line}; ended: {counters['reason']}" if "reason" in counters else line]


def _code_lines(r: dict) -> list[str]:
    code, host = r["code"], r["host"]
    commit = code.get("commit") or {}
    at = f", commit {commit['hash'][:12]}{' with changes' if commit.get('dirty') else ''}" if commit.get("hash") else ""
    versions = ", ".join(f"{name} {version}" for name, version in code.get("versions", {}).items())
    lines = [
        f"code: mip-rt {code.get('mip_rt', 'unknown')}{at}, compiled sources {code.get('source_hash', 'unknown')}; {versions}",
        "host: " + ", ".join(str(value) for value in host.values()),
    ]
    if r["calibration"]:
        lines.append("calibration at the start: " + "; ".join(f"{name} {value}" for name, value in r["calibration"].items()))
    return lines
