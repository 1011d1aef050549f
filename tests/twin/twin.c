/* The MBBR's compiled step in plain C, the same arithmetic in the same order, for comparison of cost and results.
   The structs come from the numpy record types (twin.py writes records.h). */
#include <math.h>
#include <stdint.h>
#include <string.h>
#include "records.h"

#define N 13
#define W 16

/* Rows of 16: as plain loops, or (-DROWS_AS_VECTORS) as one gcc vector, without which gcc 12 takes three times as long. */
#ifdef ROWS_AS_VECTORS
typedef double Row __attribute__((vector_size(128), aligned(8), may_alias));
static inline void add_scaled(double *target, double f, const double *source) { *(Row *)target += f * *(const Row *)source; }
#else
static inline void add_scaled(double *restrict target, double f, const double *restrict source)
{ for (int j = 0; j < W; j++) target[j] += f * source[j]; }
#endif

static const int F_ROWS[N + 1] = {0, 1, 2, 3, 4, 5, 12, 19, 26, 33, 40, 42, 44, 48};
static const int F_COLS[48] = {5, 6, 7, 8, 9, 0, 1, 5, 6, 7, 8, 9, 0, 1, 5, 6, 7, 8, 9, 0, 1, 5, 6, 7, 8, 9,
                               0, 1, 5, 6, 7, 8, 9, 0, 1, 5, 6, 7, 8, 9, 1, 7, 0, 7, 0, 1, 8, 9};
static const int H_ROWS[9] = {0, 3, 7, 8, 11, 14, 16, 23, 30};
static const int H_COLS[30] = {1, 5, 7, 0, 1, 6, 7, 7, 0, 3, 10, 1, 4, 11, 2, 12, 0, 1, 5, 6, 7, 8, 9, 0, 1, 5, 6, 7, 8, 9};

static inline double row8(const double *c, double t, double slip, double u, double tz, double tu, double rz, double wz, double tzz)
{ return c[0] * t + c[1] * slip + c[2] * u + c[3] * tz + c[4] * tu + c[5] * rz + c[6] * wz + c[7] * tzz; }

static void derivative(const double *x, const double *u, const Coefficients *c, double *o)
{
    double r = x[0], h = x[1], p = x[5], q = x[6], z = x[7], a = x[8], b = x[9], zz = z * z;
    const double *s = c->spin;
    o[0] = p; o[1] = q; o[2] = z; o[3] = a; o[4] = b;
    o[5] = row8(c->tilt_x, r, p - a, u[0], h * z, h * u[2], q * z, b * z, r * zz);
    o[6] = row8(c->tilt_y, h, q - b, u[1], r * z, r * u[2], p * z, a * z, h * zz);
    o[7] = s[0] * u[2] + s[1] * z + s[2] * h * u[0] + s[3] * r * u[1] + s[4] * h * a + s[5] * r * b + s[6] * q * a + s[7] * p * b
           + z * (s[8] * r * a + s[9] * h * b);
    o[8] = row8(c->ball_x, r, p - a, u[0], h * z, h * u[2], q * z, b * z, r * zz);
    o[9] = row8(c->ball_y, h, q - b, u[1], r * z, r * u[2], p * z, a * z, h * zz);
    o[10] = h * z; o[11] = -r * z; o[12] = h * a - r * b;
}

static void output(const double *x, const double *u, const Coefficients *c, double *o)
{
    double r = x[0], h = x[1], p = x[5], q = x[6], z = x[7], a = x[8], b = x[9], zz = z * z;
    o[0] = p - h * z; o[1] = q + (c->gyro_y_roll * r + c->gyro_y_pitch * h) * z; o[2] = z;
    o[3] = x[3] - r + x[10]; o[4] = x[4] - h + x[11]; o[5] = -x[2] + x[12];
    o[6] = row8(c->accel_y, h, q - b, u[1], r * z, r * u[2], p * z, a * z, h * zz);
    o[7] = row8(c->accel_x, r, p - a, u[0], h * z, h * u[2], q * z, b * z, r * zz);
}

static void jx(const double *c, const double *x, double uz, double *o)
{
    double z = x[7];
    o[0] = c[0] + c[7] * z * z; o[1] = c[3] * z + c[4] * uz; o[5] = c[1]; o[6] = c[5] * z;
    o[7] = c[3] * x[1] + c[5] * x[6] + c[6] * x[9] + 2.0 * c[7] * x[0] * z; o[8] = -c[1]; o[9] = c[6] * z;
}

