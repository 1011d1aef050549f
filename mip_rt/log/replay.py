"""The verb `mip-rt replay`: runs a log through the same compiled step again and asserts that the same comes out.

By default every output of every tick must equal the recorded one: bit for bit on the type of machine that recorded it, to 1e-9 of each
column's largest magnitude on another. With --force, or with anything changed by --config, --set, --estimator or --shadow, nothing is
asserted and the differences are shown.
"""

import json
import math
import time
from pathlib import Path

from mip_rt.log.selection import add_log, find

PROGRESS_FROM = 100_000  # rows: shorter replays are over before a bar could be read
LISTED = 12  # differing fields that are printed without --compare


def add_arguments(parser) -> None:
    """Declares the verb's arguments."""
    add_log(parser)
    parser.add_argument("--force", action="store_true", help="changed code: assert nothing, show how much each field differs")
    changes = parser.add_argument_group(
        "what would it have done",
        "These change the robot and assert nothing. Sensors and remote are the recorded ones, and the estimators are told the\n"
        "recorded command, since that is what moved the robot: what comes out is how the changed estimators would have seen\n"
        "this run, and what the changed controller would have asked for at each of its moments; not how the robot would have moved.",
    )
    changes.add_argument("--config", metavar="FILE", help="this configuration in place of the log's")
    changes.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help="change one value of the configuration; repeatable")
    changes.add_argument("--estimator", metavar="NAME", help="the estimator in control; the log's others become shadows")
    changes.add_argument("--shadow", metavar="NAME", action="append", default=[],
                         help="estimators beside it, in place of the log's; repeatable")  # fmt: skip
    parser.add_argument("--from", dest="begin", metavar="S|tTICK",
                        help="first tick that counts: 6.5 is seconds since the loop's first tick, t1300 is a tick; the replay resumes at the "
                        "last state row before it")  # fmt: skip
    parser.add_argument("--to", dest="end", metavar="S|tTICK", help="first tick that no longer counts, likewise")
    parser.add_argument("--compare", action="store_true", help="print recorded against replayed: RMS and largest difference of each column")
    parser.add_argument("--plot", metavar="FILE", type=Path, help="draw recorded against replayed into a PNG, PDF or SVG file (needs matplotlib)")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object, and nothing else, on standard output")


def run(arguments) -> int:
    """Exit code 0 where everything was equal or nothing is asserted, 1 where something differs.

    Raises:
        MipRtError: the log cannot be read or replayed.
    """
    from mip_rt import log as logs
    from mip_rt.log.comparison import Comparison
    from mip_rt.log.comparison_plot import Traces, draw
    from mip_rt.log.rerun import Rerun

    log = logs.open(find(arguments.path), check=False)  # a damaged row is replayed, too: the replay says which field is wrong
    config, overrides = _changes(arguments, log)
    asserted = not (arguments.force or config or overrides)
    rerun = Rerun(log, overrides, config, asserted, (arguments.begin, arguments.end))
    slots = None if rerun.names == rerun.recorded_names else rerun.recorded_slots
    comparison = Comparison(log.frames, rerun.outputs, not rerun.other_machine, slots, arguments.compare)
    traces = Traces(rerun) if arguments.plot else None
    begin_s = time.perf_counter()
    _compare(rerun, comparison, traces)
    report = _report(rerun, comparison, asserted, time.perf_counter() - begin_s, arguments.compare)
    if traces:
        draw(arguments.plot, traces, log.path.name)
    print(json.dumps(report) if arguments.json else render(report))
    return 0 if report["equal"] or not asserted else 1


def _changes(arguments, log):
    """(configuration in place of the log's or None, changes to the log's)."""
    from mip_rt import config as configuration

    overrides = dict(configuration.parse_override(text) for text in arguments.set)
    shadows = arguments.shadow
    if arguments.estimator:
        overrides["estimator.control"] = arguments.estimator
        shadows = shadows or [name for name in log.header.get("estimators", ()) if name != arguments.estimator]
    if shadows:
        overrides["estimator.shadows"] = f"[{', '.join(shadows)}]"
    return (configuration.load(arguments.config, overrides) if arguments.config else None), overrides


