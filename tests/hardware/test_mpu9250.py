"""The IMU driver against the register-level chip: bring-up with a fault at every transfer, and every state of the FIFO."""

import errno
import hashlib
from types import SimpleNamespace

import pytest
from chip import Clock

from mip_rt.errors import DmpImageError, ImuError
from mip_rt.fake.mpu9250 import stand_in_image, stand_in_sha256
from mip_rt.hardware import mpu9250_registers as r
from mip_rt.hardware.imu_status import (
    IMU_BACKLOG,
    IMU_BAD_NORM,
    IMU_BUS_ERROR,
    IMU_BUS_TIMEOUT,
    IMU_FROZEN,
    IMU_MISALIGNED,
    IMU_NO_DATA,
    IMU_OK,
    IMU_OVERFLOW,
)
from mip_rt.hardware.mpu9250 import Mpu9250

pytestmark = pytest.mark.armhf


def settings(tmp_path, **changes):
    image = tmp_path / "image"
    image.write_bytes(stand_in_image())
    values = dict(
        bus=2, address=0x68, accel_range_g=8, gyro_range_dps=2000, dlpf_hz=184, dmp_image=str(image),
        dmp_image_sha256=stand_in_sha256(), dmp_orientation="y_up", interrupt_latched=False,
    )  # fmt: skip
    return SimpleNamespace(**{**values, **changes})


def packet(number=0, w=0x40000000):
    return w.to_bytes(4, "big", signed=True) + bytes(12) + number.to_bytes(12, "big") + bytes(4)


@pytest.fixture
def started(tmp_path):
    clock = Clock()
    imu = Mpu9250(clock, settings(tmp_path))
    imu.start()
    return clock, imu


def push(clock, *packets):
    return [clock.chip.sample(p, bytes(14)) for p in packets]


def test_bring_up_writes_image_rate_ranges_and_starts_the_dmp(started):
    clock, imu = started
    chip = clock.chip
    patched = {a for a in range(3062) if chip.memory[a] != stand_in_image()[a]}
    assert 0 < len(patched) < 120  # the features, and nothing else, differ from the image
    assert chip.registers[r.SMPLRT_DIV] == 4 and chip.registers[r.GYRO_CONFIG] == 0x18 and chip.registers[r.ACCEL_CONFIG] == 0x10
    assert chip.dmp_runs and imu.chip == "MPU-9250" and clock.slept < 1.0
    assert push(clock, packet(1)) == [True] and len(chip.fifo) == 32


def test_at_100_hz_every_second_sample_brings_packet_and_interrupt(tmp_path):
    """Without the divider the loop would run twice as fast as its controller was designed for."""
    clock = Clock()
    Mpu9250(clock, settings(tmp_path), 100.0).start()
    assert clock.chip.memory[534:536] == b"\x00\x01"
    edges = push(clock, *(packet(k) for k in range(6)))
    assert sorted(edges) == [False] * 3 + [True] * 3 and len(clock.chip.fifo) == 3 * 32
    clock.chip.memory[2224] = 0x00  # tap detection off: an interrupt with every sample, packets still at 100 Hz
    assert push(clock, packet(6), packet(7)) == [True, True] and len(clock.chip.fifo) == 4 * 32


def test_automatic_gyro_calibration_is_switched_off(started):
    assert started[0].chip.memory[1208:1212] == b"\xb8\xaa\xaa\xaa"


def test_every_transfer_of_the_bring_up_may_fail_once(tmp_path):
    clean = Clock()
    Mpu9250(clean, settings(tmp_path)).start()
    total = clean.chip.transfers
    assert total > 600
    for failing in [*range(0, 40), *range(40, total, 37)]:
        clock, count = Clock(), [0]

        def before(messages, failing=failing, count=count):
            count[0] += 1
            if count[0] == failing + 1:
                raise OSError(errno.EREMOTEIO, "injected")

        clock.bus.before = before
        Mpu9250(clock, settings(tmp_path)).start()
        assert clock.chip.dmp_runs and push(clock, packet(1)) == [True]


@pytest.mark.parametrize(("number", "cure"), [(121, "power and wiring"), (110, "pull-ups"), (16, "unbind"), (5, "cable")])
def test_a_dead_bus_is_a_named_step_with_a_cure(tmp_path, number, cure):
    clock = Clock()

    def before(messages):
        raise OSError(number, "injected")

    clock.bus.before = before
    with pytest.raises(ImuError, match="step 'reset'") as caught:
        Mpu9250(clock, settings(tmp_path)).start()
    assert cure in caught.value.cure and clock.slept < 5.0


@pytest.mark.parametrize(("identity", "usable"), [(0x71, True), (0x73, True), (0x70, True), (0x68, False), (0x75, False), (0x12, False)])
def test_identity(tmp_path, identity, usable):
    clock = Clock(identity=identity)
    imu = Mpu9250(clock, settings(tmp_path))
    if usable:
        imu.start()
        assert imu.chip
    else:
        with pytest.raises(ImuError, match=f"0x{identity:02x}"):
            imu.start()


