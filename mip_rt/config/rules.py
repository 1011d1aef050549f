"""Rules between keys: each names the key it blames and says what is wrong."""

from mip_rt.config.suggestion import nearest
from mip_rt.hardware.boards import BOARDS


def _orthonormal(matrix) -> float:
    """Largest deviation of matrix' matrix from the identity."""
    columns = list(zip(*matrix))
    return max(
        abs(sum(a * b for a, b in zip(columns[i], columns[j])) - (i == j)) for i in range(3) for j in range(3)
    )


def _determinant(m) -> float:
    return (
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    )


def _matrix_rules(key, matrix):
    if _orthonormal(matrix) > 1e-3:
        yield key, "the columns must be perpendicular and of length 1 (within 0.001)"
    elif _determinant(matrix) < 0.0:
        yield key, "this is a mirror image, not a rotation (determinant -1): exchange a sign"


def _mbbr_rules(config):
    yield from _matrix_rules("wheels.body_from_wheel", config.wheels.body_from_wheel)
    names = config.control.gain_sets.as_dict()
    rates = [row.yaw_rate_hz for row in config.control.schedule]
    if not 1 <= len(rates) <= 8:
        yield "control.schedule", f"expected 1 to 8 rows, found {len(rates)}"
    if rates != sorted(set(rates)):
        yield "control.schedule", "yaw rates must ascend"
    for row in config.control.schedule:
        if row.set not in names:
            yield "control.schedule", f"no gain set {row.set!r}{nearest(row.set, names)}"


def _edumip_rules(config):
    control = config.control
    names = control.filters.as_dict()
    if control.filter_set not in names:
        yield "control.filter_set", f"no such filters: {control.filter_set!r}{nearest(control.filter_set, names)}"
    for name, entry in vars(control.filters).items():
        if entry.inner_denominator[0] == 0.0 or entry.outer_denominator[0] == 0.0:
            yield "control.filters", f"{name}: a denominator's first number must not be zero"
    rates = list(control.lqr.yaw_rates_rad_s)
    if not rates or rates != sorted(set(rates)):
        yield "control.lqr.yaw_rates_rad_s", "one or more yaw rates that ascend are needed"
    if config.realtime.rate_hz not in (100.0, 200.0):
        yield "realtime.rate_hz", f"the DMP delivers at 200 or 100 Hz, not at {config.realtime.rate_hz:g}"


def broken_rules(config):
    """Yields (key, message) for every rule that the configuration breaks."""
    yield from {"mbbr": _mbbr_rules, "edumip": _edumip_rules}[config.robot](config)
    yield from _matrix_rules("imu.mounting", config.imu.mounting)
    estimators = [config.estimator.control, *config.estimator.shadows]
    if len(set(estimators)) != len(estimators):
        yield "estimator.shadows", "an estimator stands here twice, or is the one in control"
    if config.remote.timeout_s + config.remote.ramp_s > 0.5:
        yield "remote.timeout_s", "timeout_s and ramp_s together must be at most 0.5 s: a lost remote must stand still by then"
    if config.limits.guard_timeout_s < config.limits.imu_silence_s + 0.01:
        yield "limits.guard_timeout_s", "must be at least imu_silence_s and two ticks, so that a silent IMU is not taken for a hung loop"
    buttons = [level.button for level in config.remote.levels]
    if "none" not in buttons or len(set(buttons)) != len(buttons):
        yield "remote.levels", "each button once, and one row for 'none'"
    low, high = config.battery.plausible_v
    if not low < high:
        yield "battery.plausible_v", "the first number must be the lower one"
    if not config.battery.cutoff_v < config.battery.minimum_v <= config.battery.warn_v:
        yield "battery.cutoff_v", "cutoff_v must be below minimum_v, and that at most warn_v"
    for key, allowed, value in (
        ("imu.accel_range_g", (2, 4, 8, 16), config.imu.accel_range_g),
        ("imu.gyro_range_dps", (250, 500, 1000, 2000), config.imu.gyro_range_dps),
        ("imu.dlpf_hz", (5, 10, 20, 41, 92, 184), config.imu.dlpf_hz),
    ):
        if value not in allowed:
            yield key, f"expected one of {', '.join(map(str, allowed))}, found {value}"
    if config.imu.attitude == "dmp" and config.imu.gyro_range_dps != 2000:
        yield "imu.gyro_range_dps", "the DMP integrates the gyro rightly only at 2000 deg/s"
    if config.board != "auto":
        pins = BOARDS[config.board]
        if config.motor.pwm_frequency_hz > pins.bridge.pwm_limit_hz:
            yield "motor.pwm_frequency_hz", f"the drivers of {config.board} take at most {pins.bridge.pwm_limit_hz / 1e3:g} kHz"
        for channel in config.motors.channels:
            if channel not in pins.motors:
                yield "motors.channels", f"{config.board} has no motor output {channel}; it has {', '.join(map(str, pins.motors))}"
    for key in ("motors", "encoders"):
        section = getattr(config, key)
        if len(set(section.channels)) != len(section.channels):
            yield f"{key}.channels", "different channels are needed"
        if 0 in section.signs:
            yield f"{key}.signs", "a sign is 1 or -1"
