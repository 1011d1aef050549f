"""A window of IMU packets as arrays, for calibration and doctor: what the loop does tick by tick, without a loop.

Interrupt and driver are those of a run. Every wait is bounded.
"""

import math
import struct
from dataclasses import dataclass

import numpy as np

from mip_rt.hardware import mpu9250_registers as r
from mip_rt.hardware.imu_status import IMU_OK

GRAVITY_M_S2 = 9.80665  # of the accelerometer's scale
SILENCE_S = 0.1
_PACKET = struct.Struct(">4i6h")


@dataclass
class Window:
    """What arrived.

    Attributes:
        edge_ns: (n,) kernel timestamps of the interrupts, missed ones left out.
        missed: interrupts that came while another was being worked on.
        silences: waits that ended without an interrupt.
        status: {IMU_* bits: how often}, of every read.
        quaternion: (m, 4) normalised, w first; zeros where the chip computes none.
        force_m_s2: (m, 3) accelerometer, chip axes, as the chip reports it (up at rest).
        rate_rad_s: (m, 3) gyro, chip axes.
    """

    edge_ns: np.ndarray
    missed: int
    silences: int
    status: dict
    quaternion: np.ndarray
    force_m_s2: np.ndarray
    rate_rad_s: np.ndarray

    @property
    def attitude_rad(self) -> np.ndarray:
        """(m, 2) roll and pitch of the quaternions: R = Rz Ry Rx."""
        w, x, y, z = self.quaternion.T
        roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        return np.stack([roll, np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))], 1)


def collect(kernel, imu, line, settings, seconds: float, rate_hz: float) -> Window:
    """Reads a started IMU for so long.

    Args:
        imu, line: driver, and hardware.gpio.InputEvents of its interrupt.
        settings: the configuration's imu section, for the scales.
        rate_hz: expected rate: bounds the window also in packets.
    """
    line.forget()  # interrupts from before the window
    edges, rows, status = [], [], {}
    missed = silences = 0
    end_ns = kernel.monotonic_ns() + round(seconds * 1e9)
    most = math.ceil(4 * seconds * rate_hz) + 10
    while kernel.monotonic_ns() < end_ns and len(edges) < most and silences < 20:
        edge = line.read() if kernel.wait_readable(line.fd, SILENCE_S) else None
        if edge is None:
            silences += 1
            imu.on_timeout()
            continue
        edges.append(edge[0])
        missed += edge[2] - 1
        found = imu.read()
        status[found] = status.get(found, 0) + 1
        if found & IMU_OK:
            rows.append(_PACKET.unpack_from(imu.packet))
    data = np.array(rows, float).reshape(-1, 10)
    norm = np.linalg.norm(data[:, :4], axis=1, keepdims=True)
    return Window(
        np.array(edges, np.int64), missed, silences, status,
        data[:, :4] / np.where(norm > 0.0, norm, 1.0),
        data[:, 4:7] * (settings.accel_range_g * GRAVITY_M_S2 / 32768.0),
        data[:, 7:10] * (math.radians(settings.gyro_range_dps) / 32768.0),
    )  # fmt: skip