static void jy(const double *c, const double *x, double uz, double *o)
{
    double z = x[7];
    o[0] = c[3] * z + c[4] * uz; o[1] = c[0] + c[7] * z * z; o[5] = c[5] * z; o[6] = c[1];
    o[7] = c[3] * x[0] + c[5] * x[5] + c[6] * x[8] + 2.0 * c[7] * x[1] * z; o[8] = c[6] * z; o[9] = -c[1];
}

static void jacobian(const double *x, const double *u, const Coefficients *c, double (*o)[W])
{
    double r = x[0], h = x[1], p = x[5], q = x[6], z = x[7], a = x[8], b = x[9];
    const double *s = c->spin;
    for (int i = 0; i < 5; i++) o[i][5 + i] = 1.0;
    jx(c->tilt_x, x, u[2], o[5]); jy(c->tilt_y, x, u[2], o[6]);
    o[7][0] = s[3] * u[1] + s[5] * b + s[8] * z * a; o[7][1] = s[2] * u[0] + s[4] * a + s[9] * z * b;
    o[7][5] = s[7] * b; o[7][6] = s[6] * a; o[7][7] = s[1] + s[8] * r * a + s[9] * h * b;
    o[7][8] = s[4] * h + s[6] * q + s[8] * z * r; o[7][9] = s[5] * r + s[7] * p + s[9] * z * h;
    jx(c->ball_x, x, u[2], o[8]); jy(c->ball_y, x, u[2], o[9]);
    o[10][1] = z; o[10][7] = h; o[11][0] = -z; o[11][7] = -r;
    o[12][0] = -b; o[12][1] = a; o[12][8] = h; o[12][9] = -r;
}

static void output_jacobian(const double *x, const double *u, const Coefficients *c, double (*o)[W])
{
    double z = x[7];
    o[0][5] = 1.0; o[0][1] = -z; o[0][7] = -x[1];
    o[1][6] = 1.0; o[1][0] = c->gyro_y_roll * z; o[1][1] = c->gyro_y_pitch * z; o[1][7] = c->gyro_y_roll * x[0] + c->gyro_y_pitch * x[1];
    o[2][7] = 1.0;
    for (int i = 0; i < 2; i++) { o[3 + i][i] = -1.0; o[3 + i][3 + i] = 1.0; o[3 + i][10 + i] = 1.0; }
    o[5][2] = -1.0; o[5][12] = 1.0;
    jy(c->accel_y, x, u[2], o[6]); jx(c->accel_x, x, u[2], o[7]);
}

static void multiply(double (*restrict t)[W], double (*restrict A)[W], double dt, double (*restrict m)[W])
{
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < W; j++) t[i][j] = m[i][j];
        for (int e = F_ROWS[i]; e < F_ROWS[i + 1]; e++) {
            add_scaled(t[i], dt * A[i][F_COLS[e]], m[F_COLS[e]]);
        }
    }
}

