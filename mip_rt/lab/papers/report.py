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
.good { color: #06703a; } .part { color: #9a6200; } .bad { color: #b00020; } code { background: #f4f4f4; padding: 1px 4px; }
details { margin: .6em 0; } summary { cursor: pointer; color: #555; }
"""
CLASSES = {"reproduced": "good", "partly": "part", "not reproduced": "bad"}
escape = html.escape


def number(value, digits: int) -> str:
    """A number with so many significant digits; empty for None."""
    if value is None:
        return ""
    return "∞" if value == float("inf") else f"{value:.{digits}g}" if value else "0"


def _verdict(verdict: str) -> str:
    return f'<b class="{CLASSES[verdict]}">{escape(verdict)}</b>'


def _published(row) -> str:
    """The cells beside ours."""
    kind = "bad" if row["verdict"].startswith("no") else "good"
    return f'<td class="n">{number(row["published"], row["digits"])}</td><td class="{kind}">{escape(row["verdict"])}</td>'


def _section(name, experiment, found, command) -> str:
    compared = any(r["published"] is not None for r in found["rows"])
    rows = "".join(
        f'<tr><td>{escape(r["what"])}</td><td class="n">{number(r["ours"], r["digits"])}</td>' + _published(r) * compared + "</tr>"
        for r in found["rows"]
    )
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
    heads = "<th>published</th><th></th>" * compared
    table = f"<table><tr><th></th><th>ours</th>{heads}</tr>{rows}</table>" if rows else ""
    return (
        f'<h3 id="{name}">{escape(", ".join(experiment.shows))}: {escape(experiment.title)}</h3><p>{_verdict(found["verdict"])} · <code>{escape(command)}</code></p>'
        f"<ul>{claims}</ul>{table}{notes}{pictures}<details><summary>Settings</summary><table>{settings}</table></details>"
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
        "comparisons below it: <b>reproduced</b> if all hold, <b>partly</b> if some do.</p>"
    ]
    summary = "".join(
        f'<tr><td><a href="#{name}">{escape(name)}</a></td><td>{escape(e.title)}</td><td>{_verdict(results[name]["verdict"])}</td></tr>'
        for name, e in experiments.items()
        if name in results
    )
    body.append(f"<table><tr><th>experiment</th><th></th><th>verdict</th></tr>{summary}</table>")
    listed = entries(experiments)
    for paper, (title, _) in PAPERS.items():
        body.append(f"<h2>{escape(title)}</h2>")
        lines = "".join(
            f"<tr><td>{escape(e.item)}</td><td>{_link(e, results) if e.experiment else escape('not shown: ' + e.reason)}</td></tr>"
            for e in listed
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
