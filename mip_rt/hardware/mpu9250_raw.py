"""The MPU-9250 without its DMP: in each tick one transfer of 15 bytes brings the newest sample of accelerometer, temperature and gyro.

At 400 kHz it takes 0.41 ms of the wire, less than half of the DMP's two; no image is needed, and there is no FIFO that could overflow or lose
its place. What is put into the frame has the words of the DMP's packet in the places of the DMP's packet (`frame`: imu_packet).

Source: InvenSense register map RM-MPU-9250A-00 rev. 1.4: 0x38 bit 0, 0x3A to 0x48 (a burst reads one sample), 0x19.
"""

import math
import struct

import numpy as np

from mip_rt.hardware import mpu9250_registers as r
from mip_rt.hardware.imu_status import IMU_BAD_NORM, IMU_FROZEN, IMU_NO_DATA, IMU_OK
from mip_rt.hardware.mpu9250 import INTERNAL_HZ, Mpu9250
from mip_rt.hardware.packet_check import FROZEN_AFTER
from mip_rt.hardware.packet_reader import bytes_of

ZEROS, ONES = bytes(r.RAW_BYTES), b"\xff" * r.RAW_BYTES
LARGEST_STEP_RAD_S = 15.0  # of a rate from sample to sample: more is no motion
_GYRO = struct.Struct(">8x3h")
ACCELEROMETER, GYRO, TEMPERATURE, STATUS = 16, 22, 28, 30  # places in the packet


class RawMpu9250(Mpu9250):
    """One IMU whose data-ready interrupt turns the loop; arguments, attributes and errors as `Mpu9250`, any rate of 1000 Hz / n."""

    def _prepare(self) -> None:
        self._sample_divider = round(INTERNAL_HZ / self._rate_hz) - 1
        address = self._settings.address
        request, reply = self._message.write(address, [r.INT_STATUS]), self._message.read(address, 1 + r.RAW_BYTES)
        self._read_sample = self._bus.prepare(request, reply)
        self._status, self._sample = bytes_of(reply, 0, 1), bytes_of(reply, 1, r.RAW_BYTES)
        self.packet = np.zeros(r.PACKET_BYTES, np.uint8)
        packet = memoryview(self.packet)
        self._parts = [(packet[place : place + size], bytes_of(reply, at, size)) for place, at, size in (
            (ACCELEROMETER, 1, 6), (GYRO, 9, 6), (TEMPERATURE, 7, 2), (STATUS, 0, 1),
        )]  # fmt: skip
        self._largest_step = LARGEST_STEP_RAD_S / math.radians(self._settings.gyro_range_dps) * 32768.0
        self._rates = 0, 0, 0
        self._kept = request, reply  # the prepared transfer points into their buffers
        self._last, self._equal = bytearray(r.RAW_BYTES), 0

    def start(self) -> None:
        """Resets, identifies and configures the chip, starts the data-ready interrupt.

        Raises:
            ImuError: with the step that failed; every wait is bounded.
        """
        self._bring_up()
        self._step("start the interrupt", self._start_interrupt)

    def _start_interrupt(self) -> None:
        self._write(r.FIFO_EN, 0)
        self._write(r.INT_ENABLE, r.INT_RAW_READY)
        self._equal = 0

    def recover(self) -> None:
        """Configures the chip anew, for it may have lost its power; takes 100 ms, so only while the motors are off."""
        self.counters["resets"] += 1
        self._write(r.INT_ENABLE, 0)
        self._configure()
        self._start_interrupt()

    def unusual(self, found: int) -> int:
        """Brings the newest sample into `packet`, bytes 16 to 30; returns the IMU_* bits. Never raises for the bus. There is no usual read."""
        refused = self._transfer(self._read_sample)
        if refused:
            return refused
        if not self._status[0] & r.INT_RAW_READY:
            return IMU_NO_DATA  # a second interrupt for one sample, or one that does not come from the chip
        sample = self._sample
        x, y, z = self._rates
        self._rates = rates = _GYRO.unpack_from(sample)
        step = max(abs(rates[0] - x), abs(rates[1] - y), abs(rates[2] - z))
        if step > self._largest_step or sample == ONES or sample == ZEROS:
            self.counters["bad_norm"] += 1
            return IMU_BAD_NORM
        if sample == self._last:
            self._equal += 1
            if self._equal >= FROZEN_AFTER - 1:
                self.counters["frozen"] += 1
                return IMU_FROZEN
        else:
            self._equal = 0
            self._last[:] = sample
        for place, part in self._parts:
            place[:] = part
        return IMU_OK
