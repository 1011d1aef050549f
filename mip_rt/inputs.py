"""The beginning of a tick in two compiled calls: `sense` reads the sensors; `gather` writes what is known into the row (times, supervisor, sensors,
remote), and beats.

Each driver keeps what it has found in a record of its own; here the records' addresses come together. In Python the same took 27,000 ARM
instructions a tick (`tools/test-armhf parts`).
"""

from functools import partial

import numpy as np

from mip_rt import guard_words
from mip_rt.compiled import JIT_DISABLED, direct, entry, njit, records_at, span
from mip_rt.hardware import compiled_io, imu_read, line_events
from mip_rt.hardware.imu_status import IMU_OK
from mip_rt.log import commit
from mip_rt.remote import dead_man

GUARD = 0b11  # bits of the answer: guard_words.OK, LINE_DROPPED or LOST
REMOTE_LOST = 0b100

PACKET = 4  # numbers of 64 bits
ADDRESSES = np.dtype([(name, "u8") for name in ("line", "counters", "packet", "remote", "gyro_bias", "guard")], align=True)

SENSORS = np.dtype([("rows", "u8"), ("row_bytes", "i8"), ("counters", "u8"), ("imu", "u8")], align=True)

_beat = njit(guard_words.beat)


@entry("uintp", "int64")
def sense(sensors_at, index):
    """Begins row `index` and reads encoders and IMU; what they say is in their drivers' records then.

    Args:
        sensors_at: address of one SENSORS.

    Returns:
        The answer of `imu_read.usual`.
    """
    s = records_at(sensors_at, 1, SENSORS)[0]
    commit.begin(s.rows, s.row_bytes, index)
    compiled_io.read_all(records_at(s.counters, 1, compiled_io.COUNTERS)[0])
    return imu_read.usual(s.imu)


@njit
def gather(addresses, rows, index, tick, wake_ns, read_ns, state, request, refusals, imu_status, imu_backlog, battery_v, drive_scale):
    """Fills the inputs of rows[index], but for `sequence`, and beats.

    Args:
        addresses: (1,) ADDRESSES.
        rows: (n,) frames.
        tick ... drive_scale: what goes into the fields of these names.

    Returns:
        Bits GUARD and REMOTE_LOST.
    """
    a = addresses[0]
    row = rows[index]
    line = records_at(a.line, 1, line_events.STATE)[0]
    row.tick = tick
    row.edge_ns = line.timestamp_ns
    row.wake_ns = wake_ns
    row.read_ns = read_ns
    row.missed = line.count - 1
    row.state = state
    row.request = request
    row.refusals = refusals
    row.imu_status = imu_status
    row.imu_backlog = imu_backlog
    row.battery_v = battery_v
    row.drive_scale = drive_scale
    counters = records_at(a.counters, 1, compiled_io.COUNTERS)[0]
    for i in range(len(row.encoder_count)):
        row.encoder_count[i] = counters.count[i]
    if imu_status & IMU_OK:
        packet = records_at(a.packet, 8 * PACKET, np.uint8)
        for i in range(8 * PACKET):
            row.imu_packet[i] = packet[i]
    remote = records_at(a.remote, 1, dead_man.STATE)[0]
    dead_man.step(remote, wake_ns)
    row.remote_velocity_m_s[0] = remote.command[0]
    row.remote_velocity_m_s[1] = remote.command[1]
    row.remote_yaw_rate_rad_s = remote.command[2]
    row.remote_age_s = remote.age_s
    bias = records_at(a.gyro_bias, 3, np.float64)
    for i in range(3):
        row.gyro_bias_rad_s[i] = bias[i]
    memory = records_at(a.guard, 4, np.int64)
    found = _beat(records_at(memory[guard_words.WORDS_AT], guard_words.WORDS_BYTES // 4, np.uint32), memory, read_ns)
    return found if remote.alive else found | REMOTE_LOST


def gatherer(devices, robot):
    """`gather` bound to these devices and this robot's rows: a callable(index, tick, ..., drive_scale)."""
    owners = devices.imu_line.state, devices.counters, devices.imu.packet, devices.remote.state, robot.gyro_bias_rad_s
    addresses = np.zeros(1, ADDRESSES).view(np.recarray) if JIT_DISABLED else np.zeros(1, ADDRESSES)  # plain Python needs fields as attributes
    addresses[0] = (*(owner.ctypes.data for owner in owners), devices.guard.memory.buffer_info()[0])
    bound = partial(_gather_for(robot.layout.dtype), *span(addresses), *span(robot.rows))
    bound.owners = *owners, devices.guard, addresses, robot.rows  # whose memory must live as long as this
    return bound


def sensor(devices, ring):
    """`sense` bound to these devices and this ring: a callable(index)."""
    owners = ring.rows, devices.counters, devices.imu.usual
    rows, counters, usual = (owner.ctypes.data for owner in owners)
    sensors = np.zeros(1, SENSORS)
    sensors[0] = rows, ring.row_bytes, counters, usual
    bound = partial(direct(sense), sensors.ctypes.data)
    bound.owners = *owners, sensors  # whose memory must live as long as this
    return bound


def gather_types(frame_dtype) -> tuple:
    """Types of the arguments of `gather` for the rows of one robot."""
    return ADDRESSES, frame_dtype, *("int64",) * 9, "float64", "float64"


def _gather_for(frame_dtype):
    return direct(gather, *gather_types(frame_dtype))


def compile_for(frame_dtype) -> None:
    """Compiles what a tick calls besides the step, so that nothing compiles once the IMU runs."""
    _gather_for(frame_dtype)
    compiled_io.writer_for(frame_dtype)
