"""The schema of the MBBR: every key with kind, unit, range, shipped value and one sentence. The only place that knows them.

Sources of the numbers: dissertation (T) Tables 2.1, 5.2, 6.2, 6.3, (6.16), (6.21) to (6.32); the robot author's program (A). Gain and
noise sets are in `published.py`.
"""

from mip_rt.config import published
from mip_rt.config.fields import Choice, Flag, Integer, Named, Number, Rows, Several, Text, matrix, numbers
from mip_rt.hardware import boards

N, I, F = Number, Integer, Flag
PAPER_NAME = Text("", "", pattern="[A-Za-z0-9_][A-Za-z0-9_.-]*", wanted="a name of letters, digits, _ . -")

MODEL = {
    "body_mass_kg": N(0.55, "Body without ball, m_t (T Table 5.2).", unit="kg", low=0.01, high=50),
    "ball_mass_kg": N(0.15, "Ball, m_b.", unit="kg", low=0.001, high=20),
    "ball_radius_m": N(0.032, "Ball radius r.", unit="m", low=0.005, high=0.5),
    "wheel_radius_m": N(0.0125, "Omniwheel radius r_w.", unit="m", low=0.002, high=0.2),
    "com_height_m": N(0.1, "Body's centre of mass above the ball's centre, l.", unit="m", low=0.01, high=2),
    "body_inertia_kg_m2": numbers((2.42e-3, 2.42e-3, 0.79e-3), "Body about its centre of mass, axes x, y, z.", 3, low=1e-7, high=50),
    "ball_inertia_kg_m2": N(8.46e-5, "Ball, I_b.", low=1e-8, high=5),
    "wheel_inertia_kg_m2": N(1.2e-5, "One wheel with its rotor, I_w; times (r/r_w)^2 as seen by the ball.", low=0, high=1),
    "torque_per_command_n_m": N(0.176, "Torque of a body command of 1, k1.", low=1e-4, high=100),
    "damping_n_m_s_rad": N(0.011, "Back-EMF damping as seen by the ball, K2 = k2 (r/r_w)^2.", low=0, high=10),
    "gravity_m_s2": N(9.8, "Gravity.", low=1, high=20),
    "variant": Choice("exact", "Model of the estimators: exact, the paper's derivation, its printed digits, or those that its robot flew.",
                      choices=("exact", "inertial-lagrange", "printed", "flown")),
}  # fmt: skip

# What `mip-rt calibrate` finds of one unit's IMU; its file takes the place of these values.
UNIT_IMU = {
    "accel_gain": numbers((1.0, 1.0, 1.0), "Accelerometer, chip axes: true = gain * measured - offset.", 3, low=0.8, high=1.25),
    "accel_offset_m_s2": numbers((0.0, 0.0, 0.0), "Offset of the accelerometer, chip axes, after the gain.", 3, "m/s^2", -2, 2),
    "level_rad": numbers((0.0, 0.0), "Roll and pitch that the IMU shows while the body's lean is zero.", 2, "rad", -0.2, 0.2),
}

