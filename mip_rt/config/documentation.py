"""The schema as a commented YAML template and as a Markdown reference."""

import json

from mip_rt.config.fields import Named, Rows
from mip_rt.config.robots import ROBOTS


def _number(value: float) -> str:
    text = repr(float(f"{value:.9g}"))
    if "e" in text and "." not in text.split("e")[0]:
        text = text.replace("e", ".0e")  # YAML 1.1 takes 1e-05 for text
    return text


def _inline(value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(_inline(entry) for entry in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_inline(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, str):
        return value if value.replace("_", "").replace("-", "").isalnum() and not value[0].isdigit() else json.dumps(value)
    return str(value)


def _comment(field) -> str:
    unit = getattr(field, "unit", "") or getattr(getattr(field, "item", None), "unit", "")
    return field.doc + (f" [{unit}]" if unit else "")


def _lines(schema: dict, depth: int):
    indent = "  " * depth
    for name, field in schema.items():
        if isinstance(field, dict):
            if depth == 0:
                yield ""
            yield f"{indent}{name}:"
            yield from _lines(field, depth + 1)
        elif isinstance(field, Named):
            yield f"{indent}# {field.doc}"
            yield f"{indent}{name}:"
            for entry, values in field.default.items():
                yield f"{indent}  {_inline(entry)}: {_inline(values)}"
        elif isinstance(field, Rows):
            yield f"{indent}# {field.doc}"
            yield f"{indent}{name}:"
            for values in field.default:
                yield f"{indent}  - {_inline(values)}"
        else:
            choices = getattr(field, "choices", ())
            if choices:
                yield f"{indent}# {_comment(field)} One of: {', '.join(choices)}."
            else:
                yield f"{indent}# {_comment(field)}"
            yield f"{indent}{name}: {_inline(field.default)}"


def template(robot: str = "mbbr") -> str:
    """A commented YAML file with every key at its shipped value; it loads as it is."""
    head = [
        f"# Configuration of mip-rt for the robot {robot!r}. Every key may be left out; what stands here are the shipped values.",
        '# Numbers are SI; a value may also carry a unit: "50 deg", "20 kHz", "3.2 cm".',
        "# T: Sihite's dissertation (2019); A: the robot author's own program. Check a change with: mip-rt config check",
    ]
    return "\n".join([*head, *_lines(ROBOTS[robot], 0)]) + "\n"


def _rows(schema: dict, prefix: str):
    for name, field in schema.items():
        key = f"{prefix}{name}"
        if isinstance(field, dict):
            yield from _rows(field, f"{key}.")
        elif isinstance(field, (Named, Rows)):
            listed = _inline(list(field.default)) if isinstance(field, Named) else f"{len(field.default)} rows"
            yield key, field.describe(), listed, field.doc
            yield from _rows(field.entry, f"{key}.<name>." if isinstance(field, Named) else f"{key}[].")
        else:
            yield key, field.describe(), _inline(field.default), field.doc


def documentation(robot: str = "mbbr") -> str:
    """Markdown table of every key: kind and range, shipped value, meaning."""
    lines = [f"# Configuration of {robot}", "", "| key | kind | shipped value | meaning |", "|---|---|---|---|"]
    for key, kind, value, doc in _rows(ROBOTS[robot], ""):
        escaped = [part.replace("|", "\\|") for part in (kind, value, doc)]
        lines.append(f"| `{key}` | {escaped[0]} | {escaped[1]} | {escaped[2]} |")
    return "\n".join(lines) + "\n"


def keys(robot: str = "mbbr") -> list[tuple[str, str]]:
    """(dotted key, documentation) of every key."""
    return [(key, doc) for key, _, _, doc in _rows(ROBOTS[robot], "")]
