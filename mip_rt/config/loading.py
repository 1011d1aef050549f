"""From a YAML file to a checked configuration; every error with file, line, key, what was expected, and the nearest right key."""

import os
import sys
from pathlib import Path

import yaml

from mip_rt.config.fields import Named, Refusal, Rows
from mip_rt.config.robots import ROBOTS
from mip_rt.config.rules import broken_rules
from mip_rt.config.suggestion import nearest
from mip_rt.errors import ConfigError

LARGEST_FILE = 1 << 20
OVERRIDDEN = -1  # "line" of a value that came with --set


class Section:
    """Read-only attribute access to a part of the configuration; entries are values, tuples and further sections."""

    def __init__(self, entries: dict):
        self.__dict__.update(entries)

    def __setattr__(self, name, value):
        raise AttributeError("a configuration does not change once it is loaded")

    def as_dict(self) -> dict:
        """Plain dictionaries, lists and values."""
        return {key: _plain(value) for key, value in self.__dict__.items()}


class Config(Section):
    """A whole configuration."""

    def to_yaml(self) -> str:
        """The effective configuration as YAML, SI values; loads to the same configuration."""
        return yaml.safe_dump(self.as_dict(), sort_keys=False, allow_unicode=True, default_flow_style=None, width=110)


def _plain(value):
    if isinstance(value, Section):
        return value.as_dict()
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return value


class _Node:
    """A YAML value with its line: `value` is a dict of (line, _Node), a list of _Node, or a scalar."""

    def __init__(self, value, line):
        self.value, self.line = value, line

    def plain(self):
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.plain() for node in self.value]
        return self.value


class _Checker:
    """Collects all errors of one file."""

    def __init__(self, source: str):
        self.source, self.errors, self.lines = source, [], {}
        self._constructor = yaml.constructor.SafeConstructor()

    def refuse(self, line, key, message) -> None:
        place = {0: self.source, OVERRIDDEN: "--set"}.get(line, f"{self.source}:{line}")
        self.errors.append(f"{place}: {key}: {message}" if key else f"{place}: {message}")

    def node(self, yaml_node, key="", depth=0):
        """A _Node tree from PyYAML's nodes; duplicate keys and exotic values are refused."""
        line = yaml_node.start_mark.line + 1
        if depth > 12:
            self.refuse(line, key, "nested too deeply")
            return _Node(None, line)
        if isinstance(yaml_node, yaml.MappingNode):
            entries = {}
            for key_node, value_node in yaml_node.value:
                name = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
                path = f"{key}.{name}" if key else str(name)
                if name is None:
                    self.refuse(key_node.start_mark.line + 1, key, "a key must be a word")
                elif name in entries:
                    self.refuse(key_node.start_mark.line + 1, path, f"stands here a second time (first on line {entries[name].line})")
                else:
                    entries[name] = self.node(value_node, path, depth + 1)
                    entries[name].line = key_node.start_mark.line + 1
            return _Node(entries, line)
        if isinstance(yaml_node, yaml.SequenceNode):
            return _Node([self.node(item, f"{key}[{i}]", depth + 1) for i, item in enumerate(yaml_node.value)], line)
        try:
            return _Node(self._constructor.construct_object(yaml_node), line)
        except (yaml.YAMLError, ValueError, OverflowError):
            self.refuse(line, key, f"cannot read {yaml_node.value!r}")
            return _Node(None, line)

    def section(self, schema: dict, node: _Node | None, key="") -> Section:
        """Checks a mapping against a schema; missing keys take the shipped values."""
        given = node.value if node is not None else {}
        if node is not None and not isinstance(given, dict):
            self.refuse(node.line, key, f"expected keys ({', '.join(list(schema)[:4])}, ...), found {node.plain()!r}")
            given = {}
        for name, child in given.items():
            if name not in schema:
                path = f"{key}.{name}" if key else name
                self.refuse(child.line, path, f"no such key{nearest(name, schema)}")
        values = {}
        for name, field in schema.items():
            path = f"{key}.{name}" if key else name
            child = given.get(name)
            if child is not None:
                self.lines[path] = child.line
            values[name] = self.section(field, child, path) if isinstance(field, dict) else self.value(field, child, path)
        return Config(values) if not key else Section(values)

    def value(self, field, node: _Node | None, key):
        if isinstance(field, Named):
            table = {name: self.section(field.entry, _as_node(entry), f"{key}.{name}") for name, entry in field.default.items()}
            if node is not None:
                if not isinstance(node.value, dict):
                    self.refuse(node.line, key, f"expected a {field.describe()}, found {node.plain()!r}")
                else:
                    for name, child in node.value.items():
                        table[name] = self.section(field.entry, child, f"{key}.{name}")
            return Section(table)
        if isinstance(field, Rows):
            if node is None:
                return tuple(self.section(field.entry, _as_node(entry), key) for entry in field.default)
            if not isinstance(node.value, list) or len(node.value) > 64:
                self.refuse(node.line, key, f"expected a {field.describe()}, found {node.plain()!r}")
                return ()
            return tuple(self.section(field.entry, child, f"{key}[{i}]") for i, child in enumerate(node.value))
        if node is None:
            return field.convert(_listed(field.default)) if isinstance(field.default, tuple) else field.default
        try:
            return field.convert(node.plain())
        except Refusal as refusal:
            self.refuse(node.line, key, str(refusal))
            return field.default


def _listed(value):
    return [_listed(entry) for entry in value] if isinstance(value, tuple) else value


