"""The configuration that a log carries: read from its YAML text, compared with another."""

import yaml

LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast where PyYAML was built with it


def as_dict(text: str) -> dict:
    """The configuration as plain dictionaries; empty where the text cannot be read."""
    try:
        found = yaml.load(text, LOADER)
    except yaml.YAMLError:
        return {}
    return found if isinstance(found, dict) else {}


def value(text: str, key: str, otherwise):
    """One value by its dotted key; `otherwise` where the log has none."""
    return flatten(as_dict(text)).get(key, otherwise)


def flatten(mapping: dict, prefix: str = "") -> dict:
    """Nested dictionaries as one, with dotted keys; lists are values."""
    found = {}
    for key, entry in mapping.items():
        name = f"{prefix}{key}"
        found |= flatten(entry, f"{name}.") if isinstance(entry, dict) else {name: entry}
    return found


def differences(a: dict, b: dict) -> list[dict]:
    """Keys whose values differ, with both; None stands for a key that is missing."""
    a, b = flatten(a), flatten(b)
    return [{"key": key, "a": a.get(key), "b": b.get(key)} for key in [*a, *(key for key in b if key not in a)] if a.get(key) != b.get(key)]


def shown(entry) -> str:
    """A value of a difference, for people."""
    return "(absent)" if entry is None else str(entry)
