"""What happened at the fake kernel boundary during a dry run, sample by sample: the truth against which promises are judged.

Nothing here asks the controller: duties and the enable line are what the motor drivers see, packets what the chip measured, `delivered`
whether the bus handed a sample's packet over (a few of its bits may be wrong), presses and bytes what the operator did. Only `rows` is the controller's own log.
"""

import ctypes
import math
import struct

import numpy as np

from mip_rt.fake.kernel import SAMPLE_NS
from mip_rt.hardware import mpu9250_registers as r
from mip_rt.hardware.gpio import SET_VALUES_V1, SET_VALUES_V2

COLUMNS = ("tick", "edge_ns", "state", "fault", "limits", "remote_velocity_m_s", "remote_yaw_rate_rad_s", "duty", "applied_ns")
PACKET = 32
FLIPPED = 8  # bits; the fault that flips them takes up to six of a transfer


def nearly(sent, arrived) -> bool:
    """What arrived is what was sent, but for a few bits: there is no checksum, so nobody behind the bus can tell."""
    wrong = int.from_bytes(sent, "big") ^ int.from_bytes(arrived, "big")
    return wrong.bit_count() <= FLIPPED


def norm_is_one(packet: bytes) -> bool:
    """The quaternion's norm is 1 within 1 %, by which a packet is judged."""
    return abs(math.hypot(*struct.unpack_from(">4i", packet)) / (1 << 30) - 1.0) <= 0.01


