"""The eduMIP's frame: the fields between estimation and outputs that only this robot has.

Body axes: x to the left, y to the back, z up; so the first number of `attitude_rad` is the lean about the axle (forward positive, the papers' pitch), and
the second a sideways tilt that the robot on its two wheels does not have. Wheel 1 is the right one. SI units.
"""

from mip_rt import frame
from mip_rt.frame import Field

WHEELS = 2
ESTIMATE_NAMES = (
    "pitch_rad",
    "phi_rad",  # mean angle of the wheels relative to the body; against the ground it is phi + pitch, place = r times that
    "yaw_rad",
    "pitch_rate_rad_s",
    "phi_rate_rad_s",
    "yaw_rate_rad_s",
)
LAYOUT = frame.Layout(
    WHEELS,
    ESTIMATE_NAMES,
    (
        Field("phi_rad", "<f8", (), "rad", "mean wheel angle relative to the body, from the encoders"),
        Field("encoder_yaw_rad", "<f8", (), "rad", "heading from the difference of the encoders"),
        Field("accelerometer_tilt_rad", "<f8", (), "rad", "lean that the accelerometer shows, atan2(-a_y, -a_z)"),
        Field("state_estimate", "<f8", (8,), "rad, rad/s", "full state vector of the estimator in control"),
        Field("state_variance", "<f8", (8,), "rad^2", "diagonal of its covariance"),
        Field("innovation", "<f8", (4,), "rad, rad/s, m/s^2", "its innovations"),
        Field("gains", "<f8", (5,), "1/rad, s/rad", "gains in force: lean, wheel angle, lean rate, wheel rate, integral"),
        Field("reference_velocity_rad_s", "<f8", (), "rad/s", "reference of the wheels' rate against the ground"),
        Field("reference_angle_rad", "<f8", (), "rad", "reference of the wheels' angle against the ground"),
        Field("reference_yaw_rad", "<f8", (2,), "rad, rad/s", "reference of yaw and yaw rate"),
        Field("reference_lean_rad", "<f8", (), "rad", "lean reference of the outer loop"),
        Field("error", "<f8", (6,), "rad, rad/s", "reference - estimate: lean, wheel angle against the ground, yaw, their rates"),
        Field("command_feedback", "<f8", (2,), "1", "u_x (forward) and u_z (left) of the controller"),
        Field("command_friction", "<f8", (2,), "1", "what friction compensation adds, by wheel"),
        Field("command_wheel", "<f8", (2,), "1", "wheel commands of the linear motor model, clipped"),
        Field("command_applied", "<f8", (2,), "1", "u_x, u_z after clipping, less compensation: what estimators are told"),
    ),
)
FRAME = LAYOUT.dtype
