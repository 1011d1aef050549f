"""What the error numbers of an I2C transfer mean on an AM335x: words and a cure for each.

Source: Linux drivers/i2c/busses/i2c-omap.c and drivers/i2c/i2c-dev.c.
"""

import errno
import os

BUS_ERRORS = {
    errno.EREMOTEIO: (
        "nothing acknowledged the address",
        "Check power and wiring of the IMU and its address (imu.bus, imu.address); if it comes while motors turn, keep its cable away from theirs.",
    ),
    errno.ETIMEDOUT: (
        "the transfer timed out after a second: SDA or SCL is held low",
        "Power-cycle the board; if it stays, check the pull-ups (2.2 kOhm at 400 kHz) and look for a short.",
    ),
    errno.EIO: ("the bus controller ran over or under", "Shorten the cable (below 15 cm), add 2.2 kOhm pull-ups, check the ground."),
    errno.EAGAIN: ("arbitration was lost to another master", "Take other masters from the bus; without any, SDA is disturbed: shorten the cable."),
    errno.EBUSY: (
        "the bus or the chip is held by somebody else",
        "A kernel driver may hold the IMU: unbind inv-mpu6050-i2c from it, and blacklist the module (mip-rt doctor shows how).",
    ),
}


def explain(error: OSError) -> tuple[str, str]:
    """(what happened, with the number; cure)."""
    words, cure = BUS_ERRORS.get(error.errno, ("the I2C bus refused", "Run mip-rt doctor, and look at the kernel's messages (dmesg)."))
    return f"{words} (error {error.errno}, {os.strerror(error.errno or 0)})", cure
