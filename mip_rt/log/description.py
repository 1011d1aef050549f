"""What a log says of itself: fields with units, configuration, code, machine, clocks. Written once, at the start of a run."""

import os
import platform
import subprocess
import time
from pathlib import Path

import mip_rt
from mip_rt import frame


def commit() -> dict:
    """Commit and whether tracked files differ from it, when the program runs from a checkout; {} otherwise."""
    root = Path(mip_rt.__file__).parents[1]
    if not (root / ".git").exists():
        return {}
    try:
        answer = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"], cwd=root, capture_output=True, text=True,
            timeout=2.0, check=True, env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
        ).stdout.strip()  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return {}
    return {"hash": answer.removesuffix("-dirty"), "dirty": answer.endswith("-dirty")}


def header(layout: frame.Layout, config_text: str, extra: dict | None = None, monotonic_ns: int | None = None) -> dict:
    """The description of a log.

    Args:
        layout: of the rows.
        config_text: the full configuration, YAML.
        extra: what the run adds: seed, scenario, estimators, calibration, names of codes, settings of the recorder.
        monotonic_ns: the clock of the frame's times at this moment, where that is not the machine's (virtual time).
    """
    from mip_rt import compiled

    return {
        "mip_rt": mip_rt.__version__,
        "commit": commit(),
        "run": os.urandom(8).hex(),
        "source_hash": compiled.source_hash(),
        "fields": [{**f._asdict(), "offset": layout.offset[f.name]} for f in layout.fields],
        "estimate_names": layout.estimate_names,
        "row_bytes": layout.dtype.itemsize,
        "config": config_text,
        "versions": {"python": platform.python_version(), **compiled.versions()},
        "machine_type": compiled.machine_type(),
        "host": {
            "name": platform.node(),
            "machine": platform.machine(),
            "system": platform.platform(),
            "kernel": f"{platform.release()} {platform.version()}",
            "cpu": compiled.cpu_name(),
        },
        "clock": {
            "monotonic_ns": time.monotonic_ns() if monotonic_ns is None else monotonic_ns,
            "realtime_ns": time.time_ns(),
        },
        **(extra or {}),
    }