void ekf_step(EkfParameters *p, Filter *s, const double *u, const double *y, int64_t valid)
{
    double *x = s->x, (*P)[W] = s->P, *dx = s->dx, *gain = s->product[0];
    s->status = 0;
    jacobian(x, u, &p->model, s->A);
    derivative(x, u, &p->model, dx);
    for (int i = 0; i < N; i++) x[i] += p->noise.dt_s * dx[i];
    multiply(s->product, s->A, p->noise.dt_s, P);
    for (int i = 0; i < N; i++) for (int j = 0; j < N; j++) s->transposed[j][i] = s->product[i][j];
    multiply(P, s->A, p->noise.dt_s, s->transposed);
    for (int i = 0; i < N; i++) { for (int j = 0; j < i; j++) P[i][j] = P[j][i]; P[i][i] += p->noise.Q[i]; }
    output(x, u, &p->model, s->h);
    output_jacobian(x, u, &p->model, s->H);
    for (int i = 0; i < W; i++) dx[i] = 0.0;
    for (int k = 0; k < 8; k++) {
        double innovation = y[k] - s->h[k], variance = p->noise.R[k];
        s->innovation[k] = 0.0;
        if (!((valid >> k) & 1)) continue;
        if (!(fabs(innovation) < INFINITY)) { s->status |= 4; continue; }
        s->innovation[k] = innovation;
        for (int i = 0; i < W; i++) gain[i] = 0.0;
        for (int e = H_ROWS[k]; e < H_ROWS[k + 1]; e++) {
            add_scaled(gain, s->H[k][H_COLS[e]], P[H_COLS[e]]);
        }
        for (int e = H_ROWS[k]; e < H_ROWS[k + 1]; e++) { variance += s->H[k][H_COLS[e]] * gain[H_COLS[e]]; innovation -= s->H[k][H_COLS[e]] * dx[H_COLS[e]]; }
        s->innovation_variance[k] = variance;
        if (!(variance > 0.0)) { s->status |= 8; continue; }
        if (innovation * innovation > p->noise.gate_squared * variance) {
            s->rejected[k]++; s->refused_in_a_row[k]++; s->status |= 1;
            if (s->refused_in_a_row[k] <= 40) continue;
            s->status |= 2;
        } else s->refused_in_a_row[k] = 0;
        double inverse = 1.0 / variance;
        add_scaled(dx, innovation * inverse, gain);
        for (int i = 0; i < N; i++) add_scaled(P[i], -gain[i] * inverse, gain);
    }
    for (int i = 0; i < W; i++) x[i] += dx[i];
    double total = 0.0;
    for (int i = 0; i < N; i++) {
        double variance = P[i][i];
        total += x[i] * 0.0;
        if (variance > p->noise.P_limit[i]) {
            double scale = sqrt(p->noise.P_limit[i] / variance);
            for (int j = 0; j < N; j++) P[i][j] *= scale;
            for (int j = 0; j < N; j++) P[j][i] *= scale;
            s->status |= 16;
        }
        if (!(0.0 < variance && variance < INFINITY)) s->status |= 8;
    }
    if (!(total == 0.0)) s->status |= 8;
}

static double low_pass(double y, double x, double a) { return a * y + (1.0 - a) * x; }
static double limit(double v, double b) { return v > b ? b : v < -b ? -b : v; }
static int64_t i16(const uint8_t *b) { return (int16_t)(b[0] << 8 | b[1]); }
static int64_t i32(const uint8_t *b) { return (int32_t)((uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | b[3]); }

static int sensors(SensorsP *p, SensorsS *s, Frame *row)
{
    const uint8_t *k = row->imu_packet;
    int fresh = row->imu_status & 1;
    double w = 0, x = 0, y = 0, z = 0, norm = 1;
    if (fresh) {
        w = i32(k); x = i32(k + 4); y = i32(k + 8); z = i32(k + 12);
        norm = sqrt(w * w + x * x + y * y + z * z);
        fresh = norm > 0.0;
    }
    if (fresh) {
        w /= norm; x /= norm; y /= norm; z /= norm;
        s->quaternion[0] = w; s->quaternion[1] = x; s->quaternion[2] = y; s->quaternion[3] = z;
        s->attitude_rad[0] = atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y));
        s->attitude_rad[1] = asin(fmin(1.0, fmax(-1.0, 2.0 * (w * y - z * x))));
        double turn = atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)) - s->attitude_rad[2];
        s->attitude_rad[2] += turn - 2.0 * M_PI * floor(turn / (2.0 * M_PI) + 0.5);
        for (int i = 0; i < 3; i++) {
            double rate = 0, force = 0;
            for (int j = 0; j < 3; j++) { force += p->mounting[i][j] * i16(k + 16 + 2 * j); rate += p->mounting[i][j] * i16(k + 22 + 2 * j); }
            s->gyro_rad_s[i] = rate * p->gyro_scale_rad_s - row->gyro_bias_rad_s[i];
            s->acceleration_m_s2[i] = -force * p->accel_scale_m_s2;
        }
    }
    memcpy(row->quaternion, s->quaternion, sizeof row->quaternion);
    for (int i = 0; i < 3; i++) { row->attitude_rad[i] = s->attitude_rad[i]; row->gyro_rad_s[i] = s->gyro_rad_s[i]; row->acceleration_m_s2[i] = s->acceleration_m_s2[i]; }
    int steady = 1;
    for (int i = 0; i < 3; i++) {
        int64_t count = row->encoder_count[i];
        double *h = s->wheel_history_rad[i];
        if (!s->started) { s->count_offset[i] = count; s->last_count[i] = count; for (int j = 0; j < 6; j++) h[j] = 0; }
        int64_t moved = count - s->last_count[i];
        if (fabs(moved * p->count_scale_rad[i]) > p->wheel_jump_rad) { s->count_offset[i] += moved; steady = 0; }
        s->last_count[i] = count;
        double angle = (count - s->count_offset[i]) * p->count_scale_rad[i];
        row->wheel_angle_rad[i] = angle;
        for (int j = 5; j > 0; j--) h[j] = h[j - 1];
        h[0] = angle;
        row->wheel_rate_rad_s[i] = (5.0 / 35.0 * (h[0] - h[5]) + 3.0 / 35.0 * (h[1] - h[4]) + 1.0 / 35.0 * (h[2] - h[3])) * p->rate_hz;
    }
    s->started = 1;
    for (int j = 0; j < 3; j++) {
        double total = 0;
        for (int i = 0; i < 3; i++) total += p->body_from_wheel[j][i] * row->wheel_angle_rad[i];
        row->body_angle_rad[j] = p->wheel_ratio * total;
    }
    return (fresh ? 0 : 1) | (steady ? 0 : 2);
}