DRY_RUN = {
    "initial_lean_rad": numbers((0.03, -0.02), "Roll and pitch at which the operator holds the robot.", 2, "rad", -0.5, 0.5),
    "gyro_noise_rad_s": N(0.001442, "Gyro noise, standard deviation (T 6.23).", unit="rad/s", low=0, high=1),
    "gyro_bias_rad_s": numbers((0.010, -0.006, 0.004), "Gyro bias, body axes; removed by calibration.", 3, "rad/s", -1, 1),
    "gyro_drift_rad_s2": numbers((0.0, 0.0, 0.0), "Drift of the gyro's bias, body axes, as the chip warms up.", 3, "rad/s^2", -0.1, 0.1),
    "accel_noise_m_s2": N(0.2655, "Accelerometer noise; (T 6.23) is 20 times the measured variance (A).", low=0, high=20),
    "accel_bias_m_s2": numbers((0.0, 0.0, 0.0), "Accelerometer bias, body axes.", 3, low=-5, high=5),
    "imu_misalignment_rad": numbers((0.0, 0.0, 0.0), "Mounting error of the IMU as a rotation vector.", 3, "rad", -0.5, 0.5),
    "imu_position_error_m": numbers((0.0, 0.0, 0.0), "True position of the IMU less imu.position_m.", 3, "m", -0.1, 0.1),
    "vibration_torque_n_m": N(0.004, "Roller vibration: torque amplitude a wheel at 10 rad/s of the ball.", low=0, high=1),
    "vibration_accel_m_s2": N(0.3, "Roller vibration felt by the accelerometer at 10 rad/s.", low=0, high=20),
    "rollers_per_ball_turn": N(6.26, "Roller hand-overs a radian of the ball; the lines of T Fig. 6.24 are at 4.2 to 4.5.", low=0, high=200),
    "roller_ripple_rad": N(0.0, "Amplitude of what a ball-side wheel angle gains and loses at each hand-over: unevenness that encoders take for motion.",
                           unit="rad", low=0, high=0.1),
    "rolling_resistance_n_m": N(0.0, "Torque with which the floor resists the rolling ball.", low=0, high=0.1),
    "input_error": numbers((0.0, 0.0, 0.0), "Constant torque on the ball, body axes, that nobody commanded, as a body command.", 3, low=-1, high=1),
    "dmp_lag_s": N(0.005, "Time constant of the DMP's attitude.", unit="s", low=0, high=0.2),
    "dmp_offset_rad": numbers((0.0, 0.0), "Constant error of the DMP's roll and pitch.", 2, "rad", -0.3, 0.3),
    "dmp_noise_rad": N(0.003, "Wandering error of the DMP's tilt, standard deviation an axis.", unit="rad", low=0, high=0.3),
    "dmp_noise_time_s": N(1.0, "Time constant of that wandering.", unit="s", low=0.005, high=1000),
    "dmp_yaw_drift_rad_s": N(0.0005, "Drift of the DMP's yaw.", unit="rad/s", low=-0.1, high=0.1),
    "friction": N(1.0, "Friction of the plant as a multiple of the friction section; 0 switches it off.", low=0, high=5),
    "backlash_rad": N(0.0, "Half the backlash between wheel and encoder; 0 switches it off.", unit="rad", low=0, high=0.5),
    "battery_v": N(7.9, "Battery at the start.", unit="V", low=3, high=20),
    "battery_resistance_ohm": N(0.15, "Internal resistance: the voltage sags with the current.", unit="ohm", low=0, high=5),
    "battery_fade_v_s": N(1e-4, "Discharge.", low=0, high=1),
    "kernel": Choice("5.10-ti", "Generation of kernels whose interfaces the simulated board shows.", choices=("4.19-ti", "5.10-ti", "6.12-bone")),
    "actuation_delay_ms": I(1, "Milliseconds between the interrupt and the new duty.", low=0, high=5),
    "extra_delay_ticks": I(0, "Further whole ticks of delay.", low=0, high=3),
    "model_error": {
        name: N(1.0, f"True {what} as a multiple of the model's.", low=0.3, high=3)
        for name, what in (("mass", "masses"), ("inertia", "inertias"), ("com_height", "height of the centre of mass"),
                           ("friction", "friction"), ("motor", "motor constant"))
    },
}  # fmt: skip

