"""The DMP's image and the writes that configure its features.

The image is InvenSense's and cannot be shipped; it is read from a file that the user provides, checked by length and SHA-256.
Feature bytes: facts of MotionDriver 6.12 (addresses in `mpu9250_registers`).
"""

import hashlib
import struct
from pathlib import Path

from mip_rt.errors import DmpImageError
from mip_rt.hardware import mpu9250_registers as r

GYRO_SCALE = 46850825  # trunc(2^44 (2000 / 32768) (pi / 180) / (2 * 200)): holds for 2000 deg/s at 200 Hz only
CHUNK = 16
SAMPLE_HZ = 200
CURE = (
    "Get it from the sources of librobotcontrol or MotionDriver 6.12, or from librobotcontrol.so: mip-rt dmp extract PATH; "
    "or do without the DMP: imu.attitude: onboard."
)


def load_image(path, sha256: str) -> bytes:
    """The DMP image.

    Raises:
        DmpImageError: missing, wrong length or wrong hash; the cure says how to get it.
    """
    try:
        image = Path(path).read_bytes()
    except OSError as error:
        raise DmpImageError(f"the DMP image {path} cannot be read: {error.strerror}.", CURE, "dmp_image_missing") from error
    if len(image) != r.DMP_IMAGE_BYTES:
        raise DmpImageError(f"{path} has {len(image)} bytes, the image has {r.DMP_IMAGE_BYTES}.", CURE, "dmp_image_length")
    found = hashlib.sha256(image).hexdigest()
    if found != sha256:
        raise DmpImageError(f"{path} has SHA-256 {found[:16]}..., expected {sha256[:16]}....", CURE, "dmp_image_hash")
    return image


def _orientation_writes(name: str):
    scalar = r.ORIENTATIONS[name]
    axes = [(scalar >> (3 * row)) & 3 for row in range(3)]
    signs = [(scalar >> (3 * row + 2)) & 1 for row in range(3)]
    yield r.FCFG_1, bytes((0x4C, 0xCD, 0x6C)[axis] for axis in axes)
    yield r.FCFG_2, bytes((0x0C, 0xC9, 0x2C)[axis] for axis in axes)
    yield r.FCFG_3, bytes(base | sign for base, sign in zip((0x36, 0x56, 0x76), signs))
    yield r.FCFG_7, bytes(base | sign for base, sign in zip((0x26, 0x46, 0x66), signs))


def _tap_writes(accel_range_g: int):
    """Tap detection stays on: without it slow rates bring no interrupts; thresholds are far out of reach of balancing."""
    threshold = 250 / 200.0 * {2: 16384, 4: 8192, 8: 4096, 16: 2048}[accel_range_g]
    yield r.CFG_20, b"\xf8"
    for place, place_3_4 in zip(r.TAP_THRESHOLD, r.TAP_THRESHOLD_3_4):
        yield place, struct.pack(">H", int(threshold))
        yield place_3_4, struct.pack(">H", int(threshold * 0.75))
    yield r.D_1_72, b"\x3f"
    yield r.D_1_79, b"\x00"
    yield r.TAPW_MIN, struct.pack(">H", 100 // 5)
    yield r.D_1_218, struct.pack(">H", 500 // 5)
    yield r.D_1_92, struct.pack(">I", GYRO_SCALE // 1000 * 200)
    yield r.D_1_90, struct.pack(">H", 40 // 5)
    yield r.D_1_88, struct.pack(">H", 10 // 5)


def feature_writes(orientation: str, accel_range_g: int, rate_hz: float = SAMPLE_HZ):
    """(address, bytes) in order: 6-axis quaternion, raw accelerometer and gyro, gesture word: the 32-byte packet at rate_hz.

    The DMP itself always runs at 200 Hz; rate_hz, a divisor of it, is how often it delivers.
    """
    yield from _orientation_writes(orientation)
    yield r.D_0_104, struct.pack(">I", GYRO_SCALE)
    yield r.CFG_15, bytes((0xA3, 0xC0, 0xC8, 0xC2, 0xC4, 0xCC, 0xC6, 0xA3, 0xA3, 0xA3))
    yield r.CFG_27, b"\x20"
    # Automatic gyro calibration off: it may begin while the robot balances quietly, and the bias would jump.
    yield r.CFG_MOTION_BIAS, bytes((0xB8, 0xAA, 0xAA, 0xAA, 0xB0, 0x88, 0xC3, 0xC5, 0xC7))
    yield r.CFG_GYRO_RAW, bytes((0xB0, 0x80, 0xB4, 0x90))
    yield from _tap_writes(accel_range_g)
    yield r.CFG_ANDROID_ORIENT, b"\xd8"
    yield r.CFG_LP_QUAT, bytes((0x8B,) * 4)
    yield r.CFG_8, bytes((0x20, 0x28, 0x30, 0x38))
    yield r.D_0_22, struct.pack(">H", round(SAMPLE_HZ / rate_hz) - 1)
    yield r.CFG_6, bytes((0xFE, 0xF2, 0xAB, 0xC4, 0xAA, 0xF1, 0xDF, 0xDF, 0xBB, 0xAF, 0xDF, 0xDF))
    yield r.CFG_FIFO_ON_EVENT, bytes((0xD8, 0xB1, 0xB9, 0xF3, 0x8B, 0xA3, 0x91, 0xB6, 0x09, 0xB4, 0xD9))


def chunks(address: int, data: bytes):
    """(address, part) of at most 16 bytes that do not cross a bank of 256."""
    at = 0
    while at < len(data):
        size = min(CHUNK, len(data) - at, 256 - (address + at) % 256)
        yield address + at, data[at : at + size]
        at += size
