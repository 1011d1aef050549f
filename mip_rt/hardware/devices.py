"""Opens all devices of a robot in the order that is safe, and closes them again."""

import math
from contextlib import ExitStack
from dataclasses import dataclass
from types import SimpleNamespace

from mip_rt.errors import ImuError
from mip_rt.hardware import compiled_io
from mip_rt.hardware.battery import Battery
from mip_rt.hardware.boards import GPIO, board, serial_device
from mip_rt.hardware.encoders import Encoder
from mip_rt.hardware.input_events import InputEvents
from mip_rt.hardware.leds import Leds
from mip_rt.hardware.motors import Motors
from mip_rt.hardware.mpu9250 import Mpu9250
from mip_rt.hardware.mpu9250_raw import RawMpu9250
from mip_rt.hardware.serial_port import SerialPort
from mip_rt.remote.command import RemoteCommand
from mip_rt.remote.fourjoy import FourJoyDecoder


@dataclass
class Devices:
    """Opened drivers; `battery_v` is the newest reading."""

    imu: Mpu9250
    imu_line: InputEvents
    encoders: tuple
    counters: object  # compiled_io.COUNTERS of all encoders
    motors: Motors
    battery: Battery
    button: InputEvents
    remote: RemoteCommand
    port: SerialPort | None
    leds: Leds
    guard: object  # guard_client.GuardClient
    battery_v: float = math.nan

    def close(self) -> None:
        """Motors first."""
        self.motors.close()
        self.imu.stop()
        for part in (self.imu_line, *self.encoders, self.battery, self.button, self.leds, *([self.port] if self.port else [])):
            part.close()


def open_devices(kernel, config, enable, remote_device: str | None, image=None) -> Devices:
    """Opens and starts everything: motors (off) first. The guard holds their enable line low from the beginning.

    Args:
        enable: the enable line: guard_client.GuardClient.
        remote_device: path of the remote's port, or "auto" for the board's; None for no remote.
        image: (path, sha256) of another DMP image than the configuration's.

    Raises:
        HardwareError: with code and cure, for the first device that refuses.
    """
    pins = board(config.board, kernel)
    enable.wait_ready()
    with ExitStack() as opened:  # where a later device refuses, the earlier ones are closed, and a new attempt finds nothing taken
        motors = Motors(kernel, pins, config.motors.channels, round(1e9 / config.motor.pwm_frequency_hz), enable)
        opened.callback(motors.close)
        motors.start()
        counters = compiled_io.records(compiled_io.COUNTERS, len(config.encoders.channels))
        encoders = tuple(Encoder(kernel, pins.encoders[channel - 1], counters, i) for i, channel in enumerate(config.encoders.channels))
        for encoder in encoders:
            opened.callback(encoder.close)
            encoder.start()
        battery = _closed_with(opened, Battery(kernel, config.battery))
        button = _closed_with(opened, InputEvents(kernel, GPIO[pins.arm_button[0]], pins.arm_button[1], "falling", "mip-rt arm"))
        port = _closed_with(opened, SerialPort(serial_device(remote_device, pins, kernel), config.remote.baud)) if remote_device else None
        imu_line = _closed_with(opened, interrupt_line(kernel, pins))
        imu = make_imu(kernel, config, image)
        opened.callback(imu.stop)
        imu.start()
        opened.pop_all()
    remote = RemoteCommand(port, FourJoyDecoder(), config.remote)
    return Devices(imu, imu_line, encoders, counters, motors, battery, button, remote, port, Leds(kernel, pins.leds), enable, battery.read())


def _closed_with(opened: ExitStack, part):
    opened.callback(part.close)
    return part


def interrupt_line(kernel, pins) -> InputEvents:
    """The IMU's interrupt line of a board."""
    return InputEvents(kernel, GPIO[pins.imu_interrupt[0]], pins.imu_interrupt[1], "falling", "mip-rt imu")


def make_imu(kernel, config, image=None) -> Mpu9250:
    """The IMU's driver, not started.

    Args:
        image: (path, sha256) of another DMP image than the configuration's.

    Raises:
        ImuError: there is no such bus, or it may not be opened.
    """
    settings = config.imu
    if image is not None:
        settings = SimpleNamespace(**{**vars(config.imu), "dmp_image": image[0], "dmp_image_sha256": image[1]})
    try:
        return (RawMpu9250 if settings.attitude == "onboard" else Mpu9250)(kernel, settings, config.realtime.rate_hz)
    except OSError as error:
        raise ImuError(
            f"the I2C bus {settings.bus} cannot be opened: {error.strerror}.", "Join the groups i2c and gpio; see imu.bus; run mip-rt doctor.", "imu_bus"
        ) from error