static double coast_inverse(double current, double omega, double t)
{
    double target = fabs(current), sign = current > 0 ? 1.0 : -1.0, speed = sign * omega, a = 1.0 - speed, b = 1.0 + speed;
    if (target == 0.0 || a <= 0.0) return 0.0;
    if (target >= a) return sign;
    if (b <= 0.0) return sign * fmax(0.0, (target + b) / (a + b));
    double border = 1.0 + log((b + a * exp(-t)) / (a + b)) / t, at = border * a - (1.0 - border) * b;
    if (target >= at) return sign * (target + b) / (a + b);
    double low = 0.0, high = border, v = border * sqrt(target / at);
    for (int n = 0; n < 50; n++) {
        double gone = -expm1(-v * t), error = v * a - b / t * log1p(a * gone / b) - target;
        if (fabs(error) <= 1e-12 * target) break;
        if (error > 0) high = v; else low = v;
        double step = error / (a * (a + b) * gone / (b + a * gone));
        v -= step;
        if (!(low < v && v < high)) v = 0.5 * (low + high);
        if (fabs(step) <= 1e-15) break;
    }
    return sign * v;
}

static double friction(double rate, double k) { double v = -expm1(-k * fabs(rate)); return rate >= 0 ? v : -v; }

static double target_gain(ScheduleP *p, int g, double rate)
{
    int last = (int)p->slots - 1;
    if (!(rate > p->yaw_rate_rad_s[0])) return p->gains[0][g];
    for (int i = 0; i < last; i++)
        if (rate <= p->yaw_rate_rad_s[i + 1]) {
            double share = (rate - p->yaw_rate_rad_s[i]) / (p->yaw_rate_rad_s[i + 1] - p->yaw_rate_rad_s[i]);
            return p->gains[i][g] + share * (p->gains[i + 1][g] - p->gains[i][g]);
        }
    return p->gains[last][g];
}

/* Bits of frame.limits that the step reads back, and of frame.alarms. */
enum { IMU_MISSING = 1, NOT_FINITE = 4, LEAN_LIMITED = 16, SATURATED = 32, JUMP = 512, RATE_LIMITED = 1 << 13, HELD = 1 << 14, DISAGREE = 1 << 15,
       REDUCED = 1 << 16, SPIN_DOWN = 1 << 17, WARNING = 1 << 18 };
enum { A_UNRELIABLE = 1, A_RATE = 2, A_STATIC = 4, A_JUMP = 8, A_SIGN = 16, A_SLIP = 32, A_LIFTED = 64, A_SATURATED = 128, A_LOW = 256, A_OVERRUN = 512 };

static int check_timing(HealthP *p, HealthS *s, Frame *row, int64_t limits)
{
    int alarms = 0;
    s->missing = p->missing_pole * s->missing + (1.0 - p->missing_pole) * (limits & IMU_MISSING ? 1.0 : 0.0);
    if (!(s->missing <= 0.3)) alarms |= A_UNRELIABLE;
    double error = 0.0;
    if (s->edge_ns) error = (row->edge_ns - s->edge_ns) * 1e-9 - (row->missed + 1) * p->dt_s;
    s->edge_ns = row->edge_ns;
    s->interval_error_s = p->rate_pole * s->interval_error_s + (1.0 - p->rate_pole) * error;
    if (!(fabs(s->interval_error_s) <= p->rate_tolerance_s)) alarms |= A_RATE;
    s->overrun = p->overrun_pole * s->overrun + (1.0 - p->overrun_pole) * row->missed;
    if (!(s->overrun <= 0.5)) alarms |= A_OVERRUN;
    return alarms;
}

