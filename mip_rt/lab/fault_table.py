"""The table of the README: for each fault what is promised, and the worst that was seen in at least a hundred seeded injections.

Each fault is injected alone, with its shipped parameters, into a robot that drives and spins at random, and is over before the next one.
"""

import math

from mip_rt.fake.faults import ANY, FAULTS, OFF, RIDES, ZERO
from mip_rt.lab import batch
from mip_rt.lab.soak import RUN_S, Job, work


def _runs(name: str, seed: int, wanted: int, duration_s: float) -> list[Job]:
    """So many runs that the fault is injected `wanted` times."""
    listed, planned = [], 0
    while planned < wanted:
        job = Job(seed + len(listed), duration_s, (name,), shipped_values=True)
        planned += sum(event.fault is not None for event in job.script().events)
        listed.append(job)
    return listed


def judge(name: str, found: list) -> dict:
    """One row: promise, number of injections while balancing, worst figure, number of failures, reactions."""
    kind = FAULTS[name]
    found = [reaction for reaction in found if reaction.armed]
    off = [reaction.off_s for reaction in found if reaction.off_s is not None]
    row = {"promise": kind.promise, "bound_s": kind.bound_s, "lean_rad": max((reaction.lean_rad for reaction in found), default=0.0)}
    row["worst_s"] = max(off, default=None)
    if kind.promise == OFF:
        row["failed"] = sum(reaction.off_s is None or reaction.off_s > kind.bound_s + 1e-9 for reaction in found)
    elif kind.promise == ZERO:
        found = [reaction for reaction in found if reaction.zero_s is not None or not reaction.codes]
        row["worst_s"] = max((reaction.zero_s for reaction in found if reaction.zero_s is not None), default=None)
        row["failed"] = sum(reaction.zero_s is None or reaction.zero_s > kind.bound_s + 1e-9 for reaction in found)
    else:
        row["failed"] = sum(reaction.off_s is not None or reaction.fell for reaction in found) if kind.promise == RIDES else 0
    codes = {}
    for reaction in found:
        for code in reaction.codes:
            codes[code] = codes.get(code, 0) + 1
    row |= {"injected": len(found), "went_off": len(off), "fell": sum(reaction.fell for reaction in found), "reactions": codes}
    return row


def measure(names, injections: int, seed: int, arguments) -> dict:
    """{"faults": {name: row}, "broken": [...]} of the named faults, or of all that can be injected on virtual time."""
    names = list(names) or [name for name, kind in FAULTS.items() if kind.weight]
    found = {name: [] for name in names}
    broken, next_seed = [], {}
    lacking = {name: injections for name in names}
    while lacking:
        listed = []
        for name, count in lacking.items():
            lasts_s = FAULTS[name].parameters["for_s"].default if FAULTS[name].lasts else 0.0
            runs = _runs(name, next_seed.get(name, seed), math.ceil(1.05 * count), max(RUN_S, 8.0 * lasts_s))
            next_seed[name] = runs[-1].seed + 1
            listed += runs
        for job, result in batch.completed(work, listed, "runs", arguments.cluster, arguments.workers):
            found[job.names[0]] += result["reactions"]
            broken += [(job.names[0], job.seed, *entry) for entry in result["broken"]]
        rows = {name: judge(name, found[name]) for name in names}
        if broken:
            break
        lacking = {name: injections - row["injected"] for name, row in rows.items() if row["injected"] < injections}
    return {"faults": rows, "broken": broken}


def render(report: dict) -> str:
    """Markdown."""
    lines = ["| fault | boundary | what happens | promise | injected | worst seen | result |", "|---|---|---|---|---|---|---|"]
    for name, row in report["faults"].items():
        kind = FAULTS[name]
        bound = f" within {row['bound_s'] * 1e3:g} ms" if row["promise"] in (OFF, ZERO) else ""
        worst = f"{row['worst_s'] * 1e3:.0f} ms" if row["worst_s"] is not None else f"lean {math.degrees(row['lean_rad']):.1f} deg"
        result = "kept" if not row["failed"] else f"FAILED {row['failed']} times"
        if row["promise"] == ANY:
            result += f": off {row['went_off']} times" if row["went_off"] else ": balances on"
        lines.append(f"| `{name}` | {kind.boundary} | {kind.meaning} | {row['promise']}{bound} | {row['injected']} | {worst} | {result} |")
    lines += [f"\nbroken promise {promise!r} at {at_s:.2f} s, fault {name}, seed {seed}: {sentence}" for name, seed, promise, at_s, sentence in report["broken"]]
    return "\n".join(lines)
