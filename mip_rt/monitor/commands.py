"""`mip-rt monitor`: watches a running loop through its ring, without a word to the loop itself."""

import json
import os
import sys
import time

from mip_rt.errors import ConfigError

NICENESS = 10  # whoever watches comes after what is watched


def add_arguments(parser) -> None:
    """Declares the arguments of the verb."""
    parser.add_argument("log", nargs="?", metavar="LOG|DIR", help="ring file or folder (default: the newest of the usual places)")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="one JSON object a line on standard output")
    form.add_argument("--web", action="store_true", help="serve a page with a 3-D view, plots and, for a dry run, a remote")
    parser.add_argument("--rate", metavar="HZ", type=float, help="times a second that the view is renewed (default: 10; page: 30)")
    parser.add_argument("--port", metavar="N", type=int, default=8200, help="of the page; 0 takes a free one (default: 8200)")
    parser.add_argument("--host", metavar="ADDRESS", default="127.0.0.1", help="of the page (default: this machine only, 127.0.0.1)")


def run(arguments) -> int:
    """Exit code 0 after q, Ctrl-C or the end of the reader.

    Raises:
        MipRtError: what was named is no ring, or the port is taken.
    """
    rate_hz = arguments.rate if arguments.rate is not None else 30.0 if arguments.web else 10.0
    if not 0.1 <= rate_hz <= 200.0:
        raise ConfigError(f"--rate {rate_hz:g} is not a useful rate.", "Give 0.1 to 200.", "arguments")
    os.nice(NICENESS)
    try:
        if arguments.web:
            from mip_rt.monitor import web

            web.serve(arguments.log, arguments.host, arguments.port, rate_hz)
        else:
            from mip_rt.monitor.source import Source

            source = Source(arguments.log)
            if arguments.json:
                _json_lines(source, rate_hz)
            elif sys.stdout.isatty() and sys.stdin.isatty() and os.environ.get("TERM", "dumb") != "dumb":
                from mip_rt.monitor import terminal

                terminal.run(source, rate_hz)
            else:
                _text_lines(source)
    except KeyboardInterrupt:
        pass
    except BrokenPipeError:  # the reader of our lines has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _every(period_s: float):
    """Yields on an absolute grid."""
    due = time.monotonic()
    while True:
        yield
        due = max(due + period_s, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))


def _json_lines(source, rate_hz: float) -> None:
    for _ in _every(1.0 / rate_hz):
        source.poll()
        if source.view is not None and source.view.row is not None:
            about = {"run": source.runs, "log": str(source.path), "silence": source.silence}
            print(json.dumps({**about, **source.view.show(), "latency_us": source.view.latency_us()}), flush=True)


def _text_lines(source) -> None:
    """One line a second, for a pipe or a plain terminal."""
    from mip_rt.monitor.terminal import one_line

    for _ in _every(1.0):
        source.poll()
        print(one_line(source), flush=True)
