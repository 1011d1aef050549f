"""The faults: every reason for being in the state FAULT, with what it promises.

The number stands in the frame and never changes its meaning. The bound is the time from the cause to motors off
that a test asserts.
"""

from typing import NamedTuple


class Fault(NamedTuple):
    """A named fault: number in the frame, code, what happened, what to do, time from cause to reaction, reaction."""

    number: int
    code: str
    sentence: str
    cure: str
    bound_s: float
    reaction: str = "motors off"


FAULTS = {
    f.code: f
    for f in (
        Fault(0, "none", "", "", 0.0, ""),
        Fault(1, "imu_silent", "the IMU's interrupt stopped", "check the IMU's wiring and the I2C bus; run mip-rt doctor", 0.050),
        Fault(2, "imu_bad", "three ticks in a row brought no usable IMU packet, each for another reason",
              "check the I2C bus for noise and cable length", 0.025),
        Fault(3, "imu_frozen", "the IMU repeated the same packet ten times", "power-cycle the robot", 0.060),
        Fault(4, "tipped", "the robot leaned too far", "stand it up and press the button twice", 0.010),
        Fault(5, "not_finite", "numbers were not finite for three ticks", "send the log to the developers", 0.020),
        Fault(6, "motor_write", "the motors refused a write", "check the motor driver's PWM and GPIO overlays", 0.010),
        Fault(7, "estimator", "the estimator's covariance or state was unhealthy three ticks in a row", "send the log to the developers", 0.020),
        Fault(8, "guard_dropped", "the loop stood still for longer than limits.guard_timeout_s, so the guard dropped the enable line",
              "look for scheduling warnings at the start and for a blocked I2C bus; press the button twice to arm again", 0.100),
        Fault(9, "guard_lost", "the guard process is gone or hangs; it cannot come back", "restart mip-rt; its journal says why the guard ended", 0.100),
        Fault(10, "i2c_error", "the I2C bus refused three ticks in a row", "check cable length and pull-ups; run mip-rt doctor", 0.025),
        Fault(11, "i2c_timeout", "the I2C bus hung until the kernel gave up",
              "power-cycle the robot: a chip holds SDA or SCL low", 0.010, "motors off as soon as the kernel returns; the guard is faster"),
        Fault(12, "fifo_misaligned", "the IMU's FIFO was out of step three ticks in a row", "wait a second: it is reset; then press the button", 0.025),
        Fault(13, "quaternion_invalid", "the DMP's quaternion was not of length 1 three ticks in a row",
              "check the I2C bus for noise; power-cycle the robot", 0.025),
        Fault(14, "imu_no_data", "interrupts came without a packet three ticks in a row", "power-cycle the robot", 0.025),
        Fault(15, "imu_unreliable", "too many IMU packets were unusable", "check the I2C bus for noise and cable length", 0.5),
        Fault(16, "imu_rate", "the IMU's interrupts came at a wrong rate", "check the DMP's image and its rate", 1.0),
        Fault(17, "encoder_static", "a wheel's count stood still although its motor was driven", "check that encoder's plug and the motor's", 0.3),
        Fault(18, "encoder_jump", "a wheel's count jumped again and again", "check that encoder's cable for noise", 0.05),
        Fault(19, "encoder_sign", "a wheel turned against what the gyro says", "check encoders.signs and motors.signs; run mip-rt doctor", 0.3),
        Fault(20, "wheel_slip", "a wheel did not move with the others and the gyro", "clean wheels, ball and floor", 0.35),
        Fault(21, "lifted", "the wheels raced without load", "put the robot on the ground and press the button twice", 0.5),
        Fault(22, "saturated", "a motor was at its limit without pause", "drive slower, charge the battery, or remove what blocks the robot", 0.45),
        Fault(23, "battery_low", "the battery is empty", "charge it", 2.5, "stand still below battery.minimum_v, then motors off"),
        Fault(24, "overrun", "the loop missed too many ticks", "stop other programs; check the real-time settings", 0.5),
    )
}  # fmt: skip
FAULT_BY_NUMBER = {f.number: f for f in FAULTS.values()}