static int check_wheels(HealthP *p, HealthS *s, Frame *row, double yaw_rate, double lean_cosine)
{
    double mismatch = 0.0, pole = lean_cosine > 0.92 ? p->mismatch_pole : 0.0;
    for (int i = 0; i < p->wheels; i++) {
        double moved = row->wheel_angle_rad[i] - s->wheel_angle_rad[i];
        s->wheel_angle_rad[i] = row->wheel_angle_rad[i];
        mismatch += s->part_rad[i] = pole * s->part_rad[i] + p->yaw_from_wheel[i] * moved;
        if (moved == 0.0) { s->still[i]++; s->stalled_s[i] += p->dt_s * fabs(s->duty[i]); }
        else { s->still[i] = 0; s->stalled_s[i] = 0.0; }
    }
    s->yaw_rad = pole * s->yaw_rad + p->dt_s * yaw_rate;
    row->wheel_mismatch_rad = mismatch -= s->yaw_rad;
    if (fabs(mismatch) <= p->mismatch_limit_rad) { s->disagree = 0; return 1; }
    s->disagree++;
    return 0;
}

static int reversed_wheels(HealthP *p, HealthS *s, double mismatch)
{
    for (int some = 1; some < 1 << p->wheels; some++) {
        double total = 0.0;
        for (int i = 0; i < p->wheels; i++) if (some >> i & 1) total += 2.0 * s->part_rad[i];
        if (fabs(mismatch - total) < 0.35 * fabs(mismatch)) return 1;
    }
    return 0;
}

static int judge(HealthP *p, HealthS *s, Frame *row, double battery, int64_t *limits)
{
    int alarms = 0;
    double fastest = 0.0, clipped = 0.0, allowed = 1.0;
    for (int i = 0; i < p->wheels; i++) {
        fastest = fmax(fastest, fabs(row->wheel_rate_rad_s[i]));
        if (s->stalled_s[i] > p->stall_duty_s || (s->still[i] >= p->still_ticks && fabs(row->wheel_mismatch_rad) > 0.3 * p->mismatch_limit_rad)) alarms |= A_STATIC;
    }
    if (s->disagree >= p->sign_ticks && !alarms) {
        if (reversed_wheels(p, s, row->wheel_mismatch_rad)) alarms |= A_SIGN;
        else if (s->disagree >= p->slip_ticks) alarms |= A_SLIP;
    }
    s->racing = fastest < p->race_rad_s ? 0 : s->racing + 1;
    if (s->racing >= p->race_ticks) alarms |= A_LIFTED;
    s->jumps *= p->jump_pole;
    if (*limits & JUMP) { s->jumps += 1.0; if (s->jumps > 4.0) alarms |= A_JUMP; }
    if (*limits & SATURATED) {
        double largest = 0.0;
        clipped = 1.0;
        for (int i = 0; i < p->wheels; i++) largest = fmax(largest, fabs(row->command_wheel[i]));
        for (int i = 0; i < p->wheels; i++) {
            int64_t run = 0, before = s->clipped[i];
            if (row->command_wheel[i] == largest) run = (before > 0 ? before : 0) + 1;
            else if (row->command_wheel[i] == -largest) run = (before < 0 ? before : 0) - 1;
            s->clipped[i] = run;
            if ((run < 0 ? -run : run) >= p->saturation_ticks) alarms |= A_SATURATED;
        }
    } else for (int i = 0; i < p->wheels; i++) s->clipped[i] = 0;
    s->saturation = p->saturation_pole * s->saturation + (1.0 - p->saturation_pole) * clipped;
    for (int i = 0; i < p->wheels; i++) s->duty[i] = row->duty[i];
    s->low = battery < p->cutoff_v ? s->low + 1 : 0;
    if (s->low >= p->battery_ticks) alarms |= A_LOW;
    if (battery < p->warn_v) { *limits |= WARNING; allowed = fmin(1.0, fmax(0.0, (battery - p->cutoff_v) / (p->minimum_v - p->cutoff_v))); }
    if (s->saturation > 0.4) allowed = fmin(allowed, fmax(0.0, 1.0 - (s->saturation - 0.4) / (1.0 - 0.4)));
    row->drive_allowed = s->allowed = fmin(allowed, s->allowed + p->recovery);
    if (s->allowed < 1.0) *limits |= REDUCED;
    return alarms;
}

