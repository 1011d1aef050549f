"""Which log, and which part of it: the arguments that the actions of `mip-rt log` share. Nothing heavy is imported before it is needed."""

from pathlib import Path

from mip_rt.errors import LogError


def add_log(parser) -> None:
    """Declares the log's argument."""
    parser.add_argument("path", nargs="?", metavar="LOG",
                        help="ring, recorded file, or folder of a run or of runs (default: the newest log of this machine)")  # fmt: skip


def add_window(parser) -> None:
    """Declares which part of the log."""
    parser.add_argument("--from", dest="begin_s", metavar="S", type=float, help="begin: seconds since the loop's first tick")
    parser.add_argument("--to", dest="end_s", metavar="S", type=float, help="end, likewise")
    parser.add_argument("--last", dest="last_s", metavar="S", type=float, help="the last S seconds of the log")


def find(path) -> Path:
    """The log that was named, or the newest of the usual places: what its recorder wrote where there is that, else the ring.

    Raises:
        LogError: none was named and there is none.
    """
    if path is not None:
        return Path(path)
    from mip_rt.log import folders
    from mip_rt.log.live import LiveRing, newest_ring
    from mip_rt.log.recording_files import recorded_files

    ring = newest_ring(folders.usual_folders())
    if ring is not None:
        with LiveRing(ring) as live:
            recording = live.header.get("recording") or {}
        run = Path(recording.get("folder", ""), recording.get("run_folder", ""))
        return run if recording and any(run.glob("*")) else ring
    kept = folders.usual_record_folder()
    recorded = recorded_files(kept) if kept is not None and kept.is_dir() else []
    if not recorded:
        places = " or ".join(str(p) for p in [*folders.usual_folders(), kept] if p is not None)
        raise LogError(f"there is no log in {places}.", "Name a log, or run mip-rt --dry-run first.", "log_absent")
    return recorded[-1].parent


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
