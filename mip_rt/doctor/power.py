"""The battery, as the ADC sees it."""

import math

from mip_rt.doctor.report import fail, ok, warn
from mip_rt.hardware.battery import Battery

READINGS = 10


def examine(patient):
    """Yields the layer's Checks."""
    settings = patient.config.battery
    battery = Battery(patient.kernel, settings)
    try:
        found = []
        for _ in range(READINGS):
            found.append(battery.read())
            patient.kernel.sleep(0.01)
    finally:
        battery.close()
    good = [volts for volts in found if not math.isnan(volts)]
    if not good:
        yield fail("battery", f"channel {settings.adc_channel} shows no plausible voltage ({settings.plausible_v[0]:g} to {settings.plausible_v[1]:g} V).",
                   "Connect the battery (USB power does not reach the divider); check battery.adc_channel, battery.ratio and, on a bare board, the divider.")  # fmt: skip
        return
    volts = sum(good) / len(good)
    sentence = f"{volts:.2f} V, spread {max(good) - min(good):.2f} V"
    if volts < settings.minimum_v:
        yield fail("battery", f"{sentence}: less than battery.minimum_v, {settings.minimum_v:g} V.", "Charge it.")
    elif volts < settings.warn_v:
        yield warn("battery", f"{sentence}: nearly empty.", "Charge it.")
    else:
        yield ok("battery", f"{sentence} (channel {settings.adc_channel}); compare with a meter once: the divider's offset differs from board to board.")
