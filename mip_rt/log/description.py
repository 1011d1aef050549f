"""What a log says of itself: fields with units, configuration, code, machine, clocks. Written once, at the start of a run."""

import platform
import time

import numpy as np

import mip_rt
from mip_rt import frame


def header(layout: frame.Layout, config_text: str, extra: dict | None = None) -> dict:
    """What a log says of itself."""
    import llvmlite

    from mip_rt import compiled

    return {
        "mip_rt": mip_rt.__version__,
        "source_hash": compiled.source_hash(),
        "fields": [f._asdict() for f in layout.fields],
        "estimate_names": layout.estimate_names,
        "row_bytes": layout.dtype.itemsize,
        "config": config_text,
        "versions": {"numba": compiled.numba.__version__, "numpy": np.__version__, "llvmlite": llvmlite.__version__},
        "host": {"machine": platform.machine(), "system": platform.platform(), "cpu": compiled.cpu_name()},
        "clock": {"monotonic_ns": time.monotonic_ns(), "realtime_ns": time.time_ns()},
        **(extra or {}),
    }
