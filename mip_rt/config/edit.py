"""Changes single values in a configuration file and leaves everything else, comments included, as it is."""

import os
import re
from pathlib import Path

from mip_rt.config.loading import loads, read_text
from mip_rt.errors import ConfigError


def _set(lines: list, key: str, value) -> None:
    section, _, name = key.partition(".")
    text = str(list(value) if isinstance(value, (list, tuple)) else value)
    begin = next((i for i, line in enumerate(lines) if re.match(rf"{re.escape(section)}:\s*(#.*)?$", line)), None)
    if begin is None:
        lines += [f"{section}:", f"  {name}: {text}"]
        return
    end = next((i for i in range(begin + 1, len(lines)) if re.match(r"\S", lines[i]) and not lines[i].startswith("#")), len(lines))
    for i in range(begin + 1, end):
        found = re.match(rf"(\s+{re.escape(name)}:\s*)([^#]*?)(\s*(?:#.*)?)$", lines[i])
        if found:
            if not found[2]:
                raise ConfigError(f"{key} is written over several lines.", f"Set it by hand to {text}.", "config_edit")
            lines[i] = f"{found[1]}{text}{found[3]}"
            return
    lines.insert(begin + 1, f"  {name}: {text}")


def set_values(path, values: dict) -> None:
    """Sets values of the form section.key; the file is replaced only where the result is a valid configuration.

    Raises:
        ConfigError: it cannot be read, edited or written, or would not be valid.
    """
    path = Path(path)
    lines = read_text(path).splitlines()
    for key, value in values.items():
        _set(lines, key, value)
    text = "\n".join(lines) + "\n"
    changed = loads(text, str(path))
    for key, value in values.items():
        section, _, name = key.partition(".")
        found = getattr(getattr(changed, section), name)
        if (list(found) if isinstance(found, tuple) else found) != (list(value) if isinstance(value, (list, tuple)) else value):
            raise ConfigError(f"{key} cannot be set in {path}.", f"Set it by hand to {value}.", "config_edit")
    temporary = path.with_name(path.name + ".new")
    try:
        temporary.write_text(text)
        os.replace(temporary, path)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}.", "Run it as root (sudo), or name your own file with --config.", "config_edit") from error
