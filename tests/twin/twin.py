"""Builds the C twin: writes its structs from the numpy record types, compiles it with gcc, loads it."""

import ctypes
import subprocess
from pathlib import Path

import numpy as np

from mip_rt.controllers import gain_schedule, reference, spin_down, state_feedback, wheel_drive
from mip_rt.estimators import attitude, ekf, mbbr_ekf, mbbr_kf, momentum_observer, odometry
from mip_rt.models import mbbr_momentum, mbbr_yaw
from mip_rt.robots import health, mbbr, mbbr_frame, mbbr_sensors, onboard

RECORDS = {
    "Noise": ekf.NOISE, "Filter": ekf.STATE, "AttitudeFilterP": attitude.PARAMETERS,
    "AttitudeFilterS": attitude.STATE, "AttitudeP": onboard.PARAMETERS, "AttitudeS": onboard.STATE,
    "Coefficients": mbbr_yaw.COEFFICIENTS, "EkfParameters": mbbr_ekf.PARAMETERS,
    "KfModel": mbbr_kf.MODEL, "KfParameters": mbbr_kf.PARAMETERS, "MomentumModel": mbbr_momentum.PARAMETERS,
    "MomentumP": momentum_observer.PARAMETERS, "SensorsP": mbbr_sensors.PARAMETERS,
    "SensorsS": mbbr_sensors.STATE, "ReferenceP": reference.PARAMETERS, "ReferenceS": reference.STATE,
    "ScheduleP": gain_schedule.PARAMETERS, "ScheduleS": gain_schedule.STATE, "FeedbackP": state_feedback.PARAMETERS,
    "FeedbackS": state_feedback.STATE, "OdometryS": odometry.STATE, "DriveP": wheel_drive.PARAMETERS, "SpinDownP": spin_down.PARAMETERS,
    "SpinDownS": spin_down.STATE, "HealthP": health.PARAMETERS, "HealthS": health.STATE, "RobotP": mbbr.PARAMETERS, "RobotS": mbbr.STATE,
    "EstimatorP": mbbr.ESTIMATOR_PARAMETERS, "EstimatorS": mbbr.ESTIMATOR_STATE, "Frame": mbbr_frame.FRAME,
}  # fmt: skip
C_TYPES = {"<f8": "double", "<i8": "int64_t", "|u1": "uint8_t"}


def header() -> str:
    """C structs of the records; the sizes are asserted."""
    lines = []
    for name, dtype in RECORDS.items():
        fields = []
        for field in dtype.names:
            kind = dtype.fields[field][0]
            base, shape = (kind.subdtype if kind.subdtype else (kind, ()))
            c_type = C_TYPES.get(base.str) or next(n for n, d in RECORDS.items() if d == base)
            fields.append(f"{c_type} {field}{''.join(f'[{size}]' for size in shape)};")
        lines += [f"typedef struct {{ {' '.join(fields)} }} {name};", f'_Static_assert(sizeof({name}) == {dtype.itemsize}, "{name}");']
    return "\n".join(lines) + "\n"


def build(folder: Path, flags=("-O3", "-march=native")) -> ctypes.CDLL:
    """Compiles and loads the twin."""
    (folder / "records.h").write_text(header())
    source, library = Path(__file__).with_name("twin.c"), folder / "twin.so"
    subprocess.run(["gcc", *flags, "-shared", "-fPIC", f"-I{folder}", "-o", library, source, "-lm"], check=True)
    return ctypes.CDLL(str(library))


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Address of an array's data."""
    return ctypes.c_void_p(array.ctypes.data)