class Observation:
    """Watches one dry run from before its session is built. Arrays are indexed by the world's sample number, 5 ms each.

    Args:
        bench: fake.bench.Bench.
        wheels: how many motors.
        duration_s: how long it will run, bring-up excluded.

    Attributes:
        enabled: (n,) the enable line, just before the sample.
        duty: (n, wheels) signed duties that the drivers see then, 0 where disabled.
        lean_rad: (n,) true lean.
        onboard: whether the chip runs without its DMP.
        packet: (n, 32) what the chip put into its FIFO, or (without DMP) into its registers, words in the same places.
        delivered: (n,) this packet was read in full.
        presses: sample numbers of the arm button.
        fell_ns: moments at which the enable line was driven low.
        bytes_sent: sample numbers at which the remote sent something.
        samples: how many there were.
        journal, stalls: of the injector.
        start_ns: time of sample 0.
        rows: column of the log by name (COLUMNS), and `sample`, the number of each row's sample.
    """

    def __init__(self, bench, wheels: int, duration_s: float):
        n = round((duration_s + 10.0) * 1e9 / SAMPLE_NS)
        self._bench = bench
        self.enabled = np.zeros(n, bool)
        self.duty = np.zeros((n, wheels))
        self.lean_rad = np.zeros(n)
        self.packet = np.zeros((n, PACKET), np.uint8)
        self.delivered = np.zeros(n, bool)
        self.onboard = False
        self.presses, self.bytes_sent, self.fell_ns = [], [], []
        self.journal, self.stalls = bench.injector.journal, bench.injector.stalls
        self.rows, self._parts, self._truth_until = {}, [], 0
        self._watch()

    def _watch(self) -> None:
        bench, world, kernel = self._bench, self._bench.world, self._bench.kernel
        enabled, duty_seen, delivered = self.enabled, self.duty, self.delivered
        packets = memoryview(self.packet).cast("B")
        taps = bench.injector.taps

        def advance(call, duty, on):
            call(duty, on)
            k = world.samples
            enabled[k] = on
            duty_seen[k] = duty
            if world.truth_row == 0:
                self._take_truth()

        def sample(call, packet, raw):
            at = PACKET * world.samples
            self.onboard = not kernel.chip.dmp_runs
            if self.onboard:
                packets[at + 16 : at + 28] = bytes(raw[:6]) + bytes(raw[8:14])
            else:
                packets[at : at + PACKET] = packet
            return call(packet, raw)

        def transfer(call, *messages):
            call(*messages)
            reply = messages[-1]
            if self.onboard and reply.len == 1 + r.RAW_BYTES and reply.flags & 1:
                data = ctypes.string_at(reply.buf, reply.len)
                at = PACKET * world.samples
                if data[0] & r.INT_RAW_READY and nearly(packets[at + 16 : at + 28], data[1:7] + data[9:15]):
                    delivered[world.samples] = True
            elif reply.len >= PACKET and reply.flags & 1:
                data = ctypes.string_at(ctypes.addressof(reply.buf.contents) + reply.len - PACKET, PACKET)
                for k in (world.samples, world.samples - 1):
                    if nearly(packets[PACKET * k : PACKET * (k + 1)], data) and norm_is_one(data):
                        delivered[k] = True
                        break

        # What a fault sends when it is taken back after the run has no place any more in the arrays that these lists become.
        presses, sent = self.presses, self.bytes_sent

        def press(call, now_ns):
            presses.append(world.samples)
            return call(now_ns)

        def send(call, data):
            if data:
                sent.append(world.samples)
            return call(data)

        address, offset = kernel.motor_wiring.enable_line
        levels, was = kernel.gpio.bank(address).levels, [0]

        def ioctl(call, fd, request, argument, mutate=True):
            result = call(fd, request, argument, mutate)
            if request in (SET_VALUES_V1, SET_VALUES_V2):
                level = levels[offset]
                if was[0] and not level:
                    self.fell_ns.append(kernel.monotonic_ns())
                was[0] = level
            return result

        taps.add(world, "advance", advance)
        taps.add(kernel.gpio, "ioctl", ioctl)
        taps.add(kernel.chip, "sample", sample)
        taps.add(kernel.bus, "i2c_rdwr", transfer, outside=True)
        taps.add(kernel.operator, "press_button", press)
        taps.add(bench.remote, "send_bytes", send)

    def _take_truth(self) -> None:
        world = self._bench.world
        if self._truth_until >= world.samples:
            return
        numbers = np.arange(self._truth_until + 1, world.samples + 1)
        truth = world.truth_rows[numbers % len(world.truth_rows)]
        self.lean_rad[numbers] = np.arccos(np.clip(np.cos(truth["roll_rad"]) * np.cos(truth["pitch_rad"]), -1.0, 1.0))
        self._truth_until = world.samples

    def take_rows(self, rows) -> None:
        """Takes in committed rows of the log."""
        self._parts.append({name: rows[name].copy() for name in COLUMNS})

    def finish(self) -> None:
        """Cuts the arrays to what happened; call when the run is over."""
        self._take_truth()
        self.samples = self._bench.world.samples
        n = self.samples + 1
        for name in ("enabled", "duty", "lean_rad", "packet", "delivered"):
            setattr(self, name, getattr(self, name)[:n])
        self.presses, self.bytes_sent = np.array(self.presses, int), np.array(self.bytes_sent, int)
        kernel = self._bench.kernel
        self.rows = {name: np.concatenate([part[name] for part in self._parts]) for name in COLUMNS} if self._parts else {}
        if self.rows:
            self.rows["sample"] = np.array([kernel.sample_of(int(edge)) for edge in self.rows["edge_ns"]])
        self.start_ns = kernel.start_ns
        self.injections = [(i.name, kernel.sample_of(i.begin_ns), min(kernel.sample_of(i.end_ns), self.samples), i.hits) for i in self.journal]
        self.stalled = [(kernel.sample_of(begin), kernel.sample_of(end)) for begin, end in self.stalls]

    @property
    def usable(self) -> np.ndarray:
        """(n,) delivered, and a quaternion whose norm is 1 within 1 %, or (without DMP) words that are not all ones or all zeros."""
        if self.onboard:
            words = self.packet[:, 16:28]
            return self.delivered & ~((words == 0xFF).all(axis=1) | (words == 0).all(axis=1))
        q = np.ascontiguousarray(self.packet[:, :16]).view(">i4").astype(float) / (1 << 30)
        return self.delivered & (np.abs(np.sqrt((q**2).sum(axis=1)) - 1.0) <= 0.01)

    @property
    def measured_lean_rad(self) -> np.ndarray:
        """(n,) lean by the packets' quaternions; nonsense where they are not usable, 0 where the chip knows none."""
        q = np.ascontiguousarray(self.packet[:, :16]).view(">i4").astype(float) / (1 << 30)
        return np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0))

    @property
    def moving(self) -> np.ndarray:
        """(n,) enabled with a duty."""
        return self.enabled & self.duty.any(axis=1)
