"""Builds the MBBR from a configuration: parameter records, state records and the bound step. Runs once, before the loop."""

import numpy as np

from mip_rt import frame
from mip_rt.controllers import gain_schedule, reference, spin_down, state_feedback, wheel_drive
from mip_rt.controllers.filters import pole_from_rate
from mip_rt.errors import ConfigError
from mip_rt.estimators import mbbr_ekf, mbbr_kf, momentum_observer
from mip_rt.models import mbbr, mbbr_linear, mbbr_yaw
from mip_rt.robots import mbbr as robot
from mip_rt.robots import health, mbbr_frame, onboard, sensors
from mip_rt.robots.mbbr_judge import Judge  # noqa: F401  (part of what a setup module offers)
from mip_rt.robots.robot import BATTERY_HOLD_S, BATTERY_SMOOTHING_RAD_S, Robot, noise, orthonormal

# name: (kind, DMP attitude to the controller, model variant or None for the configured one, yaw rotation)
ESTIMATORS = {
    "ekf": (robot.KIND_EKF, 0, None, True),
    "ekf_printed": (robot.KIND_EKF, 0, "printed", True),
    "ekf_flown": (robot.KIND_EKF, 0, "flown", True),
    "kf": (robot.KIND_KF, 0, None, True),
    "kf_printed": (robot.KIND_KF, 0, None, False),
    "dmp_ekf": (robot.KIND_EKF, 1, None, True),
    "dmp_kf": (robot.KIND_KF, 1, None, True),
    "momentum": (robot.KIND_MOMENTUM, 0, None, True),
}
CONTROLLER = "state_feedback"
FRAME = robot.FRAME


def model_parameters(config):
    """Record of models.mbbr.PARAMETERS from the configuration's model section."""
    m = config.model
    return mbbr.parameters(
        body_mass_kg=m.body_mass_kg,
        ball_mass_kg=m.ball_mass_kg,
        ball_radius_m=m.ball_radius_m,
        wheel_radius_m=m.wheel_radius_m,
        com_height_m=m.com_height_m,
        body_inertia_kg_m2=m.body_inertia_kg_m2,
        ball_inertia_kg_m2=m.ball_inertia_kg_m2,
        wheel_inertia_kg_m2=m.wheel_inertia_kg_m2,
        torque_per_command_n_m=m.torque_per_command_n_m,
        damping_n_m_s_rad=m.damping_n_m_s_rad + config.friction.viscous_n_m_s_rad,
        gravity_m_s2=m.gravity_m_s2,
        imu_position_m=config.imu.position_m,
    )


def _estimator(p, name, config, model, dt_s) -> None:
    kind, dmp_attitude, variant, rotation = ESTIMATORS[name]
    p.kind, p.dmp_attitude = kind, dmp_attitude
    e = config.estimator
    gyro, encoder, accelerometer = e.measurement_noise
    q = getattr(e.process_noise, e.noise_set)
    if kind == robot.KIND_EKF:
        process = [q[0]] * 2 + [q[1]] + [q[2]] * 2 + [q[3]] * 2 + [q[4]] + [q[5]] * 2 + [q[6]] * 3
        measurement = [gyro] * 3 + [encoder] * 3 + [accelerometer] * 2
        noise(p.ekf.noise, config, process, measurement, e.initial_covariance, mbbr_ekf.STATES, dt_s)
        p.ekf.model = mbbr_yaw.coefficients(model[0], variant or config.model.variant)[0]
    elif kind == robot.KIND_MOMENTUM:
        momentum_observer.configure(p.momentum, model[0], dt_s, gyro, encoder, e.gate_sigma, config.imu.gyro_delay_s)
    else:
        process = e.kf_process_noise
        measurement = [gyro] * 2 + [encoder] * 2 + [accelerometer] * 2
        noise(p.kf.noise, config, process, measurement, e.initial_covariance, mbbr_kf.STATES, dt_s)
        A, B, C, D = mbbr_linear.linear_matrices(model[0])
        mbbr_kf.configure_model(p.kf.model, A, B, C, D, rotation)


def build(config, shadows=None) -> Robot:
    """The robot of this configuration.

    Raises:
        ConfigError: more estimators than slots.
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
    p.dt_s, p.tip_rad = dt_s, config.limits.tip_rad
    p.nominal_voltage_v = config.motor.nominal_voltage_v
    p.odometry = 1 if config.estimator.odometry == "encoders" else 0
    p.battery_pole = pole_from_rate(BATTERY_SMOOTHING_RAD_S, dt_s)
    p.battery_hold_ticks = round(BATTERY_HOLD_S / dt_s)
    _configure_sensors(p.sensors, config, dt_s)
    onboard.configure(p.attitude, config, dt_s)
    _configure_control(p, config, dt_s)
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
        mbbr_frame.LAYOUT, names, CONTROLLER, robot.step, arrays, robot.PERSISTENT, robot.ESTIMATOR_PERSISTENT, robot.ESTIMATE_BYTES
    )


def _configure_sensors(p, config, dt_s) -> None:
    sensors.configure(p, config, dt_s)
    p.body_from_wheel[:] = orthonormal(config.wheels.body_from_wheel)
    p.rolling_radius_m, p.lever_m[:] = config.model.ball_radius_m, config.imu.position_m
    p.wheel_ratio = config.model.wheel_radius_m / config.model.ball_radius_m


def _configure_control(p, config, dt_s) -> None:
    c, motor = config.control, config.motor
    reference.configure(
        p.reference, dt_s, config.model.ball_radius_m, config.remote.shaping_rad_s, c.angle_error_limit_rad,
        c.yaw_error_limit_rad,
    )  # fmt: skip
    schedule = [(slot.yaw_rate_hz, getattr(c.gain_sets, slot.set)) for slot in c.schedule]
    gain_schedule.configure(p.schedule, schedule, c.blend_rad_s, dt_s)
    state_feedback.configure(p.feedback, dt_s, c.filter_frame, c.lean_limit_rad, c.lean_rate_limit_rad_s)
    spin_down.configure(p.spin_down, config.limits.spin_down, config.limits.spin_resume)
    yaw_from_wheel = p.sensors.wheel_ratio * p.sensors.body_from_wheel[2]  # row z: the ball's turn in the body, the opposite of the yaw
    health.configure(p.health, config, dt_s, yaw_from_wheel)
    d = p.drive
    d.body_from_wheel[:] = p.sensors.body_from_wheel
    d.wheel_ratio = p.sensors.wheel_ratio
    friction = config.friction
    level = friction.level * friction.coulomb_n_m / config.model.torque_per_command_n_m
    d.friction_level = level if friction.compensation else 0.0
    d.friction_smoothing_s_rad = friction.smoothing_s_rad
    d.drive = {"coast": wheel_drive.DRIVE_COAST, "brake": wheel_drive.DRIVE_BRAKE}[motor.drive]
    d.resistance_ohm, d.torque_constant_n_m_a = motor.resistance_ohm, motor.torque_constant_n_m_a
    d.nominal_voltage_v, d.diode_drop_v = motor.nominal_voltage_v, motor.diode_drop_v
    d.time_ratio = motor.resistance_ohm / (motor.inductance_h * motor.pwm_frequency_hz)
    d.command_limit = config.limits.duty
    d.period_ns = round(1e9 / motor.pwm_frequency_hz)
    d.motor_sign[:] = config.motors.signs
