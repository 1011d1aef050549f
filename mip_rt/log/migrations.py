"""Descriptions of older logs, brought to the present version step by step. A change of the log's meaning adds one step here and a sample to the tests."""

from mip_rt.errors import LogError
from mip_rt.log.log_data import record_type
from mip_rt.log.ring_format import VERSION


def _from_1(description: dict) -> dict:
    """Version 2 added kept states, names of codes, field offsets and the calibration in use."""
    offsets = record_type(description).fields
    fields = [{**field, "offset": offsets[field["name"]][1]} for field in description["fields"]]
    return {"state_bytes": 0, "codes": {}, "calibration": {}, **description, "fields": fields}


MIGRATIONS = {1: _from_1}


def migrate(description: dict, path) -> dict:
    """The description as this version would have written it; `log_version` keeps the version that wrote it.

    Raises:
        LogError: a later version wrote it.
        ValueError, KeyError, TypeError: it is none.
    """
    version = description.get("log_version", 1)
    if version > VERSION:
        sentence = f"{path} is of log version {version}, this program reads up to {VERSION}."
        raise LogError(sentence, "Use a newer mip-rt.", "log_version")
    for older in range(version, VERSION):
        description = MIGRATIONS[older](description)
    return {**description, "log_version": version}
