"""A register-level MPU-9250.

Registers with their reset state, banked DMP memory with read-back, the FIFO with its real overflow (oldest bytes are dropped, an
empty FIFO repeats its last byte), the interrupt pin pulsed or latched. The DMP runs only when an image has been written and started;
the packet holds what the feature bytes in its memory ask for. The proprietary image is not needed: any image is accepted,
`stand_in_image` makes one.

On virtual time the samples of a chip that runs as the drivers set it up are compiled (`fake.usual_chip`). They keep their state in a record that both
sides know; before anything here looks at the chip, what lies in that record is taken back, and the next sample decides anew.
"""

import ctypes
import hashlib
import random

import numpy as np

from mip_rt.fake import usual_chip
from mip_rt.hardware import mpu9250_registers as r

RESET_S = 0.09  # H_RESET: the chip does not answer for so long
USUAL_CUT = (slice(0, r.PACKET_BYTES),)


def stand_in_image() -> bytes:
    """3062 bytes that are not InvenSense's; the same at every call."""
    return random.Random("mip-rt stand-in for the DMP image").randbytes(r.DMP_IMAGE_BYTES)


def stand_in_sha256() -> str:
    """SHA-256 of the stand-in."""
    return hashlib.sha256(stand_in_image()).hexdigest()


class FakeMpu9250:
    """The chip.

    Args:
        monotonic_ns: clock that times the reset.
        identity: WHO_AM_I.

    Attributes:
        shared: (1,) usual_chip.CHIP.
        may_be_usual: its samples may be compiled.
    """

    def __init__(self, monotonic_ns, identity: int = 0x71):
        self._now_ns, self._identity = monotonic_ns, identity
        self._ready_ns = 0
        self._registers = bytearray(128)
        self._held = (ctypes.c_ubyte * 128).from_buffer(self._registers)
        self.shared, self.may_be_usual = np.zeros(1, usual_chip.CHIP), False
        self.shared["registers_at"] = ctypes.addressof(self._held)
        self._usual, self._waiting = (self.shared[name] for name in ("usual", "waiting"))
        self._power_on()

    def _power_on(self) -> None:
        self._registers[:] = bytes(128)
        self._registers[r.PWR_MGMT_1] = 0x01
        self._registers[r.WHO_AM_I] = self._identity
        self._memory = bytearray(4096)
        self._fifo = bytearray()
        self.last_byte = 0
        self.pointer = 0
        self.pin_low = False
        self.overflows = self._transfers = 0
        self._divider_phase = 0
        self._cut = None

    def settle(self) -> None:
        """Takes back what the compiled samples have left; the next sample comes here."""
        if not self._usual[0]:
            return
        shared = self.shared[0]
        packet = shared["packet"].tobytes()
        if self._waiting[0]:
            self._fifo += packet
        if shared["transfers"]:
            self.pointer = int(shared["pointer"])
            self._transfers += int(shared["transfers"])
            if self.pointer == r.FIFO_R_W:
                self.last_byte = packet[-1]
        shared["transfers"] = self._waiting[0] = self._usual[0] = 0

    @property
    def registers(self) -> bytearray:
        """128 registers."""
        self.settle()
        self._cut = None
        return self._registers

    @property
    def memory(self) -> bytearray:
        """The DMP's memory."""
        self.settle()
        self._cut = None
        return self._memory

    @property
    def fifo(self) -> bytearray:
        """What waits to be read."""
        self.settle()
        return self._fifo

    @fifo.setter
    def fifo(self, content: bytearray) -> None:
        """Other content."""
        self.settle()
        self._fifo = content

    @property
    def transfers(self) -> int:
        """Transfers since the power came on."""
        self.settle()
        return self._transfers

    # -- the bus side ------------------------------------------------------------------------------------------------
    def answers(self) -> bool:
        """False during a reset."""
        return self._now_ns() >= self._ready_ns

    def count_transfer(self) -> None:
        """Told by the bus."""
        self._transfers += 1

    def write(self, data: bytes) -> None:
        """A write transaction: register address, then values."""
        self.settle()
        self.pointer = data[0] & 0x7F
        for value in data[1:]:
            self._store(self.pointer, value)
            if self.pointer not in (r.MEM_R_W, r.FIFO_R_W):
                self.pointer = (self.pointer + 1) & 0x7F

    def _store(self, register: int, value: int) -> None:
        if register == r.PWR_MGMT_1 and value & r.H_RESET:
            self._power_on()
            self._ready_ns = self._now_ns() + int(RESET_S * 1e9)
            return
        if register == r.MEM_R_W:
            self._cut = None
            if not self._registers[r.PWR_MGMT_1] & 0x40:  # asleep: the memory keeps what it has
                self._memory[self._memory_address()] = value
            self._advance_memory()
            return
        if register in (r.WHO_AM_I, r.INT_STATUS, r.FIFO_COUNT_H, r.FIFO_COUNT_H + 1) or 0x3B <= register <= 0x48:
            return  # read-only
        if register == r.USER_CTRL:
            if value & r.USER_FIFO_RST:
                self._fifo.clear()
            if value & r.USER_DMP_RST:
                self._divider_phase = 0
            value &= ~(r.USER_FIFO_RST | r.USER_DMP_RST)
        self._registers[register] = value
        self._cut = None

    def _memory_address(self) -> int:
        return ((self._registers[r.BANK_SEL] << 8) | self._registers[r.MEM_START_ADDR]) & 0xFFF

    def _advance_memory(self) -> None:
        self._registers[r.MEM_START_ADDR] = (self._registers[r.MEM_START_ADDR] + 1) & 0xFF

    def read(self, length: int) -> bytes:
        """A read transaction from the present register address."""
        self.settle()
        register = self.pointer
        if self._registers[r.INT_PIN_CFG] & r.PIN_ANY_READ_CLEARS:
            self.pin_low = False
        if register == r.FIFO_R_W:
            return self._read_fifo(length)
        if register == r.FIFO_COUNT_H:
            count = len(self._fifo).to_bytes(2, "big")
            return count if length == 2 else count[:length].ljust(length, b"\0")
        out = bytearray()
        for _ in range(length):
            if register == r.MEM_R_W:
                out.append(self._memory[self._memory_address()])
                self._advance_memory()
                continue
            if register == r.FIFO_R_W:
                out += self._read_fifo(1)
                continue
            if register in (r.FIFO_COUNT_H, r.FIFO_COUNT_H + 1):
                out.append(len(self._fifo).to_bytes(2, "big")[register - r.FIFO_COUNT_H])
            else:
                out.append(self._registers[register])
            if register == r.INT_STATUS:
                self._registers[r.INT_STATUS] = 0
                self.pin_low = False
            register = (register + 1) & 0x7F
        self.pointer = register
        return bytes(out)

    def _read_fifo(self, length: int) -> bytes:
        fifo = self._fifo
        out = bytes(fifo[:length])
        if out:
            self.last_byte = out[-1]
        del fifo[:length]
        return out if len(out) == length else out + bytes([self.last_byte]) * (length - len(out))

    # -- the sensor side ---------------------------------------------------------------------------------------------
    def _features(self):
        """Slices of the whole packet that the feature bytes ask for, merged; empty where the DMP does not run."""
        if not self.dmp_runs:
            return ()
        memory = self._memory
        parts = []
        if memory[r.CFG_8 : r.CFG_8 + 4] == b"\x20\x28\x30\x38":
            parts.append((0, 16))
        if memory[r.CFG_15 + 1 : r.CFG_15 + 4] == b"\xc0\xc8\xc2":
            parts.append((16, 22))
        if memory[r.CFG_15 + 4 : r.CFG_15 + 7] == b"\xc4\xcc\xc6":
            parts.append((22, 28))
        if memory[r.CFG_27] == 0x20:
            parts.append((28, 32))
        merged = []
        for begin, end in parts:
            if merged and merged[-1].stop == begin:
                begin = merged.pop().start
            merged.append(slice(begin, end))
        return tuple(merged)

    @property
    def dmp_runs(self) -> bool:
        """An image was loaded and started, the DMP is enabled, the chip is awake with its FIFO at 1024 bytes."""
        reg = self._registers
        return (
            bool(reg[r.USER_CTRL] & r.USER_DMP_EN)
            and (reg[r.PRGM_START_H] << 8 | reg[r.PRGM_START_H + 1]) == r.DMP_START
            and not reg[r.PWR_MGMT_1] & 0x40
            and reg[r.ACCEL_CONFIG2] & 0xC0 == 0x40
            and any(self._memory[: r.DMP_IMAGE_BYTES])
        )

    def sample(self, packet, raw) -> bool:
        """One 5 ms sample: registers, DMP packet, FIFO, interrupt; without a DMP at the rate of SMPLRT_DIV.

        Args:
            packet: 32 bytes of quaternion, accelerometer, gyro, gesture.
            raw: 14 bytes for registers 0x3B to 0x48.

        Returns:
            True where the interrupt pin fell.
        """
        self.settle()
        registers = self._registers
        if self._cut is None:  # registers or memory have changed since the last sample
            self._cut = self._features()
        if not self._cut:
            return self._sample_registers(raw)
        registers[r.ACCEL_XOUT_H : r.ACCEL_XOUT_H + r.RAW_BYTES] = raw
        divider = self._memory[r.D_0_22] << 8 | self._memory[r.D_0_22 + 1]
        self._divider_phase += 1
        if self._divider_phase > divider:
            self._divider_phase = 0
            if registers[r.USER_CTRL] & r.USER_FIFO_EN:
                for part in self._cut:
                    self._push(packet[part])
                if self.may_be_usual:
                    self._judge(divider)
        elif self._memory[r.CFG_20] == 0xF8:
            return False  # with tap detection on, interrupts come with the packets; without it, with every sample
        return self._interrupt(r.INT_DMP)

    def _judge(self, divider) -> None:
        """Hands the next samples over where they will be usual: the packet of this one is all that waits."""
        registers = self._registers
        usual = self._cut == USUAL_CUT and divider == 0 and len(self._fifo) == r.PACKET_BYTES
        if usual and registers[r.INT_ENABLE] & r.INT_DMP and not registers[r.INT_PIN_CFG] & (r.PIN_LATCHED | r.PIN_ANY_READ_CLEARS):
            shared = self.shared[0]
            shared["packet"], shared["transfers"] = np.frombuffer(self._fifo, np.uint8), 0
            self._fifo.clear()
            self._waiting[0] = self._usual[0] = 1

    def _sample_registers(self, raw) -> bool:
        """A sample without the DMP, awake and at its rate."""
        registers = self._registers
        if registers[r.PWR_MGMT_1] & 0x40:
            return False
        self._divider_phase += 1
        if self._divider_phase < (registers[r.SMPLRT_DIV] + 1) // 5:
            return False
        self._divider_phase = 0
        registers[r.ACCEL_XOUT_H : r.ACCEL_XOUT_H + r.RAW_BYTES] = raw
        return self._interrupt(r.INT_RAW_READY)

    def _interrupt(self, cause: int) -> bool:
        """Notes the cause; True where the pin fell."""
        registers = self._registers
        registers[r.INT_STATUS] |= cause
        if not registers[r.INT_ENABLE] & cause:
            return False
        if registers[r.INT_PIN_CFG] & r.PIN_LATCHED:
            fell = not self.pin_low
            self.pin_low = True
            return fell
        return True

    def _push(self, data: bytes) -> None:
        fifo = self._fifo
        fifo += data
        excess = len(fifo) - r.FIFO_BYTES
        if excess > 0:
            self.overflows += 1
            self._registers[r.INT_STATUS] |= r.INT_FIFO_OVERFLOW
            if self._registers[r.CONFIG] & 0x40:
                del fifo[-excess:]
            else:
                del fifo[:excess]
