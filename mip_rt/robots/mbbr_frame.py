"""The MBBR's frame: the fields between estimation and outputs that only this robot has.

Frames and signs: inertial z up; body rotation R = Rz(yaw) Ry(pitch) Rx(roll). SI units.
"""

from mip_rt import frame
from mip_rt.frame import Field

WHEELS = 3
ESTIMATE_NAMES = (
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
    "roll_rate_rad_s",
    "pitch_rate_rad_s",
    "yaw_rate_rad_s",
    "ball_rate_x_rad_s",  # yaw-rotated ball rates (the papers' phi*), as the filters have them
    "ball_rate_y_rad_s",
    "ball_angle_x_rad",  # inertial ball angles, integrated outside the filters; position = r (angle_y, -angle_x)
    "ball_angle_y_rad",
)
LAYOUT = frame.Layout(
    WHEELS,
    ESTIMATE_NAMES,
    (
        Field("body_angle_rad", "<f8", (3,), "rad", "ball angle relative to the body, from the encoders (phi_B)"),
        Field("state_estimate", "<f8", (16,), "rad, rad/s", "full state vector of the estimator in control"),
        Field("state_variance", "<f8", (16,), "rad^2", "diagonal of its covariance"),
        Field("innovation", "<f8", (8,), "rad/s, rad, m/s^2", "its innovations: gyro, encoders, accelerometer; of momentum: encoders x, y"),
        Field("gains", "<f8", (9,), "1/rad, s/rad", "gains in force: c1 to c6, SLC gain, SLC pole, low-pass (rad/s)"),
        Field("reference_velocity_rad_s", "<f8", (2,), "rad/s", "reference of the ball's inertial rates"),
        Field("reference_angle_rad", "<f8", (2,), "rad", "reference of the ball's inertial angles"),
        Field("reference_yaw_rad", "<f8", (2,), "rad, rad/s", "reference of yaw and yaw rate"),
        Field("reference_lean_rad", "<f8", (4,), "rad, rad/s", "outer loop: lean x, y and lean rate x, y"),
        Field("error", "<f8", (10,), "rad, rad/s", "reference - estimate: tilt, yaw, ball angle, their rates"),
        Field("command_feedback", "<f8", (3,), "1", "body command of the state feedback"),
        Field("command_friction", "<f8", (3,), "1", "what friction compensation adds"),
        Field("command_wheel", "<f8", (3,), "1", "wheel commands of the linear motor model, clipped"),
        Field("command_applied", "<f8", (3,), "1", "body command after clipping, less compensation: what estimators are told"),
    ),
)
FRAME = LAYOUT.dtype
