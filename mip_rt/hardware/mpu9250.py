"""The MPU-9250 with its DMP: bring-up by named steps, recovery, stop. Its packets are read by `packet_reader`."""

from mip_rt.errors import ImuError
from mip_rt.hardware import dmp
from mip_rt.hardware import mpu9250_registers as r
from mip_rt.hardware.bus_errors import explain
from mip_rt.hardware.packet_reader import PacketReader

RETRIES = 3  # of each bring-up step
INTERNAL_HZ = 1000.0  # that SMPLRT_DIV divides while a low-pass is on


class Mpu9250(PacketReader):
    """One IMU.

    Args:
        kernel: hardware.kernel.Kernel.
        settings: the configuration's imu section.
        rate_hz: packets a second, a divisor of 200.

    Attributes:
        chip: name of the chip that answered, after `start`.
    """

    def __init__(self, kernel, settings, rate_hz: float = dmp.SAMPLE_HZ):
        self._rate_hz = rate_hz
        self._sample_divider = round(INTERNAL_HZ / dmp.SAMPLE_HZ) - 1
        super().__init__(kernel, settings)
        self.chip = ""

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