static int spin_down(SpinDownP *p, SpinDownS *s, int spinning, const double *e)
{
    double lean = e[0] * e[0] + e[1] * e[1], angle = e[3] * e[3] + e[4] * e[4], speed = e[8] * e[8] + e[9] * e[9];
    if (s->active) {
        if (lean < p->leave_squared[0] && angle < p->leave_squared[1] && speed < p->leave_squared[2]) s->active = 0;
    } else if (spinning && !(lean <= p->enter_squared[0] && angle <= p->enter_squared[1] && speed <= p->enter_squared[2])) s->active = 1;
    return s->active == 1;
}

static int64_t control(RobotP *p, RobotS *s, Frame *row)
{
    int64_t limits = 0;
    double allowed = s->health.allowed, vx = allowed * row->remote_velocity_m_s[0], vy = allowed * row->remote_velocity_m_s[1];
    double spin = s->spin_down.active ? 0.0 : allowed * row->remote_yaw_rate_rad_s, ahead;
    double *e = row->estimates[0], c, n;
    ReferenceP *rp = &p->reference; ReferenceS *r = &s->reference; DriveP *d = &p->drive; FeedbackS *f = &s->feedback;
    c = cos(r->forward_yaw_rad); n = sin(r->forward_yaw_rad);
    double ix = c * vx - n * vy, iy = n * vx + c * vy;
    r->rate_rad_s[0] = low_pass(r->rate_rad_s[0], -iy / rp->ball_radius_m, rp->shaping_pole);
    r->rate_rad_s[1] = low_pass(r->rate_rad_s[1], ix / rp->ball_radius_m, rp->shaping_pole);
    r->yaw_rate_first_rad_s = low_pass(r->yaw_rate_first_rad_s, spin, rp->shaping_pole);
    r->yaw_rate_rad_s = low_pass(r->yaw_rate_rad_s, r->yaw_rate_first_rad_s, rp->shaping_pole);
    for (int i = 0; i < 2; i++) {
        ahead = r->angle_rad[i] + rp->dt_s * r->rate_rad_s[i] - e[8 + i];
        if (fabs(ahead) > rp->angle_error_limit_rad) limits |= HELD;
        r->angle_rad[i] = e[8 + i] + limit(ahead, rp->angle_error_limit_rad);
    }
    ahead = r->yaw_rad + rp->dt_s * r->yaw_rate_rad_s - e[2];
    if (fabs(ahead) > rp->yaw_error_limit_rad) limits |= HELD;
    r->yaw_rad = e[2] + limit(ahead, rp->yaw_error_limit_rad);
    double *g = s->schedule.gains, rate = s->spin_down.active ? 0.0 : fabs(r->yaw_rate_rad_s);
    for (int i = 0; i < 9; i++) g[i] = low_pass(g[i], target_gain(&p->schedule, i, rate), p->schedule.blend_pole);
    c = cos(e[2]); n = sin(e[2]);
    double ex = r->rate_rad_s[0] - (c * e[6] - n * e[7]), ey = r->rate_rad_s[1] - (n * e[6] + c * e[7]), fx = ex, fy = ey;
    if (p->feedback.filter_frame) { fx = c * ex + n * ey; fy = -n * ex + c * ey; }
    double *lp = f->low_passed_rad_s, *lean = row->reference_lean_rad;
    lp[0] = low_pass(lp[0], fx, g[8]); lp[1] = low_pass(lp[1], fy, g[8]);
    double rx = lp[0], ry = lp[1], lx = f->lean_rad[0], ly = f->lean_rad[1], t;
    if (!p->feedback.filter_frame) { t = rx; rx = c * t + n * ry; ry = -n * t + c * ry; t = lx; lx = c * t + n * ly; ly = -n * t + c * ly; }
    if (f->first) { f->first = 0; f->lean_rotated_rad[0] = lx; f->lean_rotated_rad[1] = ly; }
    lean[0] = lx; lean[1] = ly;
    double lrx = (lx - f->lean_rotated_rad[0]) / p->feedback.dt_s, lry = (ly - f->lean_rotated_rad[1]) / p->feedback.dt_s;
    lean[2] = limit(lrx, p->feedback.lean_rate_limit_rad_s);
    lean[3] = limit(lry, p->feedback.lean_rate_limit_rad_s);
    if (lean[2] != lrx || lean[3] != lry) limits |= RATE_LIMITED;
    f->lean_rotated_rad[0] = lx; f->lean_rotated_rad[1] = ly;
    double nx = g[7] * f->lean_rad[0] + g[6] * fx, ny = g[7] * f->lean_rad[1] + g[6] * fy;
    f->lean_rad[0] = limit(nx, p->feedback.lean_limit_rad);
    f->lean_rad[1] = limit(ny, p->feedback.lean_limit_rad);
    if (f->lean_rad[0] != nx || f->lean_rad[1] != ny) limits |= LEAN_LIMITED;
    double ax = r->angle_rad[0] - e[8], ay = r->angle_rad[1] - e[9], *er = row->error, *u = row->command_feedback, *add = row->command_friction;
    er[0] = lx - e[0]; er[1] = ly - e[1]; er[2] = r->yaw_rad - e[2]; er[3] = c * ax + n * ay; er[4] = -n * ax + c * ay;
    er[5] = lean[2] - e[3]; er[6] = lean[3] - e[4]; er[7] = r->yaw_rate_rad_s - e[5]; er[8] = rx; er[9] = ry;
    u[0] = -(g[0] * er[0] + g[1] * er[3] + g[2] * er[5] + g[3] * er[8]);
    u[1] = -(g[0] * er[1] + g[1] * er[4] + g[2] * er[6] + g[3] * er[9]);
    u[2] = -(g[4] * er[2] + g[5] * er[7]);
    if (spin_down(&p->spin_down, &s->spin_down, row->remote_yaw_rate_rad_s != 0.0 || fabs(r->yaw_rate_rad_s) > 0.1, er)) limits |= SPIN_DOWN;
    double k = d->friction_smoothing_s_rad;
    add[0] = d->friction_level * friction(e[6] - e[3] + e[1] * e[5], k);
    add[1] = d->friction_level * friction(e[7] - e[4] - e[0] * e[5], k);
    add[2] = d->friction_level * friction(-e[5] - e[0] * e[7] + e[1] * e[6], k);
    if (row->battery_v > 0.0 && row->battery_v < INFINITY) { s->battery_v += (1.0 - p->battery_pole) * (row->battery_v - s->battery_v); s->battery_unknown = 0; }
    else if (++s->battery_unknown >= p->battery_hold_ticks) s->battery_v = p->nominal_voltage_v;
    double volts = s->battery_v, available = fmin(d->command_limit, volts / d->nominal_voltage_v);
    for (int i = 0; i < 3; i++) {
        double command = 0;
        for (int j = 0; j < 3; j++) command += d->body_from_wheel[j][i] * (u[j] + add[j]);
        command *= d->wheel_ratio * row->drive_scale;
        row->command_wheel[i] = limit(command, available);
        if (row->command_wheel[i] != command) limits |= SATURATED;
    }
    for (int j = 0; j < 3; j++) {
        double total = 0;
        for (int i = 0; i < 3; i++) total += d->body_from_wheel[j][i] * row->command_wheel[i];
        row->command_applied[j] = total / d->wheel_ratio - row->drive_scale * add[j];
    }
    for (int i = 0; i < 3; i++) {
        double emf = d->torque_constant_n_m_a * row->wheel_rate_rad_s[i];
        double value = coast_inverse((d->nominal_voltage_v * row->command_wheel[i] - emf) / volts, emf / volts, d->time_ratio);
        if (!(fabs(value) <= 1.0)) value = 0.0;
        row->duty[i] = value;
        row->duty_ns[i] = (int64_t)floor(d->motor_sign[i] * value * d->period_ns + 0.5);
    }
    for (int i = 0; i < 2; i++) { row->reference_velocity_rad_s[i] = r->rate_rad_s[i]; row->reference_angle_rad[i] = r->angle_rad[i]; }
    row->reference_yaw_rad[0] = r->yaw_rad; row->reference_yaw_rad[1] = r->yaw_rate_rad_s;
    memcpy(row->gains, g, sizeof row->gains);
    return limits;
}

