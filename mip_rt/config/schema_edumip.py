"""The schema of the eduMIP: its own sections, and what it shares with the MBBR taken from there.

Sources of the numbers: dissertation (T) Tables 3.2, 3.3, chapter 3; the public eduMIP balance program (P) for pins, counts and limits.
"""

import math
from dataclasses import replace

from mip_rt.config.fields import Choice, Flag, Integer, Named, Number, Rows, Several, matrix, numbers
from mip_rt.config.schema import DRY_RUN as MBBR_DRY_RUN
from mip_rt.config.schema import MBBR, PAPER_NAME

N, I, F = Number, Integer, Flag
ESTIMATORS = ("ekf", "ekf_printed", "planar_kf", "complementary", "complementary_kf", "dmp", "dmp_ekf", "inertial_ekf", "pendulum_ekf",
              "two_state_ekf")  # fmt: skip
_D = {
    "inner_numerator": (-4.945, 8.862, -3.967),
    "inner_denominator": (1.0, -1.481, 0.4812),
    "outer_numerator": (0.18856, -0.37209, 0.18354),
    "outer_denominator": (1.0, -1.86046, 0.86046),
}
FILTERS = {
    "dissertation": {**_D, "inner_gain": 1.0, "outer_gain": 1.0, "made_hz": 200.0},
    "public": {**_D, "inner_gain": 1.05, "outer_gain": 0.9, "made_hz": 100.0},
}
PROCESS_NOISE = {
    "paper": ((1e-11, 1e-7, 1e-7, 1e-5, 1e-7, 1e-7), "T 3.48"),
    "driving": ((1e-9, 1e-7, 1e-7, 0.1, 1.0, 0.1), "ours: commands are wrong by friction and delay, so rates follow their sensors"),
}
LEVELS = tuple(
    {"button": button, "yaw_rate_hz": float(f"{rate / (2.0 * math.pi):.9g}"), "drive_limit_m_s": 0.35}
    for button, rate in (("none", 0.0), ("square", 5.0), ("triangle", 10.0), ("circle", 15.0), ("cross", -5.0))
)

MODEL = {
    "body_mass_kg": N(0.218, "Body without wheels, m_b (T Table 3.2).", unit="kg", low=0.01, high=50),
    "wheel_mass_kg": N(0.024, "One wheel, m_w.", unit="kg", low=0.0001, high=20),
    "wheel_radius_m": N(0.035, "Wheel radius r.", unit="m", low=0.005, high=0.5),
    "track_m": N(0.070, "Between the wheels, d.", unit="m", low=0.01, high=2),
    "com_height_m": N(0.046, "Body's centre of mass above the axle, l.", unit="m", low=0.005, high=2),
    "body_inertia_kg_m2": numbers((5.91e-4, 2.99e-4, 2.91e-4), "Body about its centre of mass, axes left, back, up.", 3, low=1e-8, high=50),
    "wheel_inertia_kg_m2": numbers((6.42e-5, 7.48e-6, 7.48e-6), "One wheel, first about the axle.", 3, low=0, high=5),
    "wheel_inertia_reading": Choice("rigid", "All of it turns with the wheel, or what a disc cannot have is the geared rotor's.",
                                    choices=("rigid", "rotor")),
    "torque_per_command_n_m": N(0.12, "Torque of a wheel at a command of 1, k1.", low=1e-4, high=100),
    "damping_n_m_s_rad": N(0.003, "Back-EMF damping of a wheel, k2.", low=0, high=10),
    "gravity_m_s2": N(9.8, "Gravity.", low=1, high=20),
    "variant": Choice("exact", "Model of the EKF: exact, the paper's derivation, or its printed digits.", choices=("exact", "thesis", "printed")),
}  # fmt: skip

_NO_SUCH = ("vibration_torque_n_m", "vibration_accel_m_s2", "rollers_per_ball_turn", "initial_lean_rad", "gyro_noise_rad_s", "accel_noise_m_s2",
            "backlash_rad", "imu_position_error_m", "roller_ripple_rad", "rolling_resistance_n_m", "input_error")  # fmt: skip
DRY_RUN = {
    "initial_lean_rad": N(0.03, "Lean at which the operator holds the robot.", unit="rad", low=-0.5, high=0.5),
    "gyro_noise_rad_s": N(0.001752, "Gyro noise, standard deviation (T 3.34).", unit="rad/s", low=0, high=1),
    "accel_noise_m_s2": N(0.0738, "Accelerometer noise (T 3.49).", low=0, high=20),
    "imu_position_error_m": numbers((0.0, 0.0, 0.0), "True position of the IMU less imu.position_m.", 3, "m", -0.1, 0.1),
    "wheel_inertia_reading": Choice("model", "Reading of the wheel inertia that is true: the model's, or one of the two.",
                                    choices=("model", "rigid", "rotor")),
    "backlash_rad": N(0.005, "Half the backlash between wheel and encoder; 0 switches it off.", unit="rad", low=0, high=0.5),
    **{key: field for key, field in MBBR_DRY_RUN.items() if key not in _NO_SUCH},
}  # fmt: skip

