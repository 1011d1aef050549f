"""The fake chip while nothing is unusual, compiled: a sample becomes one packet and one edge, and the driver's two transfers take the packet.

`fake.mpu9250` decides when that is so and owns everything else; here is only what would be the same 200 times a second. Whatever is unusual goes to it.
"""

import numpy as np

from mip_rt.compiled import call, entry, njit, records_at
from mip_rt.fake import edges
from mip_rt.hardware import mpu9250_registers as r

COUNT, PACKET, OTHER = range(3)  # what a prepared transfer reads

CHIP = np.dtype(
    [
        ("usual", "i8"),  # 1: a sample gives one packet and an edge, and the FIFO holds nothing but what is `waiting`
        ("waiting", "i8"),  # 1: `packet` lies in the FIFO
        ("pointer", "i8"),  # register that the last transfer left
        ("transfers", "i8"),
        ("registers_at", "u8"),
        ("packet", "u1", (r.PACKET_BYTES,)),
    ],
    align=True,
)
BUS = np.dtype([("chip_at", "u8"), ("callback", "u8")])  # callback: the transfer in Python, see hardware.transfers
PREPARED = np.dtype([("reads", "i8"), ("reply_at", "u8")])


@njit
def sample(chip_at, packet_at, raw_at):
    """One sample of a usual chip: True, and its interrupt pin has fallen; False where nothing was done.

    Args:
        chip_at: address of a CHIP.
        packet_at: of PACKET_BYTES.
        raw_at: of RAW_BYTES for the registers.
    """
    chip = records_at(chip_at, 1, CHIP)[0]
    if chip.usual == 0 or chip.waiting == 1:
        return False
    packet = records_at(packet_at, r.PACKET_BYTES, np.uint8)
    for i in range(r.PACKET_BYTES):
        chip.packet[i] = packet[i]
    registers = records_at(chip.registers_at, 128, np.uint8)
    raw = records_at(raw_at, r.RAW_BYTES, np.uint8)
    for i in range(r.RAW_BYTES):
        registers[r.ACCEL_XOUT_H + i] = raw[i]
    registers[r.INT_STATUS] |= r.INT_DMP
    chip.waiting = 1
    return True


@entry("uintp", "uintp", "uintp")
def transfer(bus_at, request, prepared_at):
    """0 or minus the errno, as hardware.transfers wants it: the packet's count and the packet of a usual chip, all else by the callback.

    Args:
        bus_at: address of a BUS.
        prepared_at: of a PREPARED.
    """
    bus = records_at(bus_at, 1, BUS)[0]
    chip = records_at(bus.chip_at, 1, CHIP)[0]
    prepared = records_at(prepared_at, 1, PREPARED)[0]
    if chip.usual == 0 or prepared.reads == OTHER or chip.waiting == 0:
        return np.int64(call(bus.callback, 0, request, prepared_at))
    chip.transfers += 1
    reply = records_at(prepared.reply_at, r.PACKET_BYTES, np.uint8)
    if prepared.reads == COUNT:
        reply[0] = r.PACKET_BYTES >> 8
        reply[1] = r.PACKET_BYTES & 0xFF
        chip.pointer = r.FIFO_COUNT_H
        return np.int64(0)
    for i in range(r.PACKET_BYTES):
        reply[i] = chip.packet[i]
    chip.waiting = 0
    chip.pointer = r.FIFO_R_W
    return np.int64(0)
