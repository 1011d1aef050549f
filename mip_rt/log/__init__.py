"""Logs: the ring that the loop writes, and its reader."""

from mip_rt.log.ring import Log, Ring, open_log as open  # noqa: A004, F401
