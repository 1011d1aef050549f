"""The IMU: image, bring-up with load and verification of the DMP, interrupts, FIFO, plausibility of what it measures."""

import numpy as np

from mip_rt.doctor.patient import as_check
from mip_rt.doctor.report import fail, ok, skip, warn
from mip_rt.errors import DmpImageError, MipRtError
from mip_rt.hardware import dmp, imu_window
from mip_rt.hardware import imu_status as status
from mip_rt.hardware.devices import interrupt_line, make_imu

WINDOW_S = 2.0
RATE_TOLERANCE = 0.03
JITTER_WARN_S = 0.5e-3  # of the kernel's own timestamps
GRAVITY_TOLERANCE = 0.15
TROUBLE = {
    status.IMU_MISALIGNED: "misaligned", status.IMU_OVERFLOW: "overflows", status.IMU_BAD_NORM: "bad quaternions",
    status.IMU_FROZEN: "frozen", status.IMU_BUS_ERROR: "bus errors", status.IMU_NO_DATA: "empty",
}  # fmt: skip


def examine(patient):
    """Yields the layer's Checks."""
    settings, rate_hz = patient.config.imu, patient.config.realtime.rate_hz
    if settings.attitude == "dmp":
        path, sha256 = patient.image or (settings.dmp_image, settings.dmp_image_sha256)
        try:
            dmp.load_image(path, sha256)
            yield ok("image", "the DMP's image is there, its SHA-256 is right.")
        except DmpImageError as error:
            yield as_check("image", error)
            yield skip("start", "the DMP's image is missing")
            return
        if settings.gyro_range_dps != 2000:
            yield fail("range", f"imu.gyro_range_dps is {settings.gyro_range_dps}: the DMP integrates rightly only at 2000 deg/s and 200 Hz.",
                       "Set imu.gyro_range_dps to 2000.")  # fmt: skip
    try:
        line = interrupt_line(patient.kernel, patient.pins)
    except MipRtError as error:
        yield as_check("line", error)
        yield skip("start", "the interrupt line cannot be had")
        return
    try:
        imu = make_imu(patient.kernel, patient.config, patient.image)
        try:
            begin_ns = patient.kernel.monotonic_ns()
            imu.start()
        except MipRtError as error:
            yield as_check("start", error)
            return
        seconds = (patient.kernel.monotonic_ns() - begin_ns) * 1e-9
        loaded = "DMP loaded and verified" if settings.attitude == "dmp" else "no DMP wanted"
        yield ok("start", f"{imu.chip} configured, {loaded}, in {seconds:.2f} s.")
        window = imu_window.collect(patient.kernel, imu, line, settings, WINDOW_S, rate_hz)
        patient.notes["window"] = window
        yield from _interrupts(window, rate_hz)
        yield _fifo(window)
        yield from _measures(window, settings)
    finally:
        try:
            imu.stop()
        finally:
            line.close()


def _interrupts(window, rate_hz):
    n = len(window.edge_ns)
    if n < 10:
        yield fail("interrupt", f"{n} interrupts in {WINDOW_S:g} s: the line is dead although the chip runs.",
                   "Pad 0x9ac (P9_25) must be GPIO 3_21, mode 7, input: load the project's overlay; BB-EQEP0 takes this pad.")  # fmt: skip
        return
    gaps = np.diff(window.edge_ns) * 1e-9
    found_hz = (n - 1 + window.missed) / float(gaps.sum())
    jitter_s = float(np.median(np.abs(gaps - np.median(gaps))) * 1.4826)
    words = f"{found_hz:.1f} Hz, jitter {jitter_s * 1e6:.0f} us, longest gap {gaps.max() * 1e3:.1f} ms"
    if abs(found_hz - rate_hz) > RATE_TOLERANCE * rate_hz:
        yield fail("interrupt", f"{words}; {rate_hz:g} Hz are expected.", "Check the DMP's image; a DMP that runs at another rate also integrates wrongly.")
    elif jitter_s > JITTER_WARN_S or window.silences:
        yield warn("interrupt", f"{words}, {window.silences} silent waits.", "Keep the IMU's wires away from the motors'; is the board busy?")
    else:
        yield ok("interrupt", f"{words}.")


def _fifo(window):
    counts = {words: sum(times for bits, times in window.status.items() if bits & bit) for bit, words in TROUBLE.items()}
    reads = sum(window.status.values())
    good = sum(times for bits, times in window.status.items() if bits & status.IMU_OK)
    listed = ", ".join(f"{times} {words}" for words, times in counts.items() if times)
    sentence = f"{good} of {reads} reads brought a good packet" + (f"; {listed}" if listed else "") + "."
    serious = reads - good - counts["empty"]
    if good == 0 or serious > 0.05 * reads:
        return fail("fifo", sentence, "Shorten the IMU's cable and check its supply; if the bus is slow (i2c.clock), mend that first.")
    if serious or counts["empty"] > 0.05 * reads:
        return warn("fifo", sentence, "Look at it again with the motors' supply off: noise on the bus comes from there.")
    if counts["overflows"]:
        return warn("fifo", sentence, "The board did not come round to reading for 160 ms: look for what keeps it busy (top), and at the layer realtime.")
    return ok("fifo", sentence)


def _measures(window, settings):
    if not len(window.force_m_s2):
        return
    force, rate = window.force_m_s2.mean(0), window.rate_rad_s
    size = float(np.linalg.norm(force))
    if not np.abs(window.force_m_s2).any() or not np.abs(rate).any():
        yield fail("measures", "accelerometer or gyro read nothing but zeros.", "The chip sleeps or is a copy without that sensor: power-cycle it, or replace it.")
    elif abs(size / imu_window.GRAVITY_M_S2 - 1.0) > GRAVITY_TOLERANCE:
        yield fail("measures", f"the accelerometer's mean is {size:.2f} m/s^2, gravity is 9.81.", "Keep the robot still; check imu.accel_range_g; calibrate the accelerometer.")
    else:
        still = float(rate.std(0).max())
        sentence = f"gravity {size:.2f} m/s^2, gyro at rest {np.abs(rate.mean(0)).max():.3f} rad/s, noise {still:.4f} rad/s"
        if np.abs(rate.mean(0)).max() > 0.35:
            yield fail("measures", f"{sentence}: too much for a robot at rest.", "Keep the robot still; otherwise replace the IMU.")
        else:
            yield ok("measures", sentence + ".")