def _compare(rerun, comparison, traces=None) -> None:
    from mip_rt.progress import progress

    done, total = 0, rerun.count
    for recorded, replayed, state_ticks, counted in rerun.batches():
        if counted:
            comparison.take(recorded[-counted:], replayed[-counted:])
            if traces:
                traces.take(recorded[-counted:], replayed[-counted:])
        comparison.state_ticks += state_ticks
        done += len(recorded)
        if total > PROGRESS_FROM:
            progress(done, total, "ticks replayed")


def replay(log, **options):
    """(Rerun, Comparison) of a log with its own configuration and everything asserted, for tests and tools.

    Args:
        log: what `mip_rt.log.open` returns.
        options: `limits`, as in Rerun.
    """
    from mip_rt.log.comparison import Comparison
    from mip_rt.log.rerun import Rerun

    rerun = Rerun(log, **options)
    comparison = Comparison(log.frames, rerun.outputs, not rerun.other_machine)
    _compare(rerun, comparison)
    return rerun, comparison


def label(rerun, field: str, column: int) -> str:
    """The name of one column of a field, such as `estimates[ekf].pitch_rad` or `gyro_rad_s[2]`."""
    shape = rerun.layout.dtype[field].shape
    if not shape:
        return field
    if field in ("estimates", "estimator_flags"):
        names = rerun.layout.estimate_names
        slot, number = divmod(column, len(names)) if field == "estimates" else (column, None)
        slot = rerun.names[slot] if slot < len(rerun.names) else slot
        return f"{field}[{slot}]" + (f".{names[number]}" if number is not None else "")
    return f"{field}[{column}]"


def _number(value):
    """For JSON, which knows neither infinity nor NaN."""
    return value if math.isfinite(value) else str(value)


def _report(rerun, comparison, asserted: bool, seconds: float, columns: bool) -> dict:
    frames, spans = rerun.log.frames, rerun.spans
    units = {f.name: f.unit for f in rerun.layout.fields}
    fields = {
        name: {
            "unit": units[name],
            "ticks": comparison.columns[name].ticks,
            "largest_difference": _number(float(comparison.columns[name].largest.max())),
            "relative": _number(comparison.relative(name)),
        }
        for name in comparison.differing()
    }
    first = comparison.first
    report = {
        "log": str(rerun.log.path),
        "damage": rerun.log.damage,
        "asserted": asserted,
        "equal": comparison.equal,
        "bit_for_bit": comparison.exact,
        "first_difference": first and {
            "tick": first.tick,
            "time_s": round(float(rerun.times_s[frames["tick"].searchsorted(first.tick)]), 6),
            "field": label(rerun, first.field, first.column),
            "recorded": _number(first.recorded),
            "replayed": _number(first.replayed),
        },
        "state_rows_differing": comparison.state_ticks,
        "ticks": comparison.rows,
        "first_tick": int(frames["tick"][max(spans[0].begin, rerun.first)]),
        "last_tick": int(frames["tick"][spans[-1].end - 1]),
        "resumed_at": [int(frames["tick"][span.begin]) for span in spans],
        "fresh_at": rerun.cold_ticks,
        "state_rows_of_other_layout": rerun.unfit_states,
        "not_replayed": rerun.skipped,
        "estimators": rerun.names,
        "other_sources": rerun.other_sources,
        "other_machine": rerun.other_machine,
        "missing_inputs": rerun.missing,
        "seconds": round(seconds, 4),
        "times_real_time": round(rerun.count * rerun.dt_s / seconds, 1),
        "fields": fields,
    }
    if columns:
        report["columns"] = [line for name in fields for line in _columns(rerun, comparison, name)]
    return report


