"""`mip-rt log diff A B`: the first and the largest difference of each field of two logs, and of their configurations."""

import json


def add_arguments(parser) -> None:
    """Declares the action's arguments."""
    parser.add_argument("a", metavar="A", help="one log")
    parser.add_argument("b", metavar="B", help="the other")
    parser.add_argument("--align", choices=("tick", "time"), default="tick",
                        help="compare rows of the same tick, or nearest in time since each log's first row")  # fmt: skip
    parser.add_argument("--fields", metavar="A,B[0]", help="compare only these (default: all)")
    parser.add_argument("--tolerance", metavar="R", type=float, default=0.0, help="relative difference that counts as equal (default: 0)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments) -> int:
    """Exit code 0 where all compared values are equal, 1 where any differs."""
    from mip_rt import log

    a, b = log.open(arguments.a), log.open(arguments.b)
    report = compare(a, b, arguments.align, arguments.fields, arguments.tolerance)
    print(json.dumps(report) if arguments.json else render(report))
    return 0 if report["equal"] else 1


def compare(a, b, align: str = "tick", fields: str | None = None, tolerance: float = 0.0) -> dict:
    """Differences of two logs.

    NaN equals NaN. With `tolerance`, values count as equal where |a - b| <= tolerance max(|a|, |b|).

    Returns:
        equal: no compared value differs, no row and no field is in one of them only.
        rows: compared; only_a, only_b: rows in one of them only.
        fields: by column name the number of rows that differ, the first and the largest difference.
        configuration: see `configuration.differences`; it does not count for `equal`.
    """
    from mip_rt.log.columns import columns, picked
    from mip_rt.log.configuration import as_dict, differences

    rows_a, rows_b = _aligned(a, b, align)
    frames_a, frames_b = a.frames[rows_a], b.frames[rows_b]
    in_a = picked(a.header, fields)
    in_b = {column.name: column for column in columns(b.header)}
    names_a = {column.name for column in columns(a.header)}
    found = {}
    for column in in_a:
        if column.name in in_b:
            entry = _difference(column, in_b[column.name], frames_a, frames_b, tolerance)
            if entry:
                found[column.name] = {"unit": column.unit, **entry}
    report = {
        "a": str(a.path),
        "b": str(b.path),
        "rows": len(frames_a),
        "only_a": len(a.frames) - len(frames_a),
        "only_b": len(b.frames) - len(frames_b),
        "fields_only_a": sorted({column.field for column in in_a if column.name not in in_b}),
        "fields_only_b": sorted({column.field for column in in_b.values() if column.name not in names_a}) if fields is None else [],
        "fields": dict(sorted(found.items(), key=lambda item: item[1]["first"]["tick"])),
        "configuration": differences(as_dict(a.config), as_dict(b.config)),
        "damage": [f"{log.path}: {sentence}" for log in (a, b) for sentence in log.damage],
    }
    apart = found or report["only_a"] or report["only_b"] or report["fields_only_a"] or report["fields_only_b"] or not len(frames_a)
    return {"equal": not apart, **report}


def _aligned(a, b, align: str):
    """Row numbers in a and in b that belong together."""
    import numpy as np

    if align == "tick":
        _, rows_a, rows_b = np.intersect1d(a.frames["tick"], b.frames["tick"], return_indices=True)
        return rows_a, rows_b
    if not len(a.frames) or not len(b.frames):
        return np.zeros(0, int), np.zeros(0, int)
    times_a, times_b = (log.frames["edge_ns"] - log.frames["edge_ns"][0] for log in (a, b))
    after = np.clip(np.searchsorted(times_b, times_a), 1, max(1, len(times_b) - 1))
    before = after - 1
    after = np.minimum(after, len(times_b) - 1)
    near = np.where(times_a - times_b[before] <= times_b[after] - times_a, before, after)
    tick_ns = np.median(np.diff(times_a)) if len(times_a) > 1 else 5e6
    close = np.abs(times_b[near] - times_a) <= tick_ns / 2
    rows_b, first = np.unique(near[close], return_index=True)
    return np.flatnonzero(close)[first], rows_b


def _difference(column, other, frames_a, frames_b, tolerance: float) -> dict | None:
    import numpy as np

    values_a, values_b = column.of(frames_a), other.of(frames_b)
    if column.is_bytes:
        differs = (values_a != values_b).any(axis=1)
        size = (values_a != values_b).sum(axis=1).astype(float)  # how many bytes differ
    elif values_a.dtype.kind == "f" or values_b.dtype.kind == "f":
        both_nan = np.isnan(values_a) & np.isnan(values_b)
        with np.errstate(invalid="ignore"):
            size = np.abs(values_a - values_b)
            within = size <= tolerance * np.maximum(np.abs(values_a), np.abs(values_b)) if tolerance else False
        differs = ~(both_nan | (values_a == values_b) | within)
        size = np.where(np.isnan(size), np.inf, size)
    else:
        differs = values_a != values_b
        size = np.abs(values_a - values_b).astype(float)
        if tolerance:
            differs &= size > tolerance * np.maximum(np.abs(values_a), np.abs(values_b))
    rows = np.flatnonzero(differs)
    if not len(rows):
        return None
    largest = rows[np.argmax(size[rows])]

    def show(row):
        tick = int(frames_a["tick"][row])
        time_s = round(float(frames_a["edge_ns"][row] - frames_a["edge_ns"][0]) * 1e-9, 6)
        a, b = (v[row].tobytes().hex() if column.is_bytes else v[row].item() for v in (values_a, values_b))
        return {"tick": tick, "time_s": time_s, "a": a, "b": b, "difference": size[row].item()}

    return {"rows": len(rows), "first": show(rows[0]), "largest": show(largest)}


def render(report: dict) -> str:
    """The report for people."""
    from mip_rt.log.configuration import shown

    lines = [f"A {report['a']}", f"B {report['b']}", f"{report['rows']} rows compared"]
    for side in "ab":
        if report[f"only_{side}"]:
            lines[-1] += f", {report[f'only_{side}']} only in {side.upper()}"
    for side in "ab":
        if report[f"fields_only_{side}"]:
            lines.append(f"fields only in {side.upper()}: {', '.join(report[f'fields_only_{side}'])}")
    lines += [f"damage: {sentence}" for sentence in report["damage"]]
    if report["configuration"]:
        lines.append(f"configuration: {len(report['configuration'])} values differ")
        lines += [f"  {entry['key']}: {shown(entry['a'])} / {shown(entry['b'])}" for entry in report["configuration"]]
    if report["fields"]:
        lines.append(f"{len(report['fields'])} fields differ (tick: A / B), in the order in which they part:")
        width = max(len(name) for name in report["fields"])
        for name, entry in report["fields"].items():
            lines.append(f"  {name:<{width}}  in {entry['rows']} rows")
            lines += [f"    {which:<8} {_at(entry[which], entry['unit'])}" for which in ("first", "largest")]
    lines.append("equal" if report["equal"] else "different")
    return "\n".join(lines)


def _at(at: dict, unit: str) -> str:
    if isinstance(at["a"], str):
        return f"tick {at['tick']}: {at['a']} / {at['b']}, {at['difference']:.0f} bytes"
    return f"tick {at['tick']} ({at['time_s']:.3f} s): {at['a']!r} / {at['b']!r}, {at['difference']:.6g} {unit}"
