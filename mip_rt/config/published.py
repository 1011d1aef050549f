"""Published numbers that the schema ships by name: gains, noise, geometry, the identity of the DMP image.

Gain sets ending in `_printed` are the digits of the dissertation although they fall (a decimal slip each in (6.22) and (6.27): c4 violates
the hard bound of the corrected equations, section E); the set without the ending is the corrected one.
"""

ESTIMATORS = ("ekf", "ekf_printed", "ekf_flown", "kf", "kf_printed", "dmp_kf", "dmp_ekf", "momentum")

# Dissertation (6.5) with 0.5744 corrected to 1/sqrt(3); made orthonormal when used.
BODY_FROM_WHEEL = (
    (-0.73445, 0.05830, 0.67615),
    (0.35671, -0.81441, 0.45770),
    (0.57735, 0.57735, 0.57735),
)

# SHA-256 of InvenSense's MotionDriver 6.12 image; four public copies agree.
DMP_SHA256 = "0058cbb783c93063c86edada212261037ecc2d216ca28aba05cb6b6b2136dcc3"

_KEYS = ("c1", "c2", "c3", "c4", "c5", "c6", "slc_gain", "slc_pole", "lowpass_rad_s")
GAIN_SETS = {
    name: dict(zip(_KEYS, values))
    for name, values in {
        "rec": (20.0, 0.5, 0.6, 0.22, 0.4, 1.2, 0.25, 0.961, 15.0),  # ours, 0 to 1.5 Hz with 0.2 m/s
        "lqr_like": (16.0, 0.34, 1.94, 0.31, 0.4, 1.2, 0.25, 0.961, 0.0),  # ours
        "simulation_printed": (14.0, 2.0, 0.6, 1.2, 0.4, 1.2, 0.25, 0.961, 0.0),  # (6.22)
        "simulation": (14.0, 0.2, 0.6, 0.12, 0.4, 1.2, 0.25, 0.961, 0.0),
        "friction_printed": (8.5, 0.3, 0.4, 0.65, 0.4, 0.9, 0.20, 0.961, 0.0),  # (6.27)
        "friction": (8.5, 0.3, 0.4, 0.065, 0.4, 0.9, 0.20, 0.961, 0.0),
        "preliminary": (6.4, 0.19, 0.13, 0.0125, 0.4, 0.9, 0.39, 0.961, 0.0),  # (6.29)
        "table_6.2_0.00": (10.0, 0.4, 0.5, 0.075, 0.4, 1.2, 0.20, 0.970, 10.0),  # Tables 6.2 and 6.3; their rates are Hz
        "table_6.2_0.50": (12.0, 0.4, 0.5, 0.10, 0.4, 1.2, 0.20, 0.968, 10.0),
        "table_6.2_0.75": (14.0, 0.4, 0.6, 0.10, 0.4, 1.2, 0.15, 0.963, 10.0),
        "table_6.2_1.00": (13.0, 0.4, 0.6, 0.075, 0.4, 1.2, 0.10, 0.960, 15.0),
        "table_6.3_1.00": (14.0, 0.5, 0.6, 0.085, 0.4, 1.2, 0.10, 0.960, 15.0),
        "table_6.2_1.50": (12.0, 0.6, 0.5, 0.060, 0.4, 1.2, 0.10, 0.951, 20.0),
        "program_0.00": (10.0, 0.4, 0.5, 0.075, 0.38, 1.14, 0.20, 0.9704, 10.0),  # the robot author's last version
        "program_0.50": (12.0, 0.4, 0.5, 0.10, 0.38, 1.14, 0.20, 0.9675, 10.0),
        "program_0.75": (14.0, 0.4, 0.6, 0.10, 0.38, 1.14, 0.15, 0.9634, 10.0),
        "program_1.00": (14.0, 0.5, 0.6, 0.085, 0.38, 1.14, 0.10, 0.9598, 15.0),
        "program_1.50": (12.0, 0.5, 0.45, 0.050, 0.38, 1.14, 0.10, 0.9512, 20.0),
    }.items()
}

# name: (q1=q2, q3, q4=q5, q6=q7, q8, q9=q10, q11=q12=q13), source
PROCESS_NOISE = {
    "simulation": ((1e-5, 1e-4, 1e-4, 0.1, 0.1, 0.1, 1e-3), "T 6.21"),
    "friction": ((1e-5, 1e-5, 0.1, 0.1, 2.0, 1e-4, 1e-3), "T 6.26, 6.28"),
    "accuracy": ((1e-5, 1e-4, 1e-4, 0.1, 2.0, 0.1, 1e-3), "T 6.30"),
    "driving": ((1e-5, 1e-4, 1e-4, 0.1, 2.0, 0.1, 1e-6), "ours: (T 6.30) with the augmented states as certain as they are, beats the KF also without spin"),
    "control": ((1e-5, 1e-4, 1e-4, 0.1, 2.0, 1e-3, 1e-3), "T 6.31"),
}
KF_PROCESS_NOISE = (1e-5, 1e-5, 1e-4, 1e-4, 0.1, 0.1, 1e-3, 1e-3)

# The robot author's levels drive at 1.25, 0.99, 0.75, 0.50, 0.25 turns of the ball a second (0.25 to 0.05 m/s); ours may be faster.
REMOTE_LEVELS = (
    {"button": "none", "yaw_rate_hz": 0.0, "drive_limit_m_s": 0.25},
    {"button": "square", "yaw_rate_hz": 0.5, "drive_limit_m_s": 0.25},
    {"button": "triangle", "yaw_rate_hz": 0.75, "drive_limit_m_s": 0.25},
    {"button": "circle", "yaw_rate_hz": 1.0, "drive_limit_m_s": 0.25},
    {"button": "cross", "yaw_rate_hz": 1.5, "drive_limit_m_s": 0.20},
)
