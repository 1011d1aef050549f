"""What differs between the kernels that run on a BeagleBone: names, numbers and places of the same chips.

Numbers are those seen on images of each generation; a driver that relied on one of them would work on one generation only.
"""

from dataclasses import dataclass

from mip_rt.hardware.boards import EHRPWM, GPIO

OCP = "sys/devices/platform/ocp"


@dataclass(frozen=True)
class Generation:
    """One generation of kernels.

    Attributes:
        release: as uname has it.
        interconnect: the tree has interconnect and target-module between bus and chip.
        encoders: "counter" or "tieqep".
        pwm_naming: "pwmchipK/pwmN" or "pwm-K:N".
        gpio_abi: newest ABI of the GPIO character device.
        pwm_numbers, gpio_numbers: by address.
        counter_numbers: by eQEP.
        pinctrl_cells: numbers a pad in the device tree: 1 (offset, value) or 2 (offset, configuration, mode).
        imu_in_blue_tree: the Blue's device tree gives the IMU to the kernel's driver.
        blue_has_pwm: the Blue's device tree has the motors' PWM.
    """

    release: str
    interconnect: bool
    encoders: str
    pwm_naming: str
    gpio_abi: int
    pwm_numbers: dict
    gpio_numbers: dict
    counter_numbers: tuple
    pinctrl_cells: int
    imu_in_blue_tree: bool
    blue_has_pwm: bool

    def device(self, address: str, kind: str) -> str:
        """Folder of the chip's device below the root."""
        if not self.interconnect:
            if address[:5] in ("48300", "48302", "48304"):
                return f"{OCP}/{address[:-3]}000.epwmss/{address}.{kind}"
            return f"{OCP}/{address}.{kind}"
        bus = "44c00000" if address.startswith("44") else "48000000"
        module = address if address.startswith("44e0") else f"{address[:-3]}000"
        inner = f"{module}.epwmss/" if kind in ("counter", "pwm") else ""
        return f"{OCP}/{bus}.interconnect/{bus}.interconnect:segment@0/{module}.target-module/{inner}{address}.{kind}"


def _numbers(addresses, numbers) -> dict:
    return dict(zip(addresses, numbers))


GENERATIONS = {
    "4.19-ti": Generation(
        "4.19.94-ti-r73", False, "tieqep", "pwm-K:N", 1, _numbers(EHRPWM, (1, 3, 6)), _numbers(GPIO, (0, 1, 2, 3)), (), 1, False, True,
    ),
    "5.10-ti": Generation(  # with the eCAPs between the ehrpwm
        "5.10.168-ti-r72", True, "counter", "pwmchipK/pwmN", 2, _numbers(EHRPWM, (1, 4, 7)), _numbers(GPIO, (0, 1, 2, 3)), (2, 0, 1), 2,
        True, True,
    ),
    "6.12-bone": Generation(  # GPIO banks in the order in which they are probed
        "6.12.49-bone36", True, "counter", "pwmchipK/pwmN", 2, _numbers(EHRPWM, (2, 0, 1)), _numbers(GPIO, (3, 0, 1, 2)), (1, 2, 0), 2,
        True, False,
    ),
}  # fmt: skip