MBBR = {
    "robot": Choice("mbbr", "The robot.", choices=("mbbr",)),
    "board": Choice("beaglebone-black-cape", "Pin table; auto asks the device tree.",
                    choices=("auto", *boards.NAMES)),
    "model": MODEL,
    "wheels": {
        "body_from_wheel": matrix(published.BODY_FROM_WHEEL, "T_ob: columns are the wheels' axes in body axes (T 6.5, corrected)."),
    },
    "motor": {
        "resistance_ohm": N(3.385, "Winding, R (T 6.16).", unit="ohm", low=0.01, high=1000),
        "inductance_h": N(0.585e-3, "Winding, L.", unit="H", low=1e-7, high=1),
        "torque_constant_n_m_a": N(0.0742, "At the wheel, gear included, k.", low=1e-4, high=10),
        "nominal_voltage_v": N(8.0, "Voltage that a command of 1 stands for.", unit="V", low=1, high=60),
        "drive": Choice("coast", "What the bridge does between pulses.", choices=("coast", "brake")),
        "pwm_frequency_hz": N(20000.0, "PWM frequency; at most 20 kHz for an MC33926.", unit="Hz", low=500, high=100000),
        "diode_drop_v": N(0.0, "Drop of one freewheeling diode.", unit="V", low=0, high=2),
    },
    "motors": {
        "channels": Several((1, 3, 4), "Motor output of wheels 1 to 3 (A).", item=I(1, "", low=1, high=4), length=3),
        "signs": Several((1, -1, 1), "Sign of each, found by mip-rt doctor by motion (A).", item=I(1, "", low=-1, high=1), length=3),
    },
    "encoders": {
        "channels": Several((1, 2, 3), "eQEP of wheels 1 to 3 (A).", item=I(1, "", low=1, high=3), length=3),
        "signs": Several((-1, 1, 1), "Sign of each (A).", item=I(1, "", low=-1, high=1), length=3),
        "counts_per_turn": I(1080, "Counts a turn of the wheel, all four edges (A).", low=4, high=1000000),
    },
    "friction": {
        "coulomb_n_m": N(0.05265, "Coulomb friction an axis of the ball (T 5.36).", low=0, high=10),
        "viscous_n_m_s_rad": N(0.001056, "Viscous friction (T 5.36); the estimators add it to the damping.", low=0, high=10),
        "compensation": F(True, "Add the command that cancels Coulomb friction (T 6.14)."),
        "level": N(1.0, "Share of the Coulomb friction that is compensated.", low=0, high=2),
        "smoothing_s_rad": N(2.0, "k of 1 - exp(-k |rate|) (T 6.15).", low=0.01, high=1000),
    },
    "imu": {
        "attitude": Choice("dmp", "Attitude (also that of the estimators dmp_*): InvenSense's DMP, or our filter on the raw registers, no image needed.",
                           choices=("dmp", "onboard")),
        "gyro_delay_s": N(0.0, "Delay of the gyro's low-pass that our own filters make good; a real chip's is 0.0029 at 184 Hz.",
                          unit="s", low=0, high=0.02),
        "bus": I(2, "I2C bus.", low=0, high=32),
        "address": I(0x68, "I2C address.", low=3, high=0x77),
        "accel_range_g": I(8, "Accelerometer range, 2, 4, 8 or 16 g.", low=2, high=16),
        "gyro_range_dps": I(2000, "Gyro range: 250, 500, 1000 or 2000 deg/s; the DMP integrates rightly only at 2000.", low=250, high=2000),
        "dlpf_hz": I(184, "Low-pass filter of the chip: 5, 10, 20, 41, 92 or 184 Hz.", low=5, high=184),
        "dmp_image": Text("/var/lib/mip-rt/dmp.bin", "InvenSense's DMP image (3062 bytes); it cannot be shipped.", wanted="a path"),
        "dmp_image_sha256": Text(published.DMP_SHA256, "Its SHA-256.", pattern="[0-9a-f]{64}", wanted="64 hexadecimal digits"),
        "dmp_orientation": Choice("y_up", "Which chip axis points up (A).",
                                  choices=("z_up", "z_down", "x_up", "x_down", "y_up", "y_down", "x_forward", "x_back")),
        "mounting": matrix(((1, 0, 0), (0, 0, -1), (0, 1, 0)), "Body axes from chip axes, row by row, for accelerometer and gyro."),
        **UNIT_IMU,
        "position_m": numbers((0.0, 0.0, 0.130), "IMU from the ball's centre, body axes, l_a.", 3, "m", -1, 1),
        "calibration_file": Text("/var/lib/mip-rt/calibration.json", "This unit's calibration; without it the bias measured at the start counts alone.",
                                 wanted="a path"),
        "interrupt_latched": F(False, "Latch the interrupt until a register is read, instead of a 50 us pulse."),
    },
    "battery": {
        "adc_channel": I(6, "ADC channel.", low=0, high=7),
        "ratio": N(11.0, "Divider.", low=1, high=100),
        "offset_v": N(-0.10, "Added after the divider.", unit="V", low=-2, high=2),
        "plausible_v": numbers((5.0, 9.0), "Readings outside are no readings.", 2, "V", 0, 60),
        "warn_v": N(6.6, "Warn below.", unit="V", low=0, high=60),
        "minimum_v": N(6.4, "Do not arm below; while balancing, drive commands shrink to nothing between this and cutoff_v.",
                       unit="V", low=0, high=60),
        "cutoff_v": N(5.5, "Below for 2 s, smoothed and under load: motors off.", unit="V", low=0, high=60),
    },
    "estimator": {
        "control": Choice("dmp_ekf", "Estimator that controls; momentum is ours, from gyro and encoders alone.", choices=published.ESTIMATORS),
        "shadows": Several(("ekf", "kf", "dmp_kf"), "Estimators that run beside it and are logged.",
                           item=Choice("", "", choices=published.ESTIMATORS), most=7),
        "odometry": Choice("encoders", "Ball position: from encoders and gyro, or by integrating the filter's ball rate as in T.",
                           choices=("encoders", "filter")),
        "noise_set": Choice("driving", "Process noise in use.", choices=tuple(published.PROCESS_NOISE)),
        "process_noise": {
            name: numbers(values, f"Variance a 5 ms step: q1=q2, q3, q4=q5, q6=q7, q8, q9=q10, q11=q12=q13 ({source}).", 7, low=0, high=1e6)
            for name, (values, source) in published.PROCESS_NOISE.items()
        },
        "kf_process_noise": numbers(published.KF_PROCESS_NOISE, "Variance a step of the 8 states of the KF (T 6.32).", 8, low=0, high=1e6),
        "measurement_noise": numbers((2.08e-6, 7.62e-5, 1.41), "Variances of gyro, encoder, accelerometer (T 6.23).", 3, low=1e-15, high=1e6),
        "initial_covariance": N(1e-5, "Variance of every state at the start (A).", low=1e-15, high=1e6),
        "covariance_limit": N(10.0, "Largest variance of a state; bounds the unobservable ones.", low=1e-6, high=1e9),
        "gate_sigma": N(8.0, "An innovation beyond so many standard deviations is refused.", low=1, high=1e6),
    },
    "control": {
        "filter_frame": Choice("inertial", "Frame of low-pass and outer loop; yaw is the paper's.", choices=("inertial", "yaw")),
        "schedule": Rows(tuple({"yaw_rate_hz": hz, "set": "rec"} for hz in (0.0, 0.5, 0.75, 1.0, 1.5)), "Gain set by yaw rate.", entry={
            "yaw_rate_hz": N(0.0, "Yaw rate.", unit="Hz", low=0, high=5),
            "set": PAPER_NAME,
        }),
        "blend_rad_s": N(6.0, "Rate at which gains follow the schedule (A).", unit="rad/s", low=0.1, high=1000),
        "lean_limit_rad": N(0.3, "Largest lean reference of the outer loop (A).", unit="rad", low=0.01, high=1),
        "lean_rate_limit_rad_s": N(2.5, "Largest lean rate reference (A).", unit="rad/s", low=0.01, high=100),
        "angle_error_limit_rad": N(10.0, "The position reference waits when the ball is this far behind.", unit="rad", low=0.5, high=1000),
        "yaw_error_limit_rad": N(3.0, "Likewise the heading reference.", unit="rad", low=0.1, high=1000),
        "soft_start_s": N(0.3, "The command grows to its full size within this time.", unit="s", low=0, high=5),
        "gain_sets": Named(published.GAIN_SETS, "State feedback (T 6.10), outer loop (6.13) and low-pass (6.12) by name.", entry={
            **{f"c{i}": N(0.0, f"Gain c{i}.", low=-1000, high=1000) for i in range(1, 7)},
            "slc_gain": N(0.0, "Outer loop's gain c_SLC.", low=-100, high=100),
            "slc_pole": N(0.961, "Outer loop's pole at 200 Hz.", low=0, high=0.99999),
            "lowpass_rad_s": N(0.0, "Low-pass on the ball rate error; 0 is none.", unit="rad/s", low=0, high=1000),
        }),
    },
    "remote": {
        "device": Text("/dev/ttyS5", "Serial port of the Bluetooth module; auto: UART5, whatever its number.", wanted="a path"),
        "baud": I(115200, "Baud rate; an HC-06 as sold has 9600.", low=1200, high=921600),
        "protocol": Choice("fourjoy", "Frame format.", choices=("fourjoy",)),
        "timeout_s": N(0.3, "A remote silent for so long is lost.", unit="s", low=0.05, high=0.45),
        "ramp_s": N(0.15, "Then its command goes to zero within this time.", unit="s", low=0, high=0.45),
        "shaping_rad_s": N(3.0, "Low-pass on the commands (A).", unit="rad/s", low=0.1, high=1000),
        "levels": Rows(published.REMOTE_LEVELS, "Held button: spin and drive limit.", entry={
            "button": Choice("none", "Button.", choices=("none", "square", "triangle", "circle", "cross")),
            "yaw_rate_hz": N(0.0, "Spin.", unit="Hz", low=-5, high=5),
            "drive_limit_m_s": N(0.25, "Speed at full stick.", unit="m/s", low=0.01, high=5),
        }),
    },
    "limits": {
        "tip_rad": N(0.872665, "Motors off beyond this lean.", unit="rad", low=0.1, high=1.4),
        "engage_tilt_rad": N(0.174533, "Balancing starts within this lean.", unit="rad", low=0.01, high=0.5),
        "engage_hold_s": N(0.5, "Held upright for so long.", unit="s", low=0.1, high=10),
        "imu_silence_s": N(0.03, "Motors off after so long without an interrupt.", unit="s", low=0.006, high=0.045),
        "guard_timeout_s": N(0.06, "The guard drops the enable line when the loop's heartbeat is older.", unit="s", low=0.02, high=0.09),
        "duty": N(1.0, "Largest wheel command.", low=0.05, high=1),
        "arming_timeout_s": N(30.0, "Not held upright within this time after the button: disarmed again.", unit="s", low=1, high=600),
        "saturation_s": N(0.4, "Motors off when a wheel command is clipped in one direction for so long.", unit="s", low=0.05, high=10),
        "stall_duty_s": N(0.2, "Motors off when |duty| over a standing count integrates to this.", unit="s", low=0.02, high=10),
        "wheel_mismatch_rad": N(0.2, "Wheels and gyro disagree when their spins over 0.1 s differ by more.", unit="rad", low=0.02, high=10),
        "race_share": N(0.7, "Motors off when a wheel runs for 0.1 s at more than this share of its no-load speed.", low=0.1, high=2),
        "rate_tolerance": N(0.03, "Largest relative error of the IMU's rate.", low=0.001, high=0.5),
        "spin_down": numbers((0.30, 9.0, 15.0), "Errors of lean (rad), ball angle (rad), ball speed (rad/s) that end a spin.", 3, low=0, high=1e6),
        "spin_resume": numbers((0.075, 5.0, 2.5), "Below all of these the spin begins again (A).", 3, low=0, high=1e6),
    },
    "realtime": {
        "rate_hz": N(200.0, "The IMU's rate; the DMP has no other.", unit="Hz", low=200, high=200),
        "policy": Choice("fifo", "Scheduling.", choices=("fifo", "other")),
        "priority": I(40, "SCHED_FIFO priority, below the I2C and GPIO interrupt threads (50).", low=1, high=98),
        "lock_memory": F(True, "Lock all pages."),
        "strict": F(False, "Do not arm where a real-time setting is refused; otherwise that is a warning."),
    },
    "log": {
        "ring_s": N(120.0, "Seconds that the ring holds.", unit="s", low=1, high=3600),
        "folder": Text("/run/mip-rt", "Folder of the ring on the robot, in memory; a dry run uses a temporary one.", wanted="a path"),
        "record": F(True, "Record the ring to disk: on the robot always, in a dry run with --log."),
        "record_folder": Text("/var/lib/mip-rt/log", "Folder of the recorded runs and fault files; --log names another.", wanted="a path"),
        "files": I(16, "Recorded files that are kept over all runs; the oldest make room.", low=2, high=10000),
        "file_mb": N(16.0, "Size of a recorded file in megabytes; an hour is about 500.", low=0.5, high=2000),
        "flush_s": N(0.5, "A power cut costs so much of the log and what the disk needs to write it.", unit="s", low=0.05, high=1),
        "compression": I(1, "zlib level of recorded blocks; 0 stores them as they are.", low=0, high=9),
        "fault_files": I(10, "Fault files that are kept; further ones are refused until some are removed.", low=0, high=1000),
        "fault_before_s": N(30.0, "Time before a fault that its file holds.", unit="s", low=0, high=600),
        "fault_after_s": N(2.0, "Time after a fault that its file holds.", unit="s", low=0, high=60),
    },
    "dry_run": DRY_RUN,
}  # fmt: skip
