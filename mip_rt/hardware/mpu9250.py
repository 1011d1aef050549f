"""The MPU-9250 with its DMP: bring-up by named steps, and the reading of the newest packet in each tick.

The hot path is two combined transfers with messages that were built once, no lists, no exceptions out of it: `imu_read.usual`, compiled, and
`unusual` for what that does not know. What went wrong comes back as bits (imu_status) and in `counters`.
"""

import ctypes
import errno
from functools import partial

import numpy as np

from mip_rt.compiled import direct
from mip_rt.errors import ImuError
from mip_rt.hardware import dmp, imu_read, packet_check
from mip_rt.hardware import mpu9250_registers as r
from mip_rt.hardware.bus_errors import explain
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
from mip_rt.hardware.transfers import Entry

RETRIES = 3  # of each bring-up step
HALF_WRITTEN_WAIT_S = 200e-6
INTERNAL_HZ = 1000.0  # that SMPLRT_DIV divides while a low-pass is on

_JUDGED = {packet_check.GOOD: IMU_OK, packet_check.BAD_NORM: IMU_BAD_NORM, packet_check.FROZEN: IMU_FROZEN}
_COUNTED = {IMU_BAD_NORM: "bad_norm", IMU_FROZEN: "frozen"}


class Mpu9250:
    """One IMU.

    Args:
        kernel: hardware.kernel.Kernel.
        settings: the configuration's imu section.
        rate_hz: packets a second, a divisor of 200.

    Attributes:
        chip: name of the chip that answered, after `start`.
        packet: (32,) bytes, the newest packet where the last read returned IMU_OK.
        backlog: packets that waited beside the newest, at the last read.
        counters: how often each kind of trouble occurred.
        usual: (1,) imu_read.READ, what the compiled read needs.
    """

    def __init__(self, kernel, settings, rate_hz: float = dmp.SAMPLE_HZ):
        from smbus2 import i2c_msg

        self._kernel, self._settings, self._message = kernel, settings, i2c_msg
        self._rate_hz = rate_hz
        self._bus = kernel.open_i2c(settings.bus)
        self._entry, self.usual = Entry(self._bus), np.zeros(1, imu_read.READ)
        self._read_usual = partial(direct(imu_read.read_usual), self.usual.ctypes.data)
        self._sample_divider = round(INTERNAL_HZ / dmp.SAMPLE_HZ) - 1
        self._prepare()
        self.chip = ""
        self.backlog = 0
        self.counters = dict.fromkeys(("bus_errors", "misaligned", "overflows", "bad_norm", "frozen", "backlog", "resets"), 0)

    def _prepare(self) -> None:
        """Puts the transfers of `read` together, once."""
        i2c_msg, address = self._message, self._settings.address
        count_reply = i2c_msg.read(address, 2)
        self._read_count = self._bus.prepare(i2c_msg.write(address, [r.FIFO_COUNT_H]), count_reply)
        self._count_bytes, self._count_address = _bytes_of(count_reply, 0, 2), _address_of(count_reply, 0)
        # One transfer for each number of waiting packets; only the last packet of it is used.
        request = i2c_msg.write(address, [r.FIFO_R_W])
        replies = [i2c_msg.read(address, r.PACKET_BYTES * n) for n in range(1, r.FIFO_BYTES // r.PACKET_BYTES + 1)]
        self._read_fifo = [self._bus.prepare(request, reply) for reply in replies]
        self._packets = [_bytes_of(m, r.PACKET_BYTES * n, r.PACKET_BYTES) for n, m in enumerate(replies)]
        self._kept = request, count_reply, replies  # the prepared transfers point into their buffers
        self.packet = np.frombuffer(self._packets[0], np.uint8)
        self._state = np.zeros(1, packet_check.STATE)
        check, state_at = direct(packet_check.check), self._state.ctypes.data
        self._checks = [partial(check, state_at, _address_of(m, r.PACKET_BYTES * n)) for n, m in enumerate(replies)]
        self._use(self._entry)

    # -- bring-up ----------------------------------------------------------------------------------------------------
    def start(self) -> None:
        """Resets, identifies and configures the chip, loads and verifies the DMP image, starts the packets.

        Raises:
            DmpImageError: the image is missing or wrong.
            ImuError: with the step that failed; every wait is bounded.
        """
        s = self._settings
        image = dmp.load_image(s.dmp_image, s.dmp_image_sha256)
        self._bring_up()
        self._step("load the DMP image", lambda: self._write_memory(0, image))
        self._step("start address", lambda: self._write(r.PRGM_START_H, r.DMP_START >> 8, r.DMP_START & 0xFF))
        for address, data in dmp.feature_writes(s.dmp_orientation, s.accel_range_g, self._rate_hz):
            self._step(f"DMP feature at {address}", lambda a=address, d=data: self._write_memory(a, d))
        self._step("start the FIFO", self.recover)
        self._step("verify the settings", lambda: self._verify(image))

    def _verify(self, image: bytes) -> None:
        """The chip has kept what it was given: it has not lost its power in between."""
        s = self._settings
        expected = [
            (r.GYRO_CONFIG, bytes((r.GYRO_RANGE_CODES[s.gyro_range_dps] << 3, r.ACCEL_RANGE_CODES[s.accel_range_g] << 3))),
            (r.USER_CTRL, bytes((r.USER_DMP_EN | r.USER_FIFO_EN, 0x01, 0x00))),
            (r.PRGM_START_H, bytes((r.DMP_START >> 8, r.DMP_START & 0xFF))),
        ]
        wrong = [register for register, values in expected if self._read(register, len(values)) != values]
        self._write(r.BANK_SEL, 0, 0)
        if not wrong and self._read(r.MEM_R_W, dmp.CHUNK) == image[: dmp.CHUNK]:
            return
        place = f"register 0x{wrong[0]:02x}" if wrong else "the DMP's memory"
        raise ImuError(f"{place} has lost what was written.", "The IMU's supply fails for moments: check its plug and its 3.3 V.", "imu_settings")

    def _bring_up(self) -> None:
        self._step("reset", self._reset)
        self._step("identify", self._identify)
        self._step("configure", self._configure)

    def _step(self, name: str, action) -> None:
        for attempt in range(RETRIES):
            try:
                return action()
            except OSError as error:
                if attempt == RETRIES - 1:
                    words, cure = explain(error)
                    raise ImuError(f"the IMU's step '{name}' failed: {words}.", cure, "imu_bus") from error
                self._kernel.sleep(0.01)
            except ImuError as error:
                raise ImuError(f"the IMU's step '{name}' failed: {error.sentence}", error.cure, error.code) from error

    def _reset(self) -> None:
        self._write(r.PWR_MGMT_1, r.H_RESET)
        self._kernel.sleep(0.1)
        self._write(r.PWR_MGMT_1, 0x00)
        self._kernel.sleep(0.01)

    def _identify(self) -> None:
        identity = self._read(r.WHO_AM_I, 1)[0]
        name, usable = r.CHIPS.get(identity, ("an unknown chip", False))
        if not usable:
            raise ImuError(
                f"WHO_AM_I is 0x{identity:02x} ({name}); the DMP needs an MPU-9250, MPU-9255 or MPU-6500.",
                "Use another IMU, or check the address.",
                "imu_identity",
            )
        self.chip = name

    def _configure(self) -> None:
        s = self._settings
        code = r.DLPF_CODES[s.dlpf_hz]
        self._write(r.PWR_MGMT_1, 0x01)
        self._kernel.sleep(0.05)
        self._write(r.PWR_MGMT_2, 0x00)
        self._kernel.sleep(0.05)
        self._write(r.ACCEL_CONFIG2, 0x48)  # FIFO of 1024 bytes, before the DMP's memory is touched
        self._write(r.GYRO_CONFIG, r.GYRO_RANGE_CODES[s.gyro_range_dps] << 3)
        self._write(r.ACCEL_CONFIG, r.ACCEL_RANGE_CODES[s.accel_range_g] << 3)
        self._write(r.CONFIG, code)
        self._write(r.ACCEL_CONFIG2, 0x40 | code)
        self._write(r.SMPLRT_DIV, self._sample_divider)
        self._write(r.USER_CTRL, 0x00)
        self._kernel.sleep(0.003)
        latch = r.PIN_LATCHED | r.PIN_ANY_READ_CLEARS if s.interrupt_latched else 0
        self._write(r.INT_PIN_CFG, r.PIN_ACTIVE_LOW | latch | r.PIN_BYPASS)

    def recover(self) -> None:
        """Resets FIFO and DMP and starts the packets anew; takes 50 ms, so only while the motors are off."""
        self.counters["resets"] += 1
        self._write(r.INT_ENABLE, 0)
        self._write(r.FIFO_EN, 0)
        self._write(r.USER_CTRL, 0)
        self._write(r.USER_CTRL, r.USER_DMP_RST | r.USER_FIFO_RST)
        self._kernel.sleep(0.05)
        self._write(r.USER_CTRL, r.USER_DMP_EN | r.USER_FIFO_EN)
        self._write(r.INT_ENABLE, r.INT_DMP)
        self._write(r.FIFO_EN, 0)
        self._state["equal"] = 0

    def _write(self, register: int, *values: int) -> None:
        self._bus.i2c_rdwr(self._message.write(self._settings.address, [register, *values]))

    def _read(self, register: int, length: int) -> bytes:
        reply = self._message.read(self._settings.address, length)
        self._bus.i2c_rdwr(self._message.write(self._settings.address, [register]), reply)
        return bytes(reply)

    def _write_memory(self, address: int, data: bytes) -> None:
        for place, part in dmp.chunks(address, data):
            for _ in range(RETRIES):
                self._write(r.BANK_SEL, place >> 8, place & 0xFF)
                self._write(r.MEM_R_W, *part)
                self._write(r.BANK_SEL, place >> 8, place & 0xFF)
                if self._read(r.MEM_R_W, len(part)) == part:
                    break
            else:
                raise ImuError(
                    f"the DMP's memory at {place} does not read back what was written.",
                    "Power-cycle the IMU; if it stays, the chip has no MotionDriver DMP.",
                    "imu_dmp_verify",
                )

    # -- hot path ----------------------------------------------------------------------------------------------------
    def _use(self, entry: Entry) -> None:
        handles = entry.handle(self._read_count), entry.handle(self._read_fifo[0])
        addresses = self._count_address, self.packet.ctypes.data, self._state.ctypes.data
        self.usual[0] = entry.function, entry.bus, *handles, *addresses

    def read(self) -> int:
        """Brings the newest packet into `packet`; returns the IMU_* bits. Never raises for the bus."""
        self.backlog = 0
        found = self._read_usual()
        return found if found == IMU_OK else self.unusual(found)

    def unusual(self, found: int) -> int:
        """What to make of an answer of `imu_read.usual` other than IMU_OK: the IMU_* bits, with the newest packet in `packet` where they say so."""
        self.backlog = 0
        if found < 0:
            self._entry.check()
            return self._read_again(-found)
        if found == imu_read.OTHER_COUNT:
            return self._read_newest()
        self.counters[_COUNTED[found]] += 1
        return found

    def _read_again(self, refused: int) -> int:
        """One immediate retry, none after a time-out: the kernel has already waited a second."""
        if refused == errno.ETIMEDOUT:
            return self._refused(refused)
        refused = self._bus.transfer(self._read_count)
        return self._refused(refused) if refused else self._read_newest()

    def _transfer(self, prepared) -> int:
        """0, or the bits of what went wrong, with the retry."""
        refused = self._bus.transfer(prepared)
        if not refused or refused != errno.ETIMEDOUT and not (refused := self._bus.transfer(prepared)):
            return 0
        return self._refused(refused)

    def _refused(self, number: int) -> int:
        self.counters["bus_errors"] += 1
        return IMU_BUS_ERROR | IMU_BUS_TIMEOUT if number == errno.ETIMEDOUT else IMU_BUS_ERROR

    def _read_newest(self) -> int:
        """The newest packet of those that the count just read has told."""
        status, newest = self._waiting()
        if newest < 0:
            return status
        refused = self._transfer(self._read_fifo[newest])
        if refused:
            return status | refused
        found = _JUDGED[self._checks[newest]()]
        if found != IMU_OK:
            self.counters[_COUNTED[found]] += 1
        elif newest:
            self._packets[0][:] = self._packets[newest]
        return status | found

    def _count(self) -> int:
        return (self._count_bytes[0] & 0x1F) << 8 | self._count_bytes[1]

    def _waiting(self) -> tuple[int, int]:
        """(IMU_* bits, number of the newest packet that waits); the number is -1 where none can be read."""
        if self._count() == 0:
            return IMU_NO_DATA, -1
        if self._count() % r.PACKET_BYTES:
            self._kernel.sleep(HALF_WRITTEN_WAIT_S)
            refused = self._transfer(self._read_count)
            if refused:
                return refused, -1
            if self._count() % r.PACKET_BYTES:
                self.counters["misaligned"] += 1
                return IMU_MISALIGNED, -1
        status, waiting = 0, self._count() // r.PACKET_BYTES
        if waiting >= len(self._packets):
            waiting = len(self._packets)
            self.counters["overflows"] += 1
            status = IMU_OVERFLOW
        if waiting > 1:
            self.backlog = waiting - 1
            self.counters["backlog"] += waiting - 1
            status |= IMU_BACKLOG
        return status, waiting - 1

    def on_timeout(self) -> None:
        """After a missing interrupt: reads the status, which releases a latched line, and the count."""
        try:
            self._read(r.INT_STATUS, 1)
        except OSError:
            self.counters["bus_errors"] += 1

    def stop(self) -> None:
        """Interrupts off; errors do not matter any more."""
        try:
            self._write(r.INT_ENABLE, 0)
        except OSError:
            self.counters["bus_errors"] += 1
        self._bus.close()


def _address_of(message, offset: int) -> int:
    return ctypes.addressof(message.buf.contents) + offset


def _bytes_of(message, offset: int, length: int):
    """A view of a message's buffer that follows each transfer."""
    return memoryview((ctypes.c_ubyte * length).from_address(_address_of(message, offset))).cast("B")
