"""The IMU driver without DMP against the register-level chip: bring-up, rate, new and old samples, what cannot be measured."""

import errno
import struct
from types import SimpleNamespace

import pytest
from chip import Clock

from mip_rt.errors import ImuError
from mip_rt.hardware import mpu9250_registers as r
from mip_rt.hardware.imu_status import IMU_BAD_NORM, IMU_BUS_ERROR, IMU_FROZEN, IMU_NO_DATA, IMU_OK
from mip_rt.hardware.mpu9250_raw import RawMpu9250

pytestmark = pytest.mark.armhf
DMP_PACKET = bytes(32)


def made(clock, rate_hz=200.0, **changes):
    values = dict(bus=2, address=0x68, accel_range_g=8, gyro_range_dps=2000, dlpf_hz=184, dmp_image="/nowhere", dmp_image_sha256="", interrupt_latched=False)
    return RawMpu9250(clock, SimpleNamespace(**{**values, **changes}), rate_hz)


@pytest.fixture
def started():
    clock = Clock()
    imu = made(clock)
    imu.start()
    return clock, imu


def raw(number=0, gyro=(1, 2, 3)):
    return struct.pack(">7h", 100, -200, 4096 + number, 5000, *gyro)


def read(imu):
    """(status, packet)."""
    return imu.read(), imu.packet.tobytes()


def test_brings_the_data_ready_interrupt_without_an_image(started):
    clock, imu = started
    registers = clock.chip.registers
    assert registers[r.INT_ENABLE] == r.INT_RAW_READY and registers[r.SMPLRT_DIV] == 4 and not clock.chip.dmp_runs
    assert registers[r.GYRO_CONFIG] == 0x18 and registers[r.ACCEL_CONFIG] == 0x10 and not registers[r.USER_CTRL] and imu.chip == "MPU-9250"


def test_words_stand_where_the_dmp_has_them(started):
    """The step reads accelerometer and gyro from the same places, whoever put them there."""
    clock, imu = started
    assert clock.chip.sample(DMP_PACKET, raw()) is True
    transfers = clock.chip.transfers
    status, packet = read(imu)
    assert status == IMU_OK and clock.chip.transfers == transfers + 1
    assert packet[16:22] == raw()[:6] and packet[22:28] == raw()[8:14] and packet[28:30] == raw()[6:8] and packet[30] == r.INT_RAW_READY
    assert not any(packet[:16]) and packet[31] == 0


def test_half_the_rate_is_every_second_sample():
    clock = Clock()
    made(clock, 100.0).start()
    assert [clock.chip.sample(DMP_PACKET, raw(n)) for n in range(6)] == [False, True] * 3


def test_a_sample_counts_once(started):
    """A doubled interrupt must not integrate the same rates twice."""
    clock, imu = started
    clock.chip.sample(DMP_PACKET, raw())
    assert read(imu)[0] == IMU_OK
    assert read(imu)[0] == IMU_NO_DATA


@pytest.mark.parametrize("sample", [b"\xff" * 14, bytes(14), raw(gyro=(20000, 2, 3)), raw(gyro=(1, 2, -20000))])
def test_what_cannot_be_measured_is_refused(started, sample):
    """A bus that is held or released, and a rate that no body reaches in 5 ms."""
    clock, imu = started
    clock.chip.sample(DMP_PACKET, raw())
    read(imu)
    clock.chip.sample(DMP_PACKET, sample)
    before = imu.packet.tobytes()
    assert read(imu) == (IMU_BAD_NORM, before) and imu.counters["bad_norm"] == 1


def test_a_fast_turn_that_lasts_is_believed(started):
    """Otherwise one collision would blind the robot for ever."""
    clock, imu = started
    results = []
    for n in range(4):
        clock.chip.sample(DMP_PACKET, raw(n, gyro=(20000, 2, 3)))
        results.append(read(imu)[0])
    assert results == [IMU_BAD_NORM] + [IMU_OK] * 3


def test_ten_equal_samples_are_frozen_data(started):
    clock, imu = started
    results = []
    for _ in range(12):
        clock.chip.sample(DMP_PACKET, raw(5))
        results.append(read(imu)[0])
    assert results == [IMU_OK] * 9 + [IMU_FROZEN] * 3
    clock.chip.sample(DMP_PACKET, raw(6))
    assert read(imu)[0] == IMU_OK


def test_one_bus_error_is_retried_and_two_are_reported(started):
    clock, imu = started
    clock.chip.sample(DMP_PACKET, raw())
    failures = [1]

    def before(messages):
        if failures[0]:
            failures[0] -= 1
            raise OSError(errno.EIO, "injected")

    clock.bus.before = before
    assert read(imu)[0] == IMU_OK
    failures[0] = 2
    assert read(imu)[0] == IMU_BUS_ERROR and imu.counters["bus_errors"] == 1


def test_recover_mends_a_chip_that_lost_its_power(started):
    clock, imu = started
    clock.chip._power_on()
    assert clock.chip.sample(DMP_PACKET, raw()) is False
    imu.recover()
    assert clock.chip.sample(DMP_PACKET, raw()) is True and read(imu)[0] == IMU_OK
    assert clock.chip.registers[r.GYRO_CONFIG] == 0x18 and imu.counters["resets"] == 1


def test_latched_line_gives_edges_again_after_a_timeout():
    clock = Clock()
    imu = made(clock, interrupt_latched=True)
    imu.start()
    assert [clock.chip.sample(DMP_PACKET, raw(n)) for n in range(2)] == [True, False]
    imu.on_timeout()
    assert clock.chip.sample(DMP_PACKET, raw(3)) is True


def test_a_dead_bus_is_a_named_step():
    clock = Clock()

    def before(messages):
        raise OSError(errno.EREMOTEIO, "injected")

    clock.bus.before = before
    with pytest.raises(ImuError, match="step 'reset'"):
        made(clock).start()