def test_memory_that_does_not_keep_what_is_written_is_found(tmp_path):
    clock = Clock()
    whole = clock.chip._store

    def broken(register, value):
        whole(register, value)
        clock.chip.memory[700] = 0x5A

    clock.chip._store = broken
    with pytest.raises(ImuError, match="read back") as caught:
        Mpu9250(clock, settings(tmp_path)).start()
    assert caught.value.code == "imu_dmp_verify"


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"dmp_image": "/nowhere/dmp"}, "dmp_image_missing"),
        ({"dmp_image_sha256": "0" * 64}, "dmp_image_hash"),
    ],
)
def test_wrong_image_is_refused(tmp_path, change, code):
    with pytest.raises(DmpImageError) as caught:
        Mpu9250(Clock(), settings(tmp_path, **change)).start()
    assert caught.value.code == code and "librobotcontrol" in caught.value.cure


def test_image_of_wrong_length_is_refused(tmp_path):
    (tmp_path / "short").write_bytes(stand_in_image()[:-1])
    with pytest.raises(DmpImageError, match="3061"):
        Mpu9250(Clock(), settings(tmp_path, dmp_image=str(tmp_path / "short"))).start()


def test_reads_the_packet(started):
    clock, imu = started
    push(clock, packet(77))
    assert imu.read() == IMU_OK and imu.packet.tobytes() == packet(77)


def test_of_a_backlog_the_newest_is_used(started):
    clock, imu = started
    push(clock, *(packet(n) for n in range(1, 6)))
    assert imu.read() == IMU_OK | IMU_BACKLOG and imu.backlog == 4
    assert imu.packet.tobytes() == packet(5) and not clock.chip.fifo


def test_empty_fifo(started):
    clock, imu = started
    assert imu.read() == IMU_NO_DATA


def test_a_half_written_packet_is_waited_for(started):
    clock, imu = started
    push(clock, packet(1))
    whole, clock.chip.fifo = bytes(clock.chip.fifo), clock.chip.fifo[:20]

    def finish(seconds):
        clock.chip.fifo[:] = whole

    clock.sleep = finish
    assert imu.read() == IMU_OK and imu.packet.tobytes() == packet(1)


def test_misalignment_is_reported_and_recover_mends_it(started):
    clock, imu = started
    push(clock, packet(1))
    del clock.chip.fifo[:3]
    assert imu.read() == IMU_MISALIGNED and imu.counters["misaligned"] == 1
    imu.recover()
    push(clock, packet(2))
    assert imu.read() == IMU_OK


def test_overflow_keeps_alignment_and_is_reported(started):
    clock, imu = started
    push(clock, *(packet(n) for n in range(1, 50)))
    status = imu.read()
    assert status & IMU_OVERFLOW and status & IMU_OK and imu.packet.tobytes() == packet(49)
    assert clock.chip.overflows == 17


@pytest.mark.parametrize("w", [0, 0x20000000, 0x42000000, -0x80000000])
def test_a_quaternion_of_wrong_norm_is_refused(started, w):
    clock, imu = started
    push(clock, packet(1, w))
    assert imu.read() == IMU_BAD_NORM and imu.counters["bad_norm"] == 1


def test_ten_equal_packets_are_frozen_data(started):
    clock, imu = started
    results = []
    for _ in range(12):
        push(clock, packet(5))
        results.append(imu.read())
    assert results == [IMU_OK] * 9 + [IMU_FROZEN] * 3
    push(clock, packet(6))
    assert imu.read() == IMU_OK


def test_one_bus_error_is_retried_and_two_are_reported(started):
    clock, imu = started
    push(clock, packet(1))
    failures = [1]

    def before(messages):
        if failures[0]:
            failures[0] -= 1
            raise OSError(errno.EIO, "injected")

    clock.bus.before = before
    assert imu.read() == IMU_OK
    failures[0] = 2
    assert imu.read() == IMU_BUS_ERROR and imu.counters["bus_errors"] == 1


def test_a_timed_out_bus_is_not_tried_again(started):
    clock, imu = started
    calls = []

    def before(messages):
        calls.append(1)
        raise OSError(errno.ETIMEDOUT, "injected")

    clock.bus.before = before
    assert imu.read() == IMU_BUS_ERROR | IMU_BUS_TIMEOUT and len(calls) == 1


def test_latched_line_gives_edges_again_after_a_timeout(tmp_path):
    clock = Clock()
    imu = Mpu9250(clock, settings(tmp_path, interrupt_latched=True))
    imu.start()
    assert push(clock, packet(1), packet(2)) == [True, False]  # nobody read: the line stays low
    imu.on_timeout()
    assert push(clock, packet(3)) == [True]


def test_fake_repeats_the_last_byte_of_an_empty_fifo(started):
    clock, _ = started
    push(clock, packet(1)[:31] + b"\x99")
    clock.chip.pointer = r.FIFO_R_W
    assert clock.chip.read(34) == packet(1)[:31] + b"\x99\x99\x99"


def test_fake_sends_shorter_packets_without_the_features(started):
    clock, _ = started
    clock.chip.write(bytes((r.BANK_SEL, r.CFG_27 >> 8, r.CFG_27 & 0xFF)))
    clock.chip.write(bytes((r.MEM_R_W, 0xD8)))
    push(clock, packet(1))
    assert len(clock.chip.fifo) == 28


def test_stand_in_is_not_the_real_image():
    assert hashlib.sha256(stand_in_image()).hexdigest() != "0058cbb783c93063c86edada212261037ecc2d216ca28aba05cb6b6b2136dcc3"
