"""Builds the eduMIP from a configuration: gains from the model, parameter and state records, the bound step. Runs once, before the loop."""

import numpy as np

from mip_rt import frame
from mip_rt.controllers import lqr, mip_reference, successive_loop, wheel_drive
from mip_rt.controllers.filters import pole_from_rate
from mip_rt.errors import ConfigError
from mip_rt.estimators import complementary, complementary_kf, mip_2state_ekf, mip_ekf, mip_inertial_ekf, mip_planar_kf, pendulum_ekf
from mip_rt.models import mip, mip_yaw
from mip_rt.robots import edumip as robot
from mip_rt.robots import edumip_frame, edumip_imu_slots, health, onboard, sensors
from mip_rt.robots.edumip_judge import Judge  # noqa: F401  (part of what a setup module offers)
from mip_rt.robots.robot import BATTERY_HOLD_S, BATTERY_SMOOTHING_RAD_S, Robot, noise

# name: (kind, DMP lean to the controller, model variant or None for the configured one)
ESTIMATORS = {
    "ekf": (robot.KIND_EKF, 0, None),
    "ekf_printed": (robot.KIND_EKF, 0, "printed"),
    "planar_kf": (robot.KIND_PLANAR, 0, None),
    "complementary": (robot.KIND_COMPLEMENTARY, 0, None),
    "complementary_kf": (robot.KIND_COMPLEMENTARY_KF, 0, None),
    "dmp": (robot.KIND_DMP, 1, None),
    "dmp_ekf": (robot.KIND_EKF, 1, None),
    "inertial_ekf": (edumip_imu_slots.KIND_INERTIAL, 0, None),
    "pendulum_ekf": (edumip_imu_slots.KIND_PENDULUM, 0, None),
    "two_state_ekf": (edumip_imu_slots.KIND_2STATE, 0, None),
}
FRAME = robot.FRAME
CONTROLLERS = {"lqr": robot.LQR, "successive_loop": robot.SUCCESSIVE_LOOP, "pid": robot.PID}
NOISE_STEP_S = 0.005  # the step that the configuration's process noise stands for


def imu_position(config) -> np.ndarray:
    """(3,) of the IMU from the centre of mass, body axes."""
    return np.array(config.imu.position_m, float)


def imu_lever(config) -> np.ndarray:
    """(3,) of the IMU from the middle of the axle, body axes."""
    return imu_position(config) + np.array([0.0, 0.0, config.model.com_height_m])


def model_parameters(config, reading: str | None = None):
    """(1,) record array of models.mip.PARAMETERS; `reading` of the wheel inertia, the configured one by default."""
    m = config.model
    return mip.parameters(
        body_mass_kg=m.body_mass_kg,
        wheel_mass_kg=m.wheel_mass_kg,
        wheel_radius_m=m.wheel_radius_m,
        track_m=m.track_m,
        com_height_m=m.com_height_m,
        body_inertia_kg_m2=m.body_inertia_kg_m2,
        wheel_inertia_kg_m2=m.wheel_inertia_kg_m2,
        rotor_inertia_kg_m2=mip.rotor_inertia(m.wheel_inertia_kg_m2, reading or m.wheel_inertia_reading),
        torque_per_command_n_m=m.torque_per_command_n_m,
        damping_n_m_s_rad=m.damping_n_m_s_rad + config.friction.viscous_n_m_s_rad,
        gravity_m_s2=m.gravity_m_s2,
        imu_position_m=imu_position(config),
    )


def balance_model(coefficients, yaw_rate_rad_s: float):
    """A (5, 5), B (5, 1) of [lean, wheel angle against the ground, their rates, integral of the wheel angle] at a yaw rate."""
    square = yaw_rate_rad_s**2
    A, B = np.zeros((5, 5)), np.zeros((5, 1))
    A[0, 2] = A[1, 3] = A[4, 1] = 1.0
    for row, (lean, damping, spin, command) in ((2, coefficients.tilt), (3, coefficients.tilt + coefficients.wheel)):
        A[row, 0], A[row, 2], A[row, 3], B[row, 0] = lean + spin * square, -damping, damping, command
    return A, B


