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
    from mip_rt.log import panels

    log = open_named(arguments)
    output = Path(arguments.output or f"{log.path.stem}.png")
    if output.suffix not in (".png", ".html"):
        raise LogError(f"a plot cannot be written as {output.name!r}.", "End the file's name in .png or .html.", "log_plot")
    times_s = seconds(log)
    if not is_window_given(arguments) and not arguments.all:
        _look_at_the_fault(arguments, log, times_s)
    page = panels.page(log, times_s, window(arguments, times_s), arguments.fields)
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
