"""Registers of the MPU-9250 and places in its DMP's memory.

Source: InvenSense register map RM-MPU-9250A-00 rev. 1.4; undocumented ones (DMP) as public MotionDriver 6.12 sources name them.
"""

SMPLRT_DIV, CONFIG, GYRO_CONFIG, ACCEL_CONFIG, ACCEL_CONFIG2 = 0x19, 0x1A, 0x1B, 0x1C, 0x1D
FIFO_EN, INT_PIN_CFG, INT_ENABLE, INT_STATUS, ACCEL_XOUT_H = 0x23, 0x37, 0x38, 0x3A, 0x3B
USER_CTRL, PWR_MGMT_1, PWR_MGMT_2 = 0x6A, 0x6B, 0x6C
BANK_SEL, MEM_START_ADDR, MEM_R_W, PRGM_START_H = 0x6D, 0x6E, 0x6F, 0x70
FIFO_COUNT_H, FIFO_R_W, WHO_AM_I = 0x72, 0x74, 0x75

H_RESET = 0x80
USER_DMP_EN, USER_FIFO_EN, USER_DMP_RST, USER_FIFO_RST = 0x80, 0x40, 0x08, 0x04
INT_RAW_READY, INT_DMP, INT_FIFO_OVERFLOW = 0x01, 0x02, 0x10
PIN_ACTIVE_LOW, PIN_LATCHED, PIN_ANY_READ_CLEARS, PIN_BYPASS = 0x80, 0x20, 0x10, 0x02

# WHO_AM_I: name, usable with the MotionDriver DMP.
CHIPS = {
    0x71: ("MPU-9250", True),
    0x73: ("MPU-9255", True),
    0x70: ("MPU-6500", True),  # also sold as an MPU-9250 without magnetometer
    0x74: ("MPU-6515", False),
    0x68: ("MPU-6050 or MPU-9150", False),
    0x78: ("MPU-6880", False),
}

DLPF_CODES = {184: 1, 92: 2, 41: 3, 20: 4, 10: 5, 5: 6}
GYRO_RANGE_CODES = {250: 0, 500: 1, 1000: 2, 2000: 3}
ACCEL_RANGE_CODES = {2: 0, 4: 1, 8: 2, 16: 3}

DMP_IMAGE_BYTES = 3062
DMP_START = 0x0400
PACKET_BYTES = 32
RAW_BYTES = 14  # accelerometer, temperature, gyro from ACCEL_XOUT_H
FIFO_BYTES = 1024

# Places in the DMP's memory.
D_0_22, D_0_104 = 534, 104
CFG_MOTION_BIAS, CFG_20, CFG_ANDROID_ORIENT, CFG_LP_QUAT, CFG_8 = 1208, 2224, 1853, 2712, 2718
CFG_GYRO_RAW, CFG_15, CFG_27, CFG_6, CFG_FIFO_ON_EVENT = 2722, 2727, 2742, 2753, 2690
FCFG_1, FCFG_2, FCFG_3, FCFG_7 = 1062, 1066, 1088, 1073
D_1_72, D_1_79, D_1_90, D_1_88, D_1_92, D_1_218, TAPW_MIN = 328, 335, 346, 344, 348, 474, 478
TAP_THRESHOLD, TAP_THRESHOLD_3_4 = (468, 472, 476), (292, 296, 300)

# Body axes from chip axes as 3-bit fields (two bits of axis, one of sign), body X in the lowest.
ORIENTATIONS = {
    "z_up": 0x088, "z_down": 0x18C, "x_up": 0x00E, "x_down": 0x10A,
    "y_up": 0x070, "y_down": 0x150, "x_forward": 0x085, "x_back": 0x0A1,
}  # fmt: skip
