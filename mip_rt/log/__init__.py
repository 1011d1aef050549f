"""Logs: the ring that the loop writes, the recorder that brings it to disk, and the reader of both."""


def open(path, check: bool = True):  # noqa: A001
    """See `reader.open_log`; imported here, because the recorder shall start without numpy."""
    from mip_rt.log.reader import open_log

    return open_log(path, check)