def design(config, dt_s: float, yaw_rate_rad_s: float) -> np.ndarray:
    """(5,) gains of controllers.mip_feedback at a yaw rate.

    Raises:
        ConfigError: the tolerances of control.lqr do not lead to a stable loop.
    """
    c = mip_yaw.coefficients(model_parameters(config)[0])[0]
    t = config.control.lqr
    tolerated = [t.pitch_rad, t.wheel_rad, t.pitch_rate_rad_s, t.wheel_rate_rad_s, t.integral_rad_s]
    try:
        return lqr.gains(*balance_model(c, yaw_rate_rad_s), tolerated, [t.command], dt_s)[0]
    except ValueError as error:
        raise ConfigError(f"control.lqr at {yaw_rate_rad_s:g} rad/s: {error}.", "Change the tolerances.", "lqr_design") from error


def _estimator(p, name, config, model, dt_s) -> None:
    p.kind, p.dmp_attitude, variant = ESTIMATORS[name]
    e = config.estimator
    share = dt_s / NOISE_STEP_S
    coefficients = mip_yaw.coefficients(model[0], variant or config.model.variant, e.lever_arm)[0]
    noise(p.ekf.noise, config, np.array(getattr(e.process_noise, e.noise_set)) * share, e.measurement_noise, e.initial_covariance,
          mip_ekf.STATES, dt_s)  # fmt: skip
    p.ekf.model = coefficients
    noise(p.planar.noise, config, np.array(e.planar_process_noise) * share, e.planar_measurement_noise, e.initial_covariance,
          mip_planar_kf.STATES, dt_s)  # fmt: skip
    mip_planar_kf.configure_model(p.planar.model, coefficients)
    complementary.configure(p.complementary, e.corner_rad_s, dt_s)
    *process, measurement = e.complementary_kf_noise
    noise(p.complementary_kf.noise, config, np.array(process) * share, [measurement], e.initial_covariance, complementary_kf.STATES, dt_s)
    lever = imu_lever(config)
    mip_inertial_ekf.configure(p.imu.inertial, dt_s, lever, config.model.wheel_radius_m, config.imu.gyro_delay_s)
    noise(p.imu.pendulum.noise, config, np.array(e.pendulum_process_noise) * share, e.pendulum_measurement_noise, e.initial_covariance,
          pendulum_ekf.STATES, dt_s)  # fmt: skip
    p.imu.pendulum.lever_m, p.imu.pendulum.gravity_m_s2 = lever[2], config.model.gravity_m_s2
    noise(p.imu.two_state.noise, config, np.array(e.two_state_process_noise) * share, e.two_state_measurement_noise, e.initial_covariance,
          mip_2state_ekf.STATES, dt_s)  # fmt: skip


def build(config, shadows=None) -> Robot:
    """The robot of this configuration.

    Raises:
        ConfigError: more estimators than slots, or gains that cannot be designed.
    """
    dt_s = 1.0 / config.realtime.rate_hz
    names = [config.estimator.control, *(config.estimator.shadows if shadows is None else shadows)]
    if len(names) > frame.ESTIMATORS:
        raise ConfigError(f"{len(names)} estimators are configured, there are {frame.ESTIMATORS} slots.")
    model = model_parameters(config)
    estimator_parameters = np.zeros(len(names), robot.ESTIMATOR_PARAMETERS).view(np.recarray)
    for slot, name in enumerate(names):
        _estimator(estimator_parameters[slot], name, config, model, dt_s)

    parameters = np.zeros(1, robot.PARAMETERS).view(np.recarray)
    p = parameters[0]
    p.controller = CONTROLLERS[config.control.controller]
    p.wheel_radius_m, p.tip_rad = config.model.wheel_radius_m, config.limits.tip_rad
    p.nominal_voltage_v = config.motor.nominal_voltage_v
    p.battery_pole = pole_from_rate(BATTERY_SMOOTHING_RAD_S, dt_s)
    sensors.configure(p.sensors, config, dt_s)
    p.sensors.mount_angle_rad = config.imu.mount_angle_rad
    p.sensors.radius_by_track = config.model.wheel_radius_m / config.model.track_m
    p.sensors.rolling_radius_m = config.model.wheel_radius_m
    p.sensors.lever_m[:] = imu_lever(config)
    onboard.configure(p.attitude, config, dt_s)
    health.configure(p.health, config, dt_s, (p.sensors.radius_by_track, -p.sensors.radius_by_track))
    p.battery_hold_ticks = round(BATTERY_HOLD_S / dt_s)
    _configure_control(p, config, model[0], dt_s)
    _configure_drive(p.drive, config)
    state = np.zeros(1, robot.STATE).view(np.recarray)
    state[0].battery_v = p.nominal_voltage_v
    states = np.zeros(len(names), robot.ESTIMATOR_STATE).view(np.recarray)
    arrays = (
        (parameters, robot.PARAMETERS),
        (state, robot.STATE),
        (estimator_parameters, robot.ESTIMATOR_PARAMETERS),
        (states, robot.ESTIMATOR_STATE),
    )
    return Robot(
        edumip_frame.LAYOUT, names, config.control.controller, robot.step, arrays, robot.PERSISTENT, robot.ESTIMATOR_PERSISTENT,
        robot.ESTIMATE_BYTES,
    )


