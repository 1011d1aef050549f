"""`mip-rt log plot`: one page that answers "why did it fall", as a PNG or as an interactive HTML file that needs no network."""

import sys
from pathlib import Path

from mip_rt.errors import LogError
from mip_rt.log.selection import add_log, add_window, is_window_given, open_named, seconds, window

BEFORE_FAULT_S, AFTER_FAULT_S = 3.0, 1.0  # what is shown around the last fault


def add_arguments(parser) -> None:
    """Declares the action's arguments."""
    add_log(parser)
    add_window(parser)
    parser.add_argument("--all", action="store_true", help="the whole log (default: around the last fault, where there was one)")
    parser.add_argument("--fields", metavar="A,B[0]+C", help="panels of these fields; + puts two into one panel. mip-rt log info --fields lists them")
    parser.add_argument("-o", "--output", metavar="FILE", help="ends in .png or .html (default: a .png in the present folder)")


def run(arguments) -> int:
    """Exit code 0; says where the plot is."""
    log = open_named(arguments)
    output = Path(arguments.output or f"{log.path.stem}.png")
    if output.suffix not in (".png", ".html"):
        raise LogError(f"a plot cannot be written as {output.name!r}.", "End the file's name in .png or .html.", "log_plot")
    times_s = seconds(log)
    if not is_window_given(arguments) and not arguments.all:
        _look_at_the_fault(arguments, log, times_s)
    page = build(log, times_s, window(arguments, times_s), arguments.fields)
    if output.suffix == ".png":
        from mip_rt.log.picture import write
    else:
        from mip_rt.log.interactive import write
    write(page, output)
    print(output)
    for sentence in page.verdict + log.damage:
        print(sentence, file=sys.stderr)
    return 0


def _look_at_the_fault(arguments, log, times_s) -> None:
    from mip_rt.log import events
    from mip_rt.log.codes import Codes

    rows = events.fault_rows(log.frames, Codes(log.header))
    if rows:
        arguments.begin_s = times_s[rows[-1]] - BEFORE_FAULT_S
        arguments.end_s = times_s[rows[-1]] + AFTER_FAULT_S


def build(log, times_s, mask, fields: str | None = None):
    """The page.Page of the rows in `mask`; of chosen fields where these are given (see `columns.pick_groups`).

    Raises:
        LogError: a chosen field is not in the log.
    """
    from mip_rt.log import events, panels
    from mip_rt.log.bands import bands
    from mip_rt.log.codes import Codes
    from mip_rt.log.columns import estimators
    from mip_rt.log.page import Page

    frames, times, codes = log.frames[mask], times_s[mask], Codes(log.header)
    begin, end = times[0], times[-1]
    found = [fault for fault in events.faults(log.frames, times_s, codes) if begin <= fault["time_s"] <= end]
    columns = [panels.chosen(log.header, frames, fields)] if fields else panels.standard(log, frames)
    in_control = (estimators(log.header) or ["unknown"])[0]
    heading = f"{log.path.name}: {begin:.2f} to {end:.2f} s of {times_s[0]:.2f} to {times_s[-1]:.2f} s; estimator {in_control}"
    return Page(heading, verdict(found), times, columns, bands(frames, times, codes), [(fault["time_s"], fault["code"]) for fault in found])


def verdict(faults: list) -> list[str]:
    """One or two sentences a fault."""
    from mip_rt.log.events import before_in_words

    if not faults:
        return ["no fault in this window"]
    sentences = []
    for fault in faults[-2:]:
        sentences.append(f"{fault['code']} at {fault['time_s']:.3f} s (tick {fault['tick']}): {fault['sentence']}")
        sentences += [before for before in [before_in_words(fault)] if before]
    if len(faults) > 2:
        sentences.append(f"{len(faults) - 2} earlier faults in this window")
    return sentences
