"""The onboard attitude on real recordings with motion capture: inclination errors on trials of BROAD, beside those of VQF.

Data: D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - A Benchmark for Robust Inertial Orientation Estimation", Data 6(7), 2021, CC BY 4.0;
one .npz a trial with gyro (rad/s), accel (m/s^2, specific force), quaternion (w x y z, sensor to east-north-up, NaN where the cameras lost
it), movement (samples that count), rate_hz. They are not part of this project.

The IMU's rates lag behind the cameras by the same 2.3 ms in every trial, two thirds of a sample: at fast rotation that lag is half of any
filter's error. The table shows both filters with it made good (ours by `imu.gyro_delay_s`) and without.
"""

import json
from pathlib import Path

import numpy as np

from mip_rt.errors import MipRtError
from mip_rt.estimators import attitude

FOLDER = Path("../shared/data/broad")
GYRO_DELAY_S = 0.0023
GOAL_DEG = 0.516  # a tenth below the mean of VQF's four errors
# VQF 2.1.2 without magnetometer, default parameters, same score, degrees, by the beginning of the trial's name.
VQF = {"02": 0.429, "07": 1.023, "15": 0.470, "27": 0.370}
# The same, its attitudes turned on by the present rates times GYRO_DELAY_S: what is due to the delay alone.
VQF_TURNED_ON = {"02": 0.355, "07": 0.494, "15": 0.429, "27": 0.360}


class RecordingsMissing(MipRtError):
    """No recordings in the folder, or files that are none."""

    code = "recordings_missing"


def load(path: Path) -> dict:
    """The arrays of one trial in float64.

    Raises:
        RecordingsMissing: the file is no such recording.
    """
    try:
        with np.load(path) as file:
            trial = {name: np.ascontiguousarray(file[name], dtype=float) for name in ("gyro", "accel", "quaternion")}
            trial |= {"movement": file["movement"].astype(bool), "rate_hz": float(file["rate_hz"])}
    except (OSError, ValueError, KeyError) as error:
        raise RecordingsMissing(f"{path} is no recording of BROAD ({error}).", "Convert it as the README beside the data says.") from error
    return trial


def inclination_error_deg(truth, estimate) -> np.ndarray:
    """(n,) angle in degrees between the vertical axes of two sequences of quaternions (n, 4), whatever their headings."""
    w = np.einsum("ni,ni->n", truth, estimate)
    z = truth[:, 3] * estimate[:, 0] - truth[:, 0] * estimate[:, 3] + truth[:, 2] * estimate[:, 1] - truth[:, 1] * estimate[:, 2]
    return np.degrees(2.0 * np.arccos(np.minimum(np.hypot(w, z), 1.0)))


def estimate(trial: dict, gyro_delay_s: float) -> np.ndarray:
    """(n, 4) attitudes of the onboard filter, started at the first sample."""
    p = np.zeros(1, attitude.PARAMETERS).view(np.recarray)[0]
    attitude.configure(p, 1.0 / trial["rate_hz"], gyro_delay_s=gyro_delay_s)
    found = np.empty((len(trial["gyro"]), 4))
    attitude.run(p, attitude.init(p), trial["gyro"], trial["accel"], found)
    return found


def score(trial: dict, gyro_delay_s: float) -> float:
    """RMS inclination error in degrees over the samples in movement that the cameras saw."""
    error = inclination_error_deg(trial["quaternion"], estimate(trial, gyro_delay_s))
    return float(np.sqrt(np.mean(error[trial["movement"] & np.isfinite(error)] ** 2)))


def run(folder, progress=lambda done, total, what: None) -> dict:
    """{trial: {"onboard": degrees, "uncompensated": degrees, "vqf": degrees or None, "vqf_turned_on": likewise}} of every recording in the folder.

    Raises:
        RecordingsMissing: there is none.
    """
    paths = sorted(Path(folder).glob("*.npz"))
    if not paths:
        raise RecordingsMissing(f"{folder} holds no recordings of BROAD (*.npz).", "Name their folder with --data.")
    result = {}
    for number, path in enumerate(paths):
        progress(number, len(paths), path.stem)
        trial = load(path)
        result[path.stem] = {
            "onboard": score(trial, GYRO_DELAY_S), "uncompensated": score(trial, 0.0),
            "vqf": VQF.get(path.stem[:2]), "vqf_turned_on": VQF_TURNED_ON.get(path.stem[:2]),
        }  # fmt: skip
    progress(len(paths), len(paths), "")
    return result


def passed(result: dict) -> bool:
    """At most VQF's error on each trial where that is known, and where all are known a mean a tenth below."""
    known = [trial for trial in result.values() if trial["vqf"] is not None]
    mean = np.mean([trial["onboard"] for trial in known]) if len(known) == len(VQF) else 0.0
    return all(trial["onboard"] <= trial["vqf"] for trial in known) and mean <= GOAL_DEG


def render(result: dict) -> str:
    """Markdown."""
    keys = ("onboard", "vqf_turned_on", "uncompensated", "vqf")
    rows = {name: [trial[key] for key in keys] for name, trial in result.items()}
    columns = list(zip(*rows.values()))
    rows["mean"] = [None if None in column else float(np.mean(column)) for column in columns]
    lines = [
        "Inclination error, RMS in degrees (BROAD, CC BY 4.0, Laidig et al. 2021; VQF 2.1.2 without magnetometer).",
        f"The gyro's delay of {1e3 * GYRO_DELAY_S:g} ms is made good in the first two columns.", "",
        "| trial | onboard | VQF | onboard, as samples come | VQF, as samples come |", "|---|---|---|---|---|",
    ]  # fmt: skip
    for name, errors in rows.items():
        lines.append(f"| {name} | " + " | ".join("" if error is None else f"{error:.3f}" for error in errors) + " |")
    return "\n".join(lines)


def report(folder, as_json: bool, progress) -> int:
    """Prints the table of the recordings in a folder (None: FOLDER); exit code 1 where they do not pass."""
    found = run(folder or FOLDER, progress)
    print(json.dumps(found) if as_json else render(found))
    return int(not passed(found))
