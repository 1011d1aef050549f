"""A progress bar for commands that take their time."""

import sys


def progress(done: int, total: int, what: str) -> None:
    """Draws the bar on standard error, where that is a terminal; `done` = `total` ends its line."""
    if sys.stderr.isatty():
        filled = round(30 * done / max(total, 1))
        end = "\n" if done == total else "\r"
        sys.stderr.write(f"[{'#' * filled}{'.' * (30 - filled)}] {done}/{total} {what}\x1b[K{end}")
        sys.stderr.flush()
