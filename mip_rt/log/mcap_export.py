"""A log as MCAP, which Foxglove and PlotJuggler open: JSON messages with schemas, one topic a group of fields, one message a tick.

Times are those of the IMU's edge, carried to the clock of the day by the offsets in the log's header. Units and meanings are the
descriptions in the schemas. The configuration and the header are attached as files, the short entries of the header as metadata.
JSON has no word for NaN and infinity: such a number is null. Foxglove's reader of schemas knows neither alternatives of types nor arrays
of arrays, and bytes as base64 only.
"""

import base64
import json
from pathlib import Path

import numpy as np

from mip_rt import optional
from mip_rt.log.codes import Codes
from mip_rt.log.columns import estimators, unit_of

# Topic by the beginning of a field's name; the first that fits. Estimates have a topic each.
TOPICS = (
    ("/mip/timing", ("sequence", "tick", "edge_ns", "wake_ns", "read_ns", "step_ns", "write_ns", "missed")),
    ("/mip/supervisor", ("state", "request", "refusals", "limits", "alarms", "fault", "drive_scale", "drive_allowed")),
    ("/mip/remote", ("remote_",)),
    ("/mip/reference", ("reference_", "error")),
    ("/mip/estimator", ("state_estimate", "state_variance", "innovation", "estimator_")),
    ("/mip/command", ("command_", "gains", "duty", "applied_ns")),
    ("/mip/sensors", ("",)),
)
EXACT = ("state", "error", "sequence", "tick", "request", "limits", "fault")  # names that are also beginnings of others
TYPES = {"i": "integer", "u": "integer", "f": "number"}


def topic_of(name: str) -> str:
    """Topic of a field."""
    for topic, beginnings in TOPICS:
        if any(name == b if b in EXACT else name.startswith(b) for b in beginnings):
            return topic
    raise AssertionError("the last row of TOPICS fits every name")


def write_mcap(header: dict, frames, output: Path) -> None:
    """Writes the file.

    Raises:
        PackageMissing: there is no mcap.
        OSError: the file cannot be written.
    """
    Writer = optional.load("mcap.writer", "view", "MCAP").Writer  # noqa: N806
    times_ns = realtime_ns(header, frames)
    with output.open("wb") as file:
        writer = Writer(file)
        writer.start("", f"mip-rt {header.get('mip_rt', '')}")
        short = {key: _text(value) for key, value in header.items() if key not in ("fields", "config")}
        writer.add_metadata("mip-rt", short)
        at_ns = times_ns[0] if len(times_ns) else 0
        writer.add_attachment(at_ns, at_ns, "config.yaml", "application/yaml", header.get("config", "").encode())
        writer.add_attachment(at_ns, at_ns, "header.json", "application/json", json.dumps(header).encode())
        topics = [_Topic(writer, topic, names, header, frames) for topic, names in _groups(header).items()]
        topics += [_Estimate(writer, slot, name, header, frames) for slot, name in enumerate(estimators(header))]
        for row, time_ns in enumerate(times_ns):
            for topic in topics:
                topic.add(row, time_ns)
        writer.finish()


def realtime_ns(header: dict, frames) -> list[int]:
    """Unix time of each row's edge; CLOCK_MONOTONIC where the header tells no offset."""
    clock = header.get("clock", {})
    offset = clock.get("realtime_ns", 0) - clock.get("monotonic_ns", 0) if "realtime_ns" in clock else 0
    return (frames["edge_ns"] + offset).tolist()


def _groups(header: dict) -> dict[str, list[str]]:
    groups = {}
    for entry in header["fields"]:
        if entry["name"] != "estimates" or not estimators(header):
            groups.setdefault(topic_of(entry["name"]), []).append(entry["name"])
    return groups


def _text(value) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _plain(values) -> list:
    """Numbers for JSON, a list a row; None for NaN and infinity."""
    if values.dtype.kind != "f" or np.isfinite(values).all():
        return values.tolist()
    replaced = values.astype(object)
    replaced[~np.isfinite(values)] = None
    return replaced.tolist()


class _Topic:
    """One topic: registered with its schema, messages made row by row from columns that were converted at once."""

    def __init__(self, writer, topic: str, names: list[str], header: dict, frames):
        table = {entry["name"]: entry for entry in header["fields"]}
        properties, self.columns = {}, {}
        for name in names:
            entry, values = table[name], frames[name]
            words = f"{entry['meaning']} [{entry['unit']}]"
            if entry["dtype"].endswith("u1"):
                properties[name] = {"type": "string", "contentEncoding": "base64", "description": words}
                self.columns[name] = [base64.b64encode(row.tobytes()).decode() for row in values]
                continue
            kind = {"type": TYPES[np.dtype(entry["dtype"]).kind]}
            properties[name] = {**({"type": "array", "items": kind} if entry["shape"] else kind), "description": words}
            self.columns[name] = _plain(values.reshape(len(values), -1) if entry["shape"] else values)
        if "state" in self.columns:
            self._add_words(properties, frames, Codes(header))
        self._register(writer, topic, properties)

    def _add_words(self, properties: dict, frames, codes: Codes) -> None:
        """States, faults and limits in words, beside their numbers."""
        words = {
            "state_name": ("supervisor state", [codes.state(n) for n in frames["state"].tolist()]),
            "fault_code": ("code of the fault", [codes.fault(n) for n in frames["fault"].tolist()]),
        }
        for field, name, meaning in (("limits", "limit_names", "what was limited"), ("alarms", "alarm_names", "what the detectors have found")):
            if field in self.columns:
                known = codes.bits_in(field, frames[field]).items()
                words[name] = (meaning, [" ".join(n for n, bit in known if word & bit) for word in self.columns[field]])
        for name, (meaning, column) in words.items():
            properties[name] = {"type": "string", "description": meaning}
            self.columns[name] = column

    def _register(self, writer, topic: str, properties: dict) -> None:
        schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": topic, "type": "object", "properties": properties}
        number = writer.register_schema("mip_rt" + topic.replace("/mip", "").replace("/", "."), "jsonschema", json.dumps(schema).encode())
        self.channel = writer.register_channel(topic, "json", number)
        self.writer = writer

    def add(self, row: int, time_ns: int) -> None:
        """Writes one message."""
        data = json.dumps({name: column[row] for name, column in self.columns.items()}, separators=(",", ":")).encode()
        self.writer.add_message(self.channel, time_ns, data, time_ns, row)


class _Estimate(_Topic):
    """One estimator's numbers by name."""

    def __init__(self, writer, slot: int, name: str, header: dict, frames):
        properties, self.columns = {}, {}
        (unit,) = (entry["unit"] for entry in header["fields"] if entry["name"] == "estimates")
        control = "in control" if slot == 0 else "in shadow"
        for i, element in enumerate(header["estimate_names"]):
            properties[element] = {"type": "number", "description": f"estimator {name}, {control} [{unit_of(element, unit)}]"}
            self.columns[element] = _plain(frames["estimates"][:, slot, i])
        self._register(writer, f"/mip/estimate/{name}", properties)
