"""The promise of the guard on a whole dry run in real time, as `mip-rt bench guard` measures it with many more runs."""

import pytest

from mip_rt import realtime
from mip_rt.lab import guard_drop


@pytest.mark.parametrize("kind", ["kill", "stop", "hang", "guard"])
def test_enable_line_falls_within_100_ms(kind):
    """Prevents motors that run on after the control process was killed, stopped or hangs, or after its guard was killed."""
    realtime.enter("fifo", guard_drop.OBSERVER_PRIORITY, False)
    observed = guard_drop.Observed(kind)
    try:
        found = guard_drop.fall(observed, kind, 0.01)
    finally:
        observed.end()
        realtime.leave()
    assert found and max(found.values()) <= guard_drop.BOUND_S