_FILTER = {
    **{key: numbers(value, "In powers of z, highest first.", 3, low=-1000, high=1000) for key, value in _D.items()},
    "inner_gain": N(1.0, "Gain on D1.", low=-100, high=100),
    "outer_gain": N(1.0, "Gain on D2.", low=-100, high=100),
    "made_hz": N(200.0, "Sample rate that the coefficients are for; they are carried over to the rate in use.", unit="Hz", low=10, high=10000),
}
CONTROL = {
    "controller": Choice("lqr", "State feedback designed from the model, successive loops (T 3.50), or the composite PID of Lee and Jung.",
                         choices=("lqr", "successive_loop", "pid")),
    "lqr": {
        "yaw_rates_rad_s": Several((0.0, 5.0, 10.0, 15.0, 20.0), "Gains are designed at these yaw rates.", most=8,
                                   item=N(0.0, "", unit="rad/s", low=0, high=60)),
        "pitch_rad": N(0.1, "Tolerated lean: the smaller, the more it counts.", unit="rad", low=1e-4, high=1e4),
        "wheel_rad": N(1.0, "Tolerated error of the wheels' angle.", unit="rad", low=1e-4, high=1e6),
        "pitch_rate_rad_s": N(2.0, "Tolerated lean rate.", unit="rad/s", low=1e-4, high=1e6),
        "wheel_rate_rad_s": N(20.0, "Tolerated error of the wheels' rate.", unit="rad/s", low=1e-4, high=1e6),
        "integral_rad_s": N(3.0, "Tolerated integral of the wheel angle's error.", low=1e-4, high=1e6),
        "command": N(0.1, "Tolerated command.", low=1e-4, high=1e4),
    },
    "filter_set": replace(PAPER_NAME, default="dissertation", doc="Filters of the successive loops in use."),
    "filters": Named(FILTERS, "D1 and D2 of the successive loops by name.", entry=_FILTER),
    "spin_gain": F(True, "Successive loops: D1 grows with the yaw rate as the centrifugal force on the leaning body does; false: as in the papers."),
    "pid": {
        "lean": N(3.0, "Command a rad of lean.", low=-1000, high=1000),
        "lean_rate": N(0.2, "Command a rad/s.", low=-1000, high=1000),
        "place": N(3.0, "Command a metre of place along the heading.", low=-1000, high=1000),
        "speed": N(2.0, "Command a m/s.", low=-1000, high=1000),
        "integral": N(1.5, "Command a metre second.", low=-1000, high=1000),
        "yaw": N(1.0, "Command a rad of heading.", low=-1000, high=1000),
        "yaw_rate": N(0.05, "Command a rad/s of yaw.", low=-1000, high=1000),
    },
    "yaw": {
        "gain": N(1.0, "PD on the heading of the other two controllers (T 3.52).", low=0, high=1000),
        "rate_gain": N(0.05, "Its rate gain.", low=0, high=1000),
    },
    "lean_limit_rad": N(0.4, "Largest lean reference of the outer loop.", unit="rad", low=0.01, high=1),
    "wheel_error_limit_rad": N(6.0, "The place reference waits when the wheels are this far behind.", unit="rad", low=0.5, high=1000),
    "yaw_error_limit_rad": N(1.5, "Likewise the heading reference.", unit="rad", low=0.1, high=1000),
    "integral_limit_rad_s": N(2.0, "Largest integral of the wheel angle's error.", low=0, high=1000),
    "turn_rad_m": N(17.0, "Stick to the left: turning rate for each m/s that it would mean forward.", low=0, high=1000),
    "soft_start_s": N(0.3, "The command grows to its full size within this time.", unit="s", low=0, high=5),
}  # fmt: skip