def _as_node(value, line=0) -> _Node:
    if isinstance(value, dict):
        return _Node({key: _as_node(entry, line) for key, entry in value.items()}, line)
    if isinstance(value, (list, tuple)):
        return _Node([_as_node(entry, line) for entry in value], line)
    return _Node(value, line)


if hasattr(yaml, "CSafeLoader"):
    from yaml.composer import Composer
    from yaml.cyaml import CParser
    from yaml.resolver import Resolver

    class _Loader(Composer, CParser, Resolver):
        """libyaml's parser, a sixth of PyYAML's instructions, and PyYAML's composer: libyaml's would follow a deep nesting until the stack is full."""

        def __init__(self, text):
            CParser.__init__(self, text)
            Composer.__init__(self)
            Resolver.__init__(self)

else:
    _Loader = yaml.SafeLoader


def _compose(text: str, checker: _Checker) -> _Node | None:
    try:
        tree = _Loader(text).get_single_node()
        return None if tree is None else checker.node(tree)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        checker.refuse(mark.line + 1 if mark else 0, "", f"not valid YAML: {getattr(error, 'problem', None) or error}")
    except (RecursionError, ValueError) as error:
        checker.refuse(0, "", f"not valid YAML: {error}")
    return None


def parse_override(text: str) -> tuple[str, str]:
    """("key.path", "value") from "key.path=value"; ConfigError otherwise."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"{text!r} is not of the form key=value.", "For example: --set estimator.control=ekf", "config_override")
    return key.strip(), value.strip()


def _override(root: _Node, overrides: dict, checker: _Checker) -> None:
    for key, value in overrides.items():
        node = root
        *path, last = key.split(".") if "gain_sets" not in key else _split_gain_key(key)
        for name in path:
            node = node.value.setdefault(name, _Node({}, OVERRIDDEN)) if isinstance(node.value, dict) else _Node(None, 0)
        if not isinstance(node.value, dict):
            checker.refuse(OVERRIDDEN, key, "no such key")
            continue
        if isinstance(value, str):
            parsed = _compose(value, checker) if value else _Node("", 0)
            value = parsed.plain() if parsed is not None else None
        node.value[last] = _as_node(value, OVERRIDDEN)


def _split_gain_key(key):
    """control.gain_sets.NAME.c1, where NAME may hold dots."""
    head, _, rest = key.partition("gain_sets.")
    name, _, last = rest.rpartition(".")
    return [*head.rstrip(".").split("."), "gain_sets", name, last]


def loads(text: str, source: str = "<text>", overrides: dict | None = None, expected: str | None = None) -> Config:
    """A configuration from YAML text; see `load`."""
    checker = _Checker(source)
    root = _compose(text, checker) or _Node({}, 1)
    if not isinstance(root.value, dict):
        checker.refuse(root.line, "", f"expected keys and values, found {root.plain()!r}")
        root = _Node({}, 1)
    if overrides:
        _override(root, overrides, checker)
    robot = root.value["robot"].plain() if "robot" in root.value else expected or "mbbr"
    if expected not in (None, robot):
        checker.refuse(root.value["robot"].line, "robot", f"this is the configuration of {robot!r}, asked for was {expected!r}")
    if not isinstance(robot, str) or robot not in ROBOTS:
        checker.refuse(root.value["robot"].line, "robot", f"expected one of {', '.join(ROBOTS)}, found {robot!r}{nearest(robot, ROBOTS)}")
        del root.value["robot"]
        robot = "mbbr"
    schema = ROBOTS[robot]
    config = checker.section(schema, root)
    if not checker.errors:
        for key, message in broken_rules(config):
            checker.refuse(checker.lines.get(key, 0), key, message)
    if checker.errors:
        listed = "\n".join(f"  {error}" for error in checker.errors[:50])
        raise ConfigError(
            f"{len(checker.errors)} error{'s' if len(checker.errors) > 1 else ''} in the configuration:\n{listed}",
            "Correct the lines named; mip-rt config docs explains every key.",
        )
    return config


def read_text(path) -> str:
    """The text of a configuration or scenario file; ConfigError where it cannot be read."""
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ConfigError(f"{path} is larger than 1 MiB.", "Name the right file.", "config_unreadable")
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ConfigError(f"{path} cannot be read: {reason}.", "Name a file with --config.", "config_unreadable") from error


def load(path, overrides: dict | None = None, expected: str | None = None) -> Config:
    """Loads and checks a configuration file.

    Args:
        path: YAML file.
        overrides: dotted key to value (text is read as YAML), as from --set.
        expected: robot that the file must be for, or is for where it does not say; None for any.

    Raises:
        ConfigError: with every error of the file, each with file, line and key.
    """
    return loads(read_text(path), str(path), overrides, expected)


def folders() -> list[Path]:
    """Where shipped and installed configurations are looked for, in order."""
    named = [Path(os.environ["MIP_RT_CONFIG"])] if os.environ.get("MIP_RT_CONFIG") else []
    checkout = Path(__file__).resolve().parents[2] / "config"
    return [*named, Path("/etc/mip-rt"), checkout, Path(sys.prefix) / "share" / "mip-rt" / "config"]


def default_path(robot: str = "mbbr") -> Path:
    """The configuration file of a robot; ConfigError where none is installed."""
    for folder in folders():
        if (folder / f"{robot}.yaml").exists():
            return folder / f"{robot}.yaml"
    looked = ", ".join(str(folder) for folder in folders())
    raise ConfigError(f"no {robot}.yaml in {looked}.", f"Make one: mip-rt config template --robot {robot} > {robot}.yaml", "config_missing")
