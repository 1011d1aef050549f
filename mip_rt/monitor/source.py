"""Where a monitor's rows come from: the newest ring of the usual places, or of the one that was named, over restarts of the loop."""

import math
from pathlib import Path

from mip_rt.errors import LogError
from mip_rt.log.folders import usual_folders
from mip_rt.log.live import LiveRing, newest_ring
from mip_rt.monitor.view import View


class Source:
    """Follows a loop.

    Args:
        where: a ring file; a folder, in which a ring may appear later; or None for the usual places. A file that is its folder's newest
            ring stands for the folder: after a restart the loop writes another.

    Attributes:
        view: view.View of the present run; None before there is one.
        path: its ring.
        runs: how many runs were seen.
        trouble: why there is nothing to show, "" where there is.

    Raises:
        LogError: a file was named that is no ring.
    """

    def __init__(self, where=None):
        if where is None:
            where = usual_folders()
        elif not Path(where).is_dir():
            where = Path(where)
            LiveRing(where).close()  # whoever names a ring wants to hear at once that it is none
            if newest_ring(where.parent) == where:
                where = where.parent
        self._where = where
        self._live = None
        self._next = 0
        self.view = self.path = None
        self.runs = 0
        self.trouble = ""

    def poll(self):
        """Reads what is new: the rows, possibly none. At the start of a run (`runs` has grown) these are its last ten seconds."""
        if self._live is None:
            try:
                self._live = LiveRing(self._where)
            except LogError as error:
                self.trouble = f"{error.sentence} {error.cure}"
                return ()
            self.trouble = ""
        live = self._live
        live.refresh()
        while True:
            if live.runs != self.runs:
                self.runs, self.path = live.runs, live.path
                self.view = View(live.header, live.dtype)
                self._next = 0
            self._next = max(self._next, live.counter - self.view.kept)  # whoever was away gets a gap, not a backlog
            rows = live.since(self._next)
            if live.runs == self.runs:
                break
        if len(rows):
            self._next = int(rows["tick"][-1]) + 1
            self.view.take(rows)
        return rows

    @property
    def silence(self) -> str:
        """What to say of a loop from which no rows come any more; "" while it runs."""
        live = self._live
        if live is None or not live.silent:
            return ""
        since = f"{live.quiet_s:.0f} s" if math.isfinite(live.quiet_s) else "a long time"
        return f"the loop ended {since} ago" if live.finished else f"no rows for {since}: the loop hangs or was killed"

    def close(self) -> None:
        """Lets go of the ring."""
        if self._live is not None:
            self._live.close()
