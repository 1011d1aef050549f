"""Which log, and which part of it: the arguments that the actions of `mip-rt log` share. Nothing heavy is imported before it is needed."""

from pathlib import Path

from mip_rt.errors import ConfigError, LogError


def add_log(parser) -> None:
    """Declares the log's argument."""
    parser.add_argument("path", nargs="?", metavar="LOG", help="ring, recorder file or folder (default: the newest log of this machine)")


def add_window(parser) -> None:
    """Declares which part of the log."""
    parser.add_argument("--from", dest="begin_s", metavar="S", type=float, help="begin: seconds since the loop's first tick")
    parser.add_argument("--to", dest="end_s", metavar="S", type=float, help="end, likewise")
    parser.add_argument("--last", dest="last_s", metavar="S", type=float, help="the last S seconds of the log")


def usual_folders() -> list[Path]:
    """Where rings are: the configuration's folder, and that of dry runs."""
    from mip_rt import config as configuration
    from mip_rt.log.folders import temporary_log_folder

    folders = [temporary_log_folder()]
    try:
        folders.insert(0, Path(configuration.load(configuration.default_path("mbbr")).log.folder))
    except ConfigError:
        pass  # a broken configuration must not keep anyone from a log
    return folders


def find(path) -> Path:
    """The log that was named, or the newest of the usual places.

    Raises:
        LogError: none was named and there is none.
    """
    if path is not None:
        return Path(path)
    from mip_rt.log.live import newest_ring

    found = newest_ring(usual_folders())
    if found is None:
        places = " or ".join(map(str, usual_folders()))
        raise LogError(f"there is no log in {places}.", "Name a log, or run mip-rt --dry-run first.", "log_absent")
    return found


def open_named(arguments):
    """The log of the arguments, opened, with at least one row.

    Raises:
        LogError: it cannot be read, or holds no row.
    """
    from mip_rt import log

    opened = log.open(find(arguments.path))
    if not len(opened.frames):
        damage = "".join(f" {sentence}." for sentence in opened.damage)
        raise LogError(f"{opened.path} holds no complete row.{damage}", "Name another log.", "log_empty")
    return opened


def rate_hz(log) -> float:
    """Nominal rate of the loop, from the configuration in the log; 200 where it has none."""
    from mip_rt.log.configuration import value

    return float(value(log.config, "realtime.rate_hz", 200.0))


def seconds(log):
    """(n,) seconds since the loop's first tick, by the IMU's edges. Where the log begins later, the first row's tick tells how much."""
    edges = log.frames["edge_ns"]
    return (edges - edges[0]) * 1e-9 + int(log.frames["tick"][0]) / rate_hz(log)


def window(arguments, times_s):
    """(n,) mask of the rows within --from, --to, --last; all rows where none is given.

    Raises:
        LogError: no row lies within.
    """
    import numpy as np

    mask = np.ones(len(times_s), bool)
    if arguments.last_s is not None:
        mask &= times_s > times_s[-1] - arguments.last_s
    if arguments.begin_s is not None:
        mask &= times_s >= arguments.begin_s
    if arguments.end_s is not None:
        mask &= times_s <= arguments.end_s
    if not mask.any():
        raise LogError(
            f"no row lies in that window: the log covers {times_s[0]:.3f} to {times_s[-1]:.3f} s.", "Widen --from, --to or --last.", "log_window"
        )
    return mask


def is_window_given(arguments) -> bool:
    """Whether any of --from, --to, --last was given."""
    return any(value is not None for value in (arguments.begin_s, arguments.end_s, arguments.last_s))