EDUMIP = {
    "robot": Choice("edumip", "The robot.", choices=("edumip",)),
    "board": Choice("beaglebone-blue", "Pin table; auto asks the device tree.", choices=MBBR["board"].choices),
    "model": MODEL,
    "motor": {
        **MBBR["motor"],
        "resistance_ohm": N(13.3333, "Winding, R = k V / k1 of T Table 3.2 (T chapter 4 measured 9.06).", unit="ohm", low=0.01, high=1000),
        "inductance_h": N(2.36e-3, "Winding, L.", unit="H", low=1e-7, high=1),
        "torque_constant_n_m_a": N(0.2, "At the wheel, gear included, k = k2 V / k1 (T chapter 4 measured 0.127).", low=1e-4, high=10),
        "drive": Choice("brake", "What the bridge does between pulses; the TB6612 brakes.", choices=("coast", "brake")),
    },
    "motors": {
        "channels": Several((2, 3), "Motor output of the right and the left wheel (P).", item=I(1, "", low=1, high=4), length=2),
        "signs": Several((-1, 1), "Sign of each, found by mip-rt doctor by motion (P).", item=I(1, "", low=-1, high=1), length=2),
    },
    "encoders": {
        "channels": Several((2, 3), "eQEP of the right and the left wheel (P).", item=I(1, "", low=1, high=3), length=2),
        "signs": Several((-1, 1), "Sign of each (P).", item=I(1, "", low=-1, high=1), length=2),
        "counts_per_turn": I(2135, "Counts a turn of the wheel: 60 edges times the gear of 35.577 (P).", low=4, high=1000000),
    },
    "friction": {
        "coulomb_n_m": N(0.003, "Coulomb friction of a wheel (ours: a fortieth of the stall torque).", low=0, high=10),
        "viscous_n_m_s_rad": N(0.0, "Viscous friction of a wheel; the estimators add it to the damping.", low=0, high=10),
        **{key: MBBR["friction"][key] for key in ("compensation", "level", "smoothing_s_rad")},
    },
    "imu": {
        **MBBR["imu"],
        "mounting": matrix(((1, 0, 0), (0, 0, -1), (0, 1, 0)), "Board axes (left, back, up) from chip axes, row by row."),
        "mount_angle_rad": N(0.49, "The board leans back by this against the body: added to the lean that the IMU sees (P).", unit="rad", low=-1.6, high=1.6),
        "position_m": numbers((0.0, -0.016, 0.0), "IMU from the centre of mass, axes left, back, up; 16 mm explain T Table 3.3.", 3, "m", -1, 1),
    },
    "battery": MBBR["battery"],
    "estimator": {
        "control": Choice("dmp_ekf", "Estimator that controls.", choices=ESTIMATORS),
        "shadows": Several(("ekf", "planar_kf", "dmp"), "Estimators that run beside it and are logged.",
                           item=Choice("", "", choices=ESTIMATORS), most=7),
        "lever_arm": F(True, "EKF: the accelerometer sits at imu.position_m; false: in the centre of mass, as in the papers."),
        "noise_set": Choice("driving", "Process noise of the EKF in use.", choices=tuple(PROCESS_NOISE)),
        "process_noise": {
            name: numbers(values, f"Variance a 5 ms step of lean, wheel angle, yaw and their rates ({source}).", 6, low=0, high=1e6)
            for name, (values, source) in PROCESS_NOISE.items()
        },
        "measurement_noise": numbers((1e-5, 2.62e-7, 5.44e-3, 1e-5), "Variances of wheel angle, gyro, accelerometer, yaw (T 3.49).", 4, low=1e-15, high=1e6),
        "planar_process_noise": numbers((1e-11, 1e-7, 1e-5, 1e-7), "Variance a 5 ms step of the planar KF's states (T 3.33).", 4, low=0, high=1e6),
        "planar_measurement_noise": numbers((1e-5, 3.07e-6, 3.04e-3), "Variances of wheel angle, gyro, accelerometer (T 3.34).", 3, low=1e-15, high=1e6),
        "corner_rad_s": N(4.0, "Complementary filter: gyro above, accelerometer below.", unit="rad/s", low=0.01, high=100),
        "complementary_kf_noise": numbers((1e-8, 1e-10, 1e-4), "Variances a 5 ms step of lean and bias, and of the measured lean (T 3.38).", 3, low=0, high=1e6),
        "pendulum_process_noise": numbers((0.0, 1e-6, 1.0), "Variance a 5 ms step of the pendulum EKF's lean, rate, acceleration (Aoyagi, Choi; last ours).",
                                          3, low=0, high=1e6),
        "pendulum_measurement_noise": numbers((2e-6, 1e-3, 1e-3), "Variances of gyro and accelerometer y, z (Aoyagi and Choi).", 3, low=1e-15, high=1e6),
        "two_state_process_noise": numbers((1e-6, 1e-2), "Variance a 5 ms step of the 2-state EKF's lean and rate (ours).", 2, low=0, high=1e6),
        "two_state_measurement_noise": numbers((2.5e-3, 2.5e-3, 4e-4), "Variances of the direction of gravity, sine and cosine, and of the gyro (ours).",
                                               3, low=1e-15, high=1e6),
        **{key: MBBR["estimator"][key] for key in ("initial_covariance", "covariance_limit")},
        "gate_sigma": N(100.0, "An innovation beyond so many standard deviations is refused; narrow gates mistake a late command for a sick sensor.",
                        low=1, high=1e6),
    },
    "control": CONTROL,
    "remote": {
        **MBBR["remote"],
        "levels": Rows(LEVELS, "Held button: spin and drive limit.", entry=MBBR["remote"]["levels"].entry),
    },
    "limits": {
        **{key: field for key, field in MBBR["limits"].items() if not key.startswith("spin_")},
        "tip_rad": N(0.85, "Motors off beyond this lean (P).", unit="rad", low=0.1, high=1.4),
        "steering": N(0.5, "Largest part of the command that steers (P).", low=0.05, high=1),
    },
    "realtime": {
        **MBBR["realtime"],
        "rate_hz": N(200.0, "Rate of the IMU's packets and of the loop: 200, or 100 as in (P).", unit="Hz", low=100, high=200),
    },
    **{key: section for key, section in MBBR.items() if key not in
       ("robot", "board", "model", "wheels", "motor", "motors", "encoders", "friction", "imu", "battery", "estimator", "control", "remote",
        "limits", "realtime", "dry_run")},
    "dry_run": DRY_RUN,
}  # fmt: skip
