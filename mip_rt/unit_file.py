"""A unit's calibration file: what `mip-rt calibrate` has found of this one robot, and what a run takes from it.

JSON in the state folder (imu.calibration_file): version, unit, and one part for each calibration with its date, figures and residual. Version 1 knew only
the gyro's bias, at the top; that is still read and still written. Everything but the bias takes the place of values of the configuration, so what
was in force stands in a log's header, and a replay needs no file.
"""

import json
import math
import os
import time
from dataclasses import dataclass, field
from pathlib import Path

from mip_rt.errors import ConfigError, MipRtError

VERSION = 2
# part: {its figure: (numbers, key of the configuration, None: compared at the start)}; numbers 0 is a single one, -1 one a wheel
PARTS = {
    "gyro": {"bias_rad_s": (3, None)},
    "level": {"lean_rad": (2, "imu.level_rad")},
    "accelerometer": {"gain": (3, "imu.accel_gain"), "offset_m_s2": (3, "imu.accel_offset_m_s2")},
    "encoders": {"counts_per_turn": (0, "encoders.counts_per_turn"), "signs": (-1, "encoders.signs")},
    "motors": {"signs": (-1, "motors.signs")},
}


@dataclass
class UnitFile:
    """What is known of a unit.

    Attributes:
        unit: its name.
        parts: of PARTS: figures, `measured_unix_s`, and residuals under their own names.
    """

    unit: str
    parts: dict = field(default_factory=dict)

    @property
    def gyro_bias_rad_s(self) -> tuple | None:
        """Body axes; None where it was not measured."""
        return tuple(self.parts["gyro"]["bias_rad_s"]) if "gyro" in self.parts else None

    @property
    def measured_unix_s(self) -> float:
        """Of the newest part; 0 where there is none."""
        return max((part["measured_unix_s"] for part in self.parts.values()), default=0.0)

    def describe(self) -> str:
        """Which unit, and how old."""
        return f"unit {self.unit}, {max(0.0, time.time() - self.measured_unix_s) / 86400.0:.0f} days old"

    def overrides(self) -> dict:
        """{key of the configuration: value}."""
        return {
            key: self.parts[name][figure]
            for name in self.parts for figure, (_, key) in PARTS[name].items()
            if key is not None and figure in self.parts[name]
        }  # fmt: skip

    def applied(self) -> dict:
        """For a log's header: the unit, and each part's date and figures."""
        return {"unit": self.unit, "unit_parts": self.parts}

    def content(self) -> dict:
        """As it stands in the file."""
        gyro = {"measured_unix_s": self.measured_unix_s, "gyro_bias_rad_s": list(self.gyro_bias_rad_s)} if "gyro" in self.parts else {}
        return {"version": VERSION, "unit": self.unit, **gyro, "parts": self.parts}


def _figures(name: str, content: dict) -> dict:
    """A part, checked."""
    found = dict(content)
    found["measured_unix_s"] = float(content["measured_unix_s"])
    present = [figure for figure in PARTS[name] if figure in content]
    if not present:
        raise ValueError(f"{name} has none of {', '.join(PARTS[name])}")
    for figure in present:
        number, _ = PARTS[name][figure]
        values = [content[figure]] if number == 0 else list(content[figure])
        if not all(isinstance(value, (int, float)) and math.isfinite(value) for value in (*values, found["measured_unix_s"])):
            raise ValueError(f"finite numbers are wanted in {name}")
        if number > 0 and len(values) != number:
            raise ValueError(f"{number} numbers are wanted in {name}.{figure}")
    return found


def load_unit_file(path: Path) -> UnitFile | None:
    """The file's content; None where there is no file.

    Raises:
        MipRtError: calibration_invalid, with what is wrong.
    """
    try:
        content = json.loads(path.read_text())
        parts = dict(content.get("parts", {}))
        if content.get("version", 1) > VERSION:
            raise ValueError(f"version {content['version']} is newer than this program")
        if "version" not in content:
            bias = [float(value) for value in content["gyro_bias_rad_s"]]
            parts = {"gyro": {"measured_unix_s": content["measured_unix_s"], "bias_rad_s": bias}}
        unknown = set(parts) - set(PARTS)
        if unknown:
            raise ValueError(f"no such part: {', '.join(sorted(unknown))}")
        return UnitFile(str(content["unit"]), {name: _figures(name, part) for name, part in parts.items()})
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        problem = f"{type(error).__name__}: {error}"
        raise MipRtError(f"the calibration file {path} cannot be used: {problem}.", "Repair or remove it.", "calibration_invalid") from error


def unit_path(config, kernel) -> Path:
    """Where the file of this machine's unit is."""
    return kernel.path(config.imu.calibration_file.lstrip("/"))


def apply_unit_file(config, kernel):
    """(configuration with the unit's values in it, UnitFile or None or the MipRtError that says why it cannot be used).

    A file that cannot be used changes nothing; the pre-arm check keeps the robot disarmed then.
    """
    from mip_rt.config import loads

    path = unit_path(config, kernel)
    try:
        unit = load_unit_file(path)
        overrides = unit.overrides() if unit is not None else {}
        return (loads(config.to_yaml(), str(path), overrides) if overrides else config), unit
    except ConfigError as error:
        return config, MipRtError(f"the calibration file {path} does not fit this robot: {error.sentence}", "Calibrate this unit anew, or remove the file.",
                                  "calibration_invalid")  # fmt: skip
    except MipRtError as error:
        return config, error


def store(path: Path, unit: str | None, name: str, figures: dict) -> UnitFile:
    """Puts one part into the unit's file, which is made or replaced as a whole; returns the new content.

    Args:
        unit: its name; None keeps the file's.
        name: of PARTS.
        figures: with residuals; the date is added.

    Raises:
        MipRtError: an unusable file is there (it is not overwritten), or the folder refuses.
    """
    known = load_unit_file(path) or UnitFile(unit or "unnamed")
    known.unit = unit or known.unit
    known.parts[name] = _figures(name, {"measured_unix_s": round(time.time(), 1), **figures})
    temporary = path.with_name(path.name + ".new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(temporary, "w") as file:
            json.dump(known.content(), file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise MipRtError(f"{path} cannot be written: {error.strerror}.", "Run it as the user mip-rt or as root (sudo).", "calibration_write") from error
    return known