def _columns(rerun, comparison, name):
    from mip_rt.log.columns import unit_of

    column = comparison.columns[name]
    unit = next(f.unit for f in rerun.layout.fields if f.name == name)
    for i in range(len(column.largest)):
        if not column.largest[i]:
            continue
        recorded, replayed, gap = (math.sqrt(total / column.rows) for total in column.squares[:, i])
        yield {
            "column": label(rerun, name, i),
            "unit": unit_of(label(rerun, name, i), unit),
            "rms_recorded": recorded,
            "rms_replayed": replayed,
            "rms_difference": gap,
            "largest_difference": _number(float(column.largest[i])),
            "at_tick": int(column.at_tick[i]),
        }


def render(report: dict) -> str:
    """The report for people."""
    lines = [
        f"replayed ticks {report['first_tick']} to {report['last_tick']} ({report['ticks']}) in {report['seconds']:.2f} s, "
        f"{report['times_real_time']:.0f} times real time; estimators {', '.join(report['estimators'])}"
    ]
    lines += [f"log: {sentence}" for sentence in report["damage"]]
    resumed = report["resumed_at"]
    if resumed != [0]:
        lines.append(f"state taken up at tick {', '.join(map(str, resumed[:8]))}{' ...' if len(resumed) > 8 else ''}")
    if report["fresh_at"]:
        lines.append(f"no state row that fits: fresh start at tick {report['fresh_at'][0]}; the first seconds show how filters settle")
    if report["state_rows_of_other_layout"]:
        lines.append("the log's state rows are of a program whose state had other fields: no replay can resume there")
    if report["not_replayed"]:
        lines.append(f"{report['not_replayed']} ticks have no state row before them and were not replayed")
    if report["missing_inputs"]:
        lines.append(f"the log lacks {', '.join(report['missing_inputs'])}; zero was taken")
    if report["other_sources"]:
        lines.append("the log was recorded by other sources than these")
    if report["other_machine"]:
        changed = ", ".join(f"{item} {there} -> {here}" for item, (there, here) in report["other_machine"].items())
        lines.append(f"recorded on another type of machine ({changed}): compared to 1e-9, with the recorded command in force")
    lines += _differences(report)
    return "\n".join(lines)


def _differences(report: dict):
    how = "bit for bit" if report["bit_for_bit"] else "to 1e-9 relative"
    fields, first = report["fields"], report["first_difference"]
    if report["equal"]:
        yield f"equal {how}"
    else:
        if first:
            words = f"NOT EQUAL {how}: first" if report["asserted"] else "first difference"
            yield (f"{words} at tick {first['tick']} ({first['time_s']:.3f} s) in {first['field']}: "
                   f"recorded {first['recorded']!r}, replayed {first['replayed']!r}")  # fmt: skip
        if report["state_rows_differing"]:
            yield f"NOT EQUAL: the state after tick {report['state_rows_differing'][0]} is not that of the log's state row"
    if "columns" in report:
        yield f"{'column':<40} {'unit':<10} {'rms recorded':>13} {'rms replayed':>13} {'rms diff.':>11} {'largest':>11}  at tick"
        for c in report["columns"]:
            yield (f"{c['column']:<40} {c['unit'][:10]:<10} {c['rms_recorded']:>13.6g} {c['rms_replayed']:>13.6g} {c['rms_difference']:>11.3g} "
                   f"{float(c['largest_difference']):>11.3g}  {c['at_tick']}")  # fmt: skip
        return
    for name in list(fields)[:LISTED]:
        f = fields[name]
        size = f"largest difference {float(f['largest_difference']):.3g}, relative {float(f['relative']):.1e}"
        yield f"  {name:<26} {f['ticks']:>8} ticks" + ("" if f["unit"] == "bits" else f"  {size}")
    if len(fields) > LISTED:
        yield f"  and {len(fields) - LISTED} more fields: --json names all"