def _configure_control(p, config, model, dt_s) -> None:
    c = config.control
    mip_reference.configure(
        p.reference, dt_s, config.model.wheel_radius_m, config.remote.shaping_rad_s, c.turn_rad_m, c.wheel_error_limit_rad,
        c.yaw_error_limit_rad,
    )  # fmt: skip
    f = p.feedback
    f.dt_s, f.slots = dt_s, len(c.lqr.yaw_rates_rad_s)
    for slot, rate in enumerate(c.lqr.yaw_rates_rad_s):
        f.at_rad_s[slot] = rate
        f.gains[slot] = design(config, dt_s, rate)
    f.integral_limit_rad_s = c.integral_limit_rad_s
    f.speed_feedforward = model.damping_n_m_s_rad / model.torque_per_command_n_m
    f.yaw_feedforward = f.speed_feedforward * model.track_m / (2.0 * model.wheel_radius_m)
    f.yaw, f.yaw_rate = c.yaw.gain, c.yaw.rate_gain
    s = getattr(c.filters, c.filter_set)
    rate_hz = 1.0 / dt_s
    successive_loop.configure_filter(p.loops.inner, s.inner_numerator, s.inner_denominator, s.inner_gain, 1.0, s.made_hz, rate_hz)
    successive_loop.configure_filter(
        p.loops.outer, s.outer_numerator, s.outer_denominator, s.outer_gain, c.lean_limit_rad, s.made_hz, rate_hz
    )
    lean = mip_yaw.coefficients(model).tilt[0]
    p.loops.spin_s2_rad2 = lean[2] / lean[0] if c.spin_gain else 0.0
    p.pid.dt_s = dt_s
    for name in ("lean", "lean_rate", "place", "speed", "integral", "yaw", "yaw_rate"):
        p.pid[name] = getattr(c.pid, name)
    p.pid.integral_limit_m_s = c.integral_limit_rad_s * config.model.wheel_radius_m


def _configure_drive(d, config) -> None:
    motor, friction = config.motor, config.friction
    level = friction.level * friction.coulomb_n_m / config.model.torque_per_command_n_m
    d.friction_level = level if friction.compensation else 0.0
    d.friction_smoothing_s_rad = friction.smoothing_s_rad
    d.half_track_in_radii = 0.5 * config.model.track_m / config.model.wheel_radius_m
    d.steering_limit = config.limits.steering
    d.drive = {"coast": wheel_drive.DRIVE_COAST, "brake": wheel_drive.DRIVE_BRAKE}[motor.drive]
    d.resistance_ohm, d.torque_constant_n_m_a = motor.resistance_ohm, motor.torque_constant_n_m_a
    d.nominal_voltage_v, d.diode_drop_v = motor.nominal_voltage_v, motor.diode_drop_v
    d.time_ratio = motor.resistance_ohm / (motor.inductance_h * motor.pwm_frequency_hz)
    d.command_limit = config.limits.duty
    d.period_ns = round(1e9 / motor.pwm_frequency_hz)
    d.motor_sign[:] = config.motors.signs
