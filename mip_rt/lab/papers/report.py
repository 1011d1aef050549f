"""The report of a reproduction as one HTML file that needs nothing else: tables, pictures, settings, commands, verdicts."""

import base64
import html

from mip_rt import __version__
from mip_rt.lab.papers.catalogue import PAPERS, entries

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1080px; margin: 2em auto; padding: 0 1em; color: #222; }
h1, h2, h3 { line-height: 1.2; } h2 { margin-top: 2.5em; border-bottom: 2px solid #ddd; } h3 { margin-top: 2em; }
table { border-collapse: collapse; margin: 1em 0; font-size: 13px; } td, th { border-bottom: 1px solid #e4e4e4; padding: 3px 10px; text-align: left; vertical-align: top; }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
img { max-width: 100%; border: 1px solid #eee; } figure { margin: 1em 0; } figcaption { font-size: 13px; color: #555; }
caption { text-align: left; font-weight: 600; padding: 4px 0; } th.n { text-align: right; } small { color: #777; }
.good { color: #06703a; } .part { color: #9a6200; } .bad { color: #b00020; } code { background: #f4f4f4; padding: 1px 4px; }
details { margin: .6em 0; } summary { cursor: pointer; color: #555; }
"""
CLASSES = {"reproduced": "good", "partly": "part", "not reproduced": "bad"}
escape = html.escape


def number(value, digits: int) -> str:
    """A number with so many significant digits."""
    if value == float("inf"):
        return "∞"
    if not value:
        return "0"
    if 1000.0 <= abs(value) < 1e5:
        return f"{value:.0f}"
    text = f"{value:#.{digits}g}"
    mantissa, e, exponent = text.partition("e")
    return mantissa.rstrip(".") + e + exponent


def published(value) -> str:
    """The paper's number as it prints it, or its range; empty for None."""
    if value is None:
        return ""
    return f"{value[0]:g} to {value[1]:g}" if isinstance(value, (tuple, list)) else f"{value:g}"


def listed(shows) -> str:
    """The items' names, runs of figures as such: "Table 6.1, Figs 6.9 to 6.13"."""
    runs = []
    for item in shows:
        kind, name = item.split(" ")
        chapter, _, last = name.rpartition(".")
        if runs and last.isdigit() and runs[-1][:2] == (kind, chapter) and runs[-1][3] + 1 == int(last):
            runs[-1] = (kind, chapter, runs[-1][2], int(last))
        else:
            number = int(last) if last.isdigit() else -9
            runs.append((kind, chapter, number if last.isdigit() else last, number))
    told = []
    for kind, chapter, first, last in runs:
        dot = f"{chapter}." if chapter else ""
        plural = kind.replace("Fig.", "Figs").replace("Table", "Tables")
        if last < 0 or first == last:
            told.append(f"{kind} {dot}{first}")
        else:
            told.append(f"{plural} {dot}{first} {'and' if last == first + 1 else 'to'} {dot}{last}")
    return ", ".join(told)


def _verdict(verdict: str) -> str:
    return f'<b class="{CLASSES[verdict]}">{escape(verdict)}</b>'


def _colour(row) -> str:
    return "bad" if row["verdict"].startswith("no") else "good" if row["verdict"] else ""


def _lines(rows) -> str:
    """A table of one line a number."""
    if not rows:
        return ""
    compared = any(r["published"] is not None for r in rows)
    body = "".join(
        f'<tr><td>{escape(r["what"])}</td><td class="n">{number(r["ours"], r["digits"])}</td>'
        + f'<td class="n">{published(r["published"])}</td><td class="{_colour(r)}">{escape(r["verdict"])}</td>' * compared
        + "</tr>"
        for r in rows
    )
    heads = "<th class=n>published</th><th></th>" * compared
    return f"<table><tr><th></th><th class=n>ours</th>{heads}</tr>{body}</table>"


def _grids(rows) -> str:
    """Rows that name a cell, as tables like the paper's: ours, and the published number below it."""
    grids = {}
    for row in rows:
        title, line, column = row["cell"]
        grids.setdefault(title, {}).setdefault(line, {})[column] = row
    told = []
    for title, lines in grids.items():
        columns = list(dict.fromkeys(column for cells in lines.values() for column in cells))
        heads = "".join(f"<th class=n>{escape(str(column))}</th>" for column in columns)
        body = "".join(
            f"<tr><td>{escape(str(line))}</td>" + "".join(_cell(cells.get(column)) for column in columns) + "</tr>"
            for line, cells in lines.items()
        )
        told.append(f"<table><caption>{escape(title)}</caption><tr><th></th>{heads}</tr>{body}</table>")
    return "".join(told)


def _cell(row) -> str:
    if row is None:
        return "<td></td>"
    beside = "" if row["published"] is None else f'<br><small>{published(row["published"])}</small>'
    hint = escape(row["what"] + (": " + row["verdict"] if row["verdict"] else ""))
    return f'<td class="n {_colour(row)}" title="{hint}">{number(row["ours"], row["digits"])}{beside}</td>'


def _section(name, experiment, found, command) -> str:
    claims = "".join(
        f'<li class="{"good" if c["holds"] else "bad"}">{"holds" if c["holds"] else "does not hold"}: {escape(c["text"])}</li>'
        for c in found["claims"]
    )
    notes = "".join(f"<p>{escape(note)}</p>" for note in found["notes"])
    pictures = "".join(
        f'<figure><img alt="{escape(f["caption"])}" src="data:image/{f["kind"]};base64,{base64.b64encode(f["picture"]).decode()}">'
        f"<figcaption>{escape(f['caption'])}</figcaption></figure>"
        for f in found["figures"]
    )
    settings = "".join(f"<tr><td>{escape(k)}</td><td>{escape(v)}</td></tr>" for k, v in found["settings"].items())
    tables = _grids([r for r in found["rows"] if r["cell"]]) + _lines([r for r in found["rows"] if not r["cell"]])
    return (
        f'<h3 id="{name}">{escape(": ".join(filter(None, (listed(experiment.shows), experiment.title))))}</h3>'
        f'<p>{_verdict(found["verdict"])} · <code>{escape(command)}</code> · {found.get("elapsed_s", 0.0):.0f} s</p>'
        f"<ul>{claims}</ul>{tables}{notes}{pictures}<details><summary>Settings</summary><table>{settings}</table></details>"
    )


def page(experiments, results, seed: int, quick: bool, elapsed_s: float) -> str:
    """The report's text.

    Args:
        experiments: {name: Experiment}.
        results: {name: packed result}; experiments that were not run are listed without.
    """
    flags = f" --seed {seed}" + (" --quick" if quick else "")
    body = [
        f"<h1>Five papers, run again</h1><p>mip-rt {__version__}, <code>mip-rt reproduce all{flags}</code>, {elapsed_s / 60:.1f} minutes. "
        "Measured data of the papers is not available: wherever a paper measured, a simulation with named imperfections "
        "stands in its place. A verdict is derived from the "
        "comparisons below it: <b>reproduced</b> if all hold, <b>partly</b> if some do. In a table like a paper's the small number is the "
        "published one; green agrees, red does not, within the tolerance that the cell's hint names.</p>"
    ]
    summary = "".join(
        f'<tr><td><a href="#{name}">{escape(name)}</a></td><td>{escape(listed(e.shows))}</td><td>{escape(e.title)}</td><td>{_verdict(results[name]["verdict"])}</td></tr>'
        for name, e in experiments.items()
        if name in results
    )
    body.append(f"<table><tr><th>experiment</th><th>shows</th><th></th><th>verdict</th></tr>{summary}</table>")
    every = entries(experiments)
    shown = sum(1 for entry in every if entry.experiment)
    verdicts = [results[name]["verdict"] for name in experiments if name in results]
    counts = ", ".join(f"{verdicts.count(kind)} {kind}" for kind in CLASSES if kind in verdicts)
    body.append(
        f"<p>{len(verdicts)} experiments: {counts}. They show {shown} of the {len(every)} numbered tables and figures; what the other "
        f"{len(every) - shown} are, and why none of our models produces them, the list at the head of each paper says.</p>"
    )
    for paper, (title, _) in PAPERS.items():
        body.append(f"<h2>{escape(title)}</h2>")
        lines = "".join(
            f"<tr><td>{escape(e.item)}</td><td>{_link(e, results) if e.experiment else escape('not shown: ' + e.reason)}</td></tr>"
            for e in every
            if e.paper == paper
        )
        body.append(f"<details><summary>All numbered tables and figures</summary><table>{lines}</table></details>")
        body += [
            _section(name, e, results[name], f"mip-rt reproduce {name}{flags}")
            for name, e in experiments.items()
            if e.paper == paper and name in results
        ]
    return f'<!doctype html><html lang="en"><meta charset="utf-8"><title>mip-rt reproduce</title><style>{STYLE}</style><body>{"".join(body)}</body></html>\n'


def _link(entry, results) -> str:
    verdict = f" {_verdict(results[entry.experiment]['verdict'])}" if entry.experiment in results else " (not run)"
    return f'<a href="#{entry.experiment}">{escape(entry.experiment)}</a>{verdict}'
