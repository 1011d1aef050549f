"""Scenario files: what the scripted operator does, and what happens to the world, by time.

    description: spin at 1 Hz
    duration_s: 30
    events:
      - {at_s: 2.0, press: arm}
      - {at_s: 5.0, yaw_rate_hz: 1.0}
      - {at_s: 8.0, speed_m_s: [0.2, 0.0]}
      - {at_s: 9.0, set: {battery_v: 6.6}}
      - {at_s: 12.0, fault: i2c_nack, probability: 0.3, for_s: 0.5}

Faults and their parameters: `mip-rt soak --list`. A press of "recover" is that of an operator who finds the motors off.
"""

from pathlib import Path

import yaml

from mip_rt.config.fields import Choice, Number, Refusal, Text, numbers
from mip_rt.config.loading import _Checker, _compose, folders, read_text
from mip_rt.config.suggestion import nearest
from mip_rt.errors import ConfigError

PRESSES = ("arm", "disarm", "heading_reset", "recover")
TOP = {
    "description": Text("", "One line.", wanted="text"),
    "duration_s": Number(60.0, "Length when --duration is not given.", unit="s", low=0.1, high=1e6),
}
EVENT = {
    "at_s": Number(0.0, "Time since the start of the loop.", unit="s", low=0, high=1e6),
    "yaw_rate_hz": Number(None, "Spin: one of the remote's levels.", unit="Hz", low=-5, high=5),
    "speed_m_s": numbers(None, "Drive forward and to the left.", 2, "m/s", -5, 5),
    "press": Choice(None, "A button.", choices=PRESSES),
}


class Event:
    """One moment of a scenario; what is not mentioned is None. `parameters` are those of the fault that were given."""

    def __init__(self, at_s, yaw_rate_hz=None, speed_m_s=None, press=None, set=None, fault=None, parameters=None):  # noqa: A002
        self.at_s, self.yaw_rate_hz, self.speed_m_s, self.press, self.set = at_s, yaw_rate_hz, speed_m_s, press, set
        self.fault, self.parameters = fault, parameters or {}

    def as_dict(self) -> dict:
        """The event as the file would say it."""
        given = {"at_s": self.at_s, "yaw_rate_hz": self.yaw_rate_hz, "press": self.press, "set": self.set, "fault": self.fault}
        if self.speed_m_s is not None:
            given["speed_m_s"] = list(self.speed_m_s)
        return {key: value for key, value in given.items() if value is not None} | self.parameters


class Scenario:
    """A named list of events with a default duration."""

    def __init__(self, name, description, duration_s, events):
        self.name, self.description, self.duration_s, self.events = name, description, duration_s, events

    def to_yaml(self) -> str:
        """A file that loads to the same scenario."""
        head = yaml.safe_dump({"description": self.description, "duration_s": self.duration_s}, sort_keys=False)
        lines = [yaml.safe_dump(event.as_dict(), sort_keys=False, default_flow_style=True, width=10**6) for event in self.events]
        return head + ("events:\n" + "".join(f"  - {line}" for line in lines) if lines else "events: []\n")


def shipped() -> dict[str, Path]:
    """Scenarios by name, from the configuration folders."""
    found = {}
    for folder in reversed(folders()):
        for file in sorted((folder / "scenarios").glob("*.yaml")):
            found[file.stem] = file
    return found


def loads(text: str, name: str = "<text>") -> Scenario:
    """A scenario from YAML text; ConfigError with every error."""
    checker = _Checker(name)
    root = _compose(text, checker)
    entries = root.value if root is not None and isinstance(root.value, dict) else {}
    if not entries and not checker.errors:
        checker.refuse(1, "", "expected description, duration_s and events")
    top = {}
    for key, field in TOP.items():
        top[key] = checker.value(field, entries.get(key), key)
    for key, node in entries.items():
        if key not in TOP and key != "events":
            checker.refuse(node.line, key, f"no such key{nearest(key, [*TOP, 'events'])}")
    listed = entries["events"].value if "events" in entries else []
    if not isinstance(listed, list):
        checker.refuse(entries["events"].line, "events", "expected a list of events")
        listed = []
    events = [event for i, node in enumerate(listed) if (event := _event(checker, node, f"events[{i}]")) is not None]
    if checker.errors:
        problems = "\n".join(f"  {error}" for error in checker.errors[:50])
        raise ConfigError(f"{len(checker.errors)} errors in the scenario:\n{problems}", "Correct them.", "scenario_invalid")
    return Scenario(Path(name).stem, top["description"], top["duration_s"], events)


def _event(checker, node, path):
    if not isinstance(node.value, dict):
        checker.refuse(node.line, path, f"expected keys ({', '.join(EVENT)}, set), found {node.plain()!r}")
        return None
    values, others = {}, {}
    for key, child in node.value.items():
        if key == "set":
            values[key] = _world_changes(checker, child, f"{path}.set")
        elif key in EVENT:
            try:
                values[key] = EVENT[key].convert(child.plain())
            except Refusal as refusal:
                checker.refuse(child.line, f"{path}.{key}", str(refusal))
        else:
            others[key] = child
    values |= _fault(checker, others, path)
    if "at_s" not in node.value:
        checker.refuse(node.line, path, "at_s is missing")
        return None
    values.setdefault("at_s", 0.0)
    return Event(**values)


def _fault(checker, nodes, path) -> dict:
    """`fault` and `parameters` of an event from those keys that are no event's own; other keys are refused."""
    if "fault" not in nodes:
        for key, child in nodes.items():
            checker.refuse(child.line, f"{path}.{key}", f"no such key{nearest(key, [*EVENT, 'set', 'fault'])}")
        return {}
    from mip_rt.fake.faults import FAULTS

    child = nodes.pop("fault")
    name = child.plain()
    if not isinstance(name, str) or name not in FAULTS:
        checker.refuse(child.line, f"{path}.fault", f"there is no fault {name!r}{nearest(name, FAULTS)}")
        return {}
    known, parameters = FAULTS[name].parameters, {}
    for key, child in nodes.items():
        if key not in known:
            checker.refuse(child.line, f"{path}.{key}", f"the fault {name!r} has no such parameter{nearest(key, known)}")
            continue
        try:
            parameters[key] = known[key].convert(child.plain())
        except Refusal as refusal:
            checker.refuse(child.line, f"{path}.{key}", str(refusal))
    return {"fault": name, "parameters": parameters}


def _world_changes(checker, node, path):
    """World parameters to change: those keys of the dry_run section that are single numbers."""
    from mip_rt.config.schema import DRY_RUN

    changes = {}
    known = {key: field for key, field in DRY_RUN.items() if isinstance(field, Number) and key not in ("friction",)}
    if not isinstance(node.value, dict):
        checker.refuse(node.line, path, "expected key: value")
        return changes
    for key, child in node.value.items():
        if key not in known:
            checker.refuse(child.line, f"{path}.{key}", f"no such world parameter{nearest(key, known)}")
            continue
        try:
            changes[key] = known[key].convert(child.plain())
        except Refusal as refusal:
            checker.refuse(child.line, f"{path}.{key}", str(refusal))
    return changes


def load(name_or_path: str) -> Scenario:
    """A shipped scenario by name, or a file."""
    known = shipped()
    if name_or_path in known:
        return loads(read_text(known[name_or_path]), str(known[name_or_path]))
    if not Path(name_or_path).exists():
        raise ConfigError(
            f"there is no scenario {name_or_path!r}{nearest(name_or_path, known)}.",
            f"Shipped are {', '.join(sorted(known))}; or name a file.",
            "scenario_missing",
        )
    return loads(read_text(name_or_path), str(name_or_path))
