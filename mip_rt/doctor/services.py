"""Other programs that want the same hardware: the robot itself, the old library's services, a login on the remote's port."""

from mip_rt.doctor.report import fail, ok, skip, warn

UNITS = {  # unit: what it takes
    "robotcontrol.service": "motors, LEDs and buttons",
    "rc_balance.service": "motors and IMU",
    "rc_battery_monitor.service": "the battery LEDs",
}


def _active(patient, unit: str) -> bool | None:
    code, text = patient.kernel.command("systemctl", "is-active", unit)
    if code in (124, 126, 127) or "not been booted with systemd" in text or "Failed to connect" in text:
        return None
    return text.strip() == "active"


def examine(patient):
    """Yields the layer's Checks."""
    running = _active(patient, "mip-rt.service")
    if running is None:
        yield skip("systemd", "this system was not booted with systemd")
        return
    if running:
        yield fail("mip-rt", "mip-rt.service is running and holds the devices.", "sudo systemctl stop mip-rt, then run mip-rt doctor again.")
    else:
        yield ok("mip-rt", "mip-rt.service is not running, the devices are free.")
    for unit, takes in UNITS.items():
        if _active(patient, unit):
            yield fail(unit.partition(".")[0], f"{unit} is running and takes {takes}.", f"sudo systemctl disable --now {unit}")
    port = patient.config.remote.device.rpartition("/")[2]
    getty = f"serial-getty@{port}.service"
    if _active(patient, getty):
        yield warn("getty", f"a login waits on {port}, the remote's port, and takes its bytes.", f"sudo systemctl disable --now {getty}")
    else:
        yield ok("others", f"neither robotcontrol nor a login on {port} is in the way.")
