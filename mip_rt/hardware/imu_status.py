"""Bits that reading the IMU returns, one word a tick (frame.imu_status)."""

IMU_OK = 1  # a valid, new packet was read
IMU_NO_DATA = 2  # the FIFO was empty, or no raw sample is new
IMU_BACKLOG = 4  # more than one packet waited; the newest was used
IMU_MISALIGNED = 8  # the FIFO's count is no multiple of the packet's length
IMU_OVERFLOW = 16  # the FIFO ran over
IMU_BAD_NORM = 32  # the quaternion's norm is not 1, or the raw registers hold what cannot be measured
IMU_FROZEN = 64  # the same packet ten times in a row
IMU_BUS_ERROR = 128  # the I2C bus refused, also the second time
IMU_BUS_TIMEOUT = 256  # ... because it hung until the kernel gave up (with IMU_BUS_ERROR)
