"""The verb `mip-rt reproduce`: the tables and figures of five papers from the shipped models, ours beside the published."""

import json
import sys
import time
from pathlib import Path

from mip_rt.errors import ConfigError
from mip_rt.lab import batch
from mip_rt.progress import progress

REPORT = "report.html"


def add_arguments(parser) -> None:
    """Declares the arguments."""
    parser.add_argument(
        "name",
        metavar="NAME|list|all|broad",
        help="an experiment, or list (every table and figure with its status), or all; broad: the onboard attitude on recordings of the BROAD benchmark",
    )
    parser.add_argument("--data", metavar="FOLDER", help="broad: folder of the recordings")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of all randomness (default 1)")
    parser.add_argument("--quick", action="store_true", help="shorter runs: minutes become seconds, numbers are rougher")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("reproduce"),
        metavar="FOLDER",
        help="where pictures and the report go (default: ./reproduce)",
    )
    parser.add_argument(
        "--json", action="store_true", help="print the numbers as one JSON object, and nothing else, on standard output"
    )
    batch.add_arguments(parser)


def perform(job: tuple) -> dict:
    """Packed result of one experiment: job is (name, seed, quick, show progress)."""
    from mip_rt.lab.papers import experiments

    name, seed, quick, show = job
    begin = time.monotonic()

    def told(done, total):
        if show:
            progress(done, total, name)

    found = experiments()[name].run(seed, quick, told).packed()
    told(1, 1)
    return {**found, "elapsed_s": round(time.monotonic() - begin, 1)}


def run(arguments) -> int:
    """Exit code 0: everything ran; what it shows is in the verdicts. `broad` ends as `mip-rt bench broad`.

    Raises:
        ConfigError: there is no such experiment, or the folder cannot be written.
    """
    begin = time.monotonic()  # what the equations' compilation takes, the first time, counts
    from mip_rt.config.suggestion import nearest
    from mip_rt.lab.papers import experiments

    if arguments.name == "broad":
        from mip_rt.lab import broad

        return broad.report(arguments.data, arguments.json, progress)
    known = experiments()
    if arguments.name == "list":
        _print_list(known, arguments.json)
        return 0
    if arguments.name not in (*known, "all"):
        raise ConfigError(
            f"there is no experiment {arguments.name!r}{nearest(arguments.name, (*known, 'broad'))}.",
            "mip-rt reproduce list names them.",
            "arguments",
        )
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"{arguments.out} cannot be made: {error.strerror}.", "Name another folder: --out FOLDER.", "arguments"
        ) from error
    if arguments.name == "all":
        jobs = [(name, arguments.seed, arguments.quick, False) for name in known]
        results = {
            job[0]: found for job, found in batch.completed(perform, jobs, "experiments", arguments.cluster, arguments.workers)
        }
        results = {name: results[name] for name in known}
    else:
        results = {arguments.name: perform((arguments.name, arguments.seed, arguments.quick, not arguments.json))}
    files = _write_pictures(results, arguments.out)
    if arguments.name == "all":
        from mip_rt.lab.papers import report

        files.append(arguments.out / REPORT)
        files[-1].write_text(
            report.page(known, results, arguments.seed, arguments.quick, time.monotonic() - begin), encoding="utf-8"
        )
    if arguments.json:
        print(json.dumps({name: _plain(found) for name, found in results.items()}))
        return 0
    for name, found in results.items():
        _print_result(name, known[name], found, brief=arguments.name == "all")
    if files:
        print("wrote " + (str(files[-1]) if arguments.name == "all" else ", ".join(map(str, files))))
    return 0


def _write_pictures(results, folder: Path) -> list[Path]:
    written = []
    for found in results.values():
        for figure in found["figures"]:
            path = folder / f"{figure['name']}.{figure['kind']}"
            path.write_bytes(figure["picture"])
            written.append(path)
    return written


def _plain(found: dict) -> dict:
    """Without the pictures' bytes; infinity becomes null, which JSON lacks."""
    rows = [{**row, "ours": row["ours"] if abs(row["ours"]) < float("inf") else None} for row in found["rows"]]
    figures = [f"{figure['name']}.{figure['kind']}" for figure in found["figures"]]
    return {**found, "rows": rows, "figures": figures}


def _print_list(known, as_json: bool) -> None:
    from mip_rt.lab.papers.catalogue import PAPERS, entries

    listed = entries(known)
    if as_json:
        print(json.dumps([entry._asdict() for entry in listed]))
        return
    for paper, (title, _) in PAPERS.items():
        print(title)
        for entry in listed:
            if entry.paper == paper:
                print(f"  {entry.item:<10} {entry.experiment or '-- ' + entry.reason}")
    print(
        f"{sum(1 for e in listed if e.experiment)} of {len(listed)} tables and figures, by {len(known)} experiments; run one with: mip-rt reproduce NAME"
    )
    print("Beside the papers: mip-rt reproduce broad --data FOLDER, the onboard attitude on recordings of the BROAD benchmark")


def _print_result(name, experiment, found, brief: bool) -> None:
    from mip_rt.lab.papers.report import listed, number, published

    print(f"{name}: {found['verdict']} ({listed(experiment.shows) or experiment.title}; {found['elapsed_s']:.0f} s)")
    if brief:
        return
    width = max((len(row["what"]) for row in found["rows"]), default=0)
    if found["rows"]:
        print(f"  {'':<{width}} {'ours':>10} {'published':>10}")
    for row in found["rows"]:
        print(
            f"  {row['what']:<{width}} {number(row['ours'], row['digits']):>10} {published(row['published']):>10}  {row['verdict']}"
        )
    for claim in found["claims"]:
        print(f"  {'holds' if claim['holds'] else 'DOES NOT HOLD'}: {claim['text']}")
    for note in found["notes"]:
        print(f"  {note}")
    sys.stdout.flush()
