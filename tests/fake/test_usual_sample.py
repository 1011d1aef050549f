"""A usual sample is compiled, an unusual one is not: nobody behind the boundary can tell which it was."""

import numpy as np
import pytest
from helpers import DryRun, make_config

from mip_rt.fake import usual_sample
from mip_rt.hardware import mpu9250_registers as r


class Counted(DryRun):
    """A dry run whose compiled samples are counted; `watched`: somebody looks at the world, so that none may be compiled."""

    def __init__(self, folder, watched, robot="mbbr", scenario="hold"):
        folder.mkdir()
        super().__init__(folder, make_config(robot, estimator__shadows="[]"), scenario)
        if watched:
            self.bench.injector.taps.add(self.bench.world, "advance", lambda call, *arguments: call(*arguments))
        self.found = []
        world = self.bench.world
        whole, world._usual = world._usual, lambda *arguments: self.found.append(whole(*arguments)) or self.found[-1]

    def balancing(self):
        self.until(lambda: self.state.name == "BALANCING")
        return self

    @property
    def rows(self):
        return self.session.ring.rows[: self.session.loop.ticks].tobytes()


def both(tmp_path, act, **settings):
    """What `act` does in a run with compiled samples, and in one without."""
    for watched in (False, True):
        with Counted(tmp_path / str(watched), watched, **settings) as dry:
            act(dry)
            yield dry


@pytest.mark.parametrize("robot, scenario", [("mbbr", "drive-spin-1.0"), ("mbbr", "spin-1.5"), ("edumip", "drive")])
def test_runs_are_the_same_to_the_bit(tmp_path, robot, scenario):
    compiled, watched = both(tmp_path, lambda dry: dry.run(8.0), robot=robot, scenario=scenario)
    assert compiled.found.count(usual_sample.EDGE) > 1500 and watched.found == []
    assert compiled.rows == watched.rows
    assert compiled.bench.kernel.chip.transfers == watched.bench.kernel.chip.transfers > 3000


def pause(dry, seconds):
    dry.balancing()
    dry.bench.kernel.sleep(seconds)  # the loop stands still, the world does not
    dry.levels = [dry.bench.kernel.gpio.line_value(*dry.bench.kernel.motor_wiring.enable_line)]
    dry.waiting = bytes(dry.bench.kernel.chip.fifo)
    for _ in range(100):
        dry.session.loop.tick()
    dry.truth = dry.bench.world.truth_rows[: dry.bench.world.samples].tobytes()


@pytest.mark.parametrize("seconds, packets, level", [(0.012, 2, 1), (0.03, 6, 1), (0.2, 32, 0)])
def test_a_loop_that_stands_still_finds_the_same_world(tmp_path, seconds, packets, level):
    """Packets that wait, an interrupt line's full buffer, and the guard's drop are not usual."""
    compiled, watched = both(tmp_path, lambda dry: pause(dry, seconds))
    assert len(compiled.waiting) == packets * r.PACKET_BYTES and compiled.levels == [level]
    assert (compiled.waiting, compiled.levels, compiled.truth) == (watched.waiting, watched.levels, watched.truth)
    assert compiled.rows == watched.rows
    assert (usual_sample.UNUSUAL in compiled.found) == (level == 0) and usual_sample.MOVED in compiled.found


def test_who_watches_the_bus_sees_the_next_transfer(tmp_path):
    with Counted(tmp_path / "run", False) as dry:
        loop, bus = dry.balancing().session.loop, dry.bench.kernel.bus
        seen = []
        bus.before = lambda messages: seen.append(bytes(messages[0])[0])
        loop.tick()
        assert seen == [r.FIFO_COUNT_H, r.FIFO_R_W]
        bus.before = None
        for _ in range(3):
            loop.tick()
        assert len(seen) == 2 and dry.found[-2:] == [usual_sample.EDGE] * 2


def test_who_changes_the_chip_is_heeded_at_once(tmp_path):
    """A register that is changed behind the driver's back, and what lies in the registers and the FIFO."""
    with Counted(tmp_path / "run", False) as dry:
        kernel, loop = dry.balancing().bench.kernel, dry.session.loop
        world, chip = dry.bench.world, kernel.chip
        loop.tick()
        assert dry.found[-1] == usual_sample.EDGE and bytes(chip.fifo) == b"" and chip.last_byte == world.packet[31]
        assert bytes(chip.registers[r.ACCEL_XOUT_H : r.ACCEL_XOUT_H + r.RAW_BYTES]) == bytes(world.raw)
        kernel.sleep(0.005)
        assert bytes(chip.fifo) == bytes(world.packet) and chip.registers[r.INT_STATUS] & r.INT_DMP
        loop.tick()
        chip.registers[r.INT_ENABLE] = 0
        edges = kernel.gpio.events_of(*kernel.imu_line).sequence
        kernel.sleep(0.02)
        assert kernel.gpio.events_of(*kernel.imu_line).sequence == edges


def test_an_encoder_that_is_shown_otherwise_is_read_otherwise(tmp_path):
    """Methods may also be replaced by hand; nothing needs to be told."""
    with Counted(tmp_path / "run", False) as dry:
        loop, wiring = dry.balancing().session.loop, dry.bench.kernel.motor_wiring
        loop.tick()
        before = np.array(dry.row["encoder_count"])
        whole = wiring.show_encoders
        wiring.show_encoders = lambda counts: whole(counts + 1000)
        loop.tick()
        assert (np.abs(np.array(dry.row["encoder_count"]) - before - 1000) < 200).all()