/* One engaged tick with one EKF; the first tick (reset) is left to the caller. */
void robot_step(RobotP *p, RobotS *s, EstimatorP *ep, EstimatorS *es, Frame *row)
{
    int missing = sensors(&p->sensors, &s->sensors, row);
    int64_t limits = (missing & 1 ? IMU_MISSING : 0) | (missing & 2 ? JUMP : 0), valid = 255 & ~(missing & 1 ? 0xC3 : 0) & ~(missing & 2 ? 0x38 : 0);
    int64_t alarms = check_timing(&p->health, &s->health, row, limits);
    if (!check_wheels(&p->health, &s->health, row, s->spin_coupling_rad_s - row->gyro_rad_s[2], cos(row->attitude_rad[0]) * cos(row->attitude_rad[1]))) { limits |= DISAGREE; valid &= ~0x38; }
    for (int i = 0; i < 3; i++) { s->measured[i] = row->gyro_rad_s[i]; s->measured[3 + i] = row->body_angle_rad[i]; }
    s->measured[6] = row->acceleration_m_s2[0]; s->measured[7] = row->acceleration_m_s2[1];
    for (int i = 0; i < 2; i++) {
        OdometryS *o = &s->odometry;
        o->turn_rad[i] = row->body_angle_rad[i] - o->body_angle_rad[i] + 0.5 * p->dt_s * (row->gyro_rad_s[i] + o->gyro_rad_s[i]);
        o->body_angle_rad[i] = row->body_angle_rad[i];
        o->gyro_rad_s[i] = row->gyro_rad_s[i];
    }
    ekf_step(&ep->ekf, &es->filter, s->applied, s->measured, valid);
    double *e = row->estimates[0], *x = es->filter.x;
    row->estimator_flags[0] = es->filter.status;
    for (int i = 0; i < 3; i++) e[i] = x[i];
    for (int i = 0; i < 5; i++) e[3 + i] = x[5 + i];
    if (ep->dmp_attitude) for (int i = 0; i < 3; i++) e[i] = row->attitude_rad[i];
    double c = cos(e[2]), n = sin(e[2]);
    if (p->odometry) {
        double *turn = s->odometry.turn_rad, x = turn[0] / cos(e[1]), y = (turn[1] - sin(e[0]) * sin(e[1]) * x) / cos(e[0]);
        double h = 0.5 * p->dt_s * e[5], shrink = 1 - 0.5 * h * h, cm = c * shrink + n * h, nm = n * shrink - c * h;
        es->ball_angle_rad[0] += cm * x - nm * y;
        es->ball_angle_rad[1] += nm * x + cm * y;
    } else {
        es->ball_angle_rad[0] += p->dt_s * (c * e[6] - n * e[7]);
        es->ball_angle_rad[1] += p->dt_s * (n * e[6] + c * e[7]);
    }
    e[8] = es->ball_angle_rad[0]; e[9] = es->ball_angle_rad[1];
    for (int i = 0; i < 16; i++) { row->state_estimate[i] = x[i]; row->state_variance[i] = es->filter.P[i][i]; }
    memcpy(row->innovation, es->filter.innovation, sizeof row->innovation);
    limits |= control(p, s, row);
    double total = 0.0;
    for (int i = 0; i < 10; i++) total += e[i] + row->error[i];
    for (int i = 0; i < 3; i++) total += row->command_feedback[i] + row->command_wheel[i];
    if (!(fabs(total) < INFINITY)) limits |= NOT_FINITE;
    alarms |= judge(&p->health, &s->health, row, s->battery_v, &limits);
    s->spin_coupling_rad_s = e[1] * e[6] - e[0] * e[7];
    row->limits = limits; row->alarms = alarms;
    for (int i = 0; i < 3; i++) s->applied[i] = fabs(row->command_applied[i]) < INFINITY ? row->command_applied[i] : 0.0;
}

void many_ekf_steps(EkfParameters *p, Filter *s, const double *u, const double *y, long n) { for (long i = 0; i < n; i++) ekf_step(p, s, u, y, 255); }
void many_robot_steps(RobotP *p, RobotS *s, EstimatorP *ep, EstimatorS *es, Frame *rows, long count, long n)
{ for (long i = 0; i < n; i++) robot_step(p, s, ep, es, rows + i % count); }
