#include "kc_rot.h"

#include "kc_vec.h"

/* Below this angle the series of log and exp are exact to the last digit. */
#define SMALL_RAD 1e-4
/* A quaternion shorter than this has no direction. */
#define SMALL_NORM 1e-12

void kc_pose_identity(kc_pose_t *T)
{
    for (int i = 0; i < 3; i++) { T->p_m[i] = 0.0; }
    for (int i = 0; i < 9; i++) { T->R[i] = (i % 4 == 0) ? 1.0 : 0.0; }
}

void kc_pose_mul(const kc_pose_t *A, const kc_pose_t *B, kc_pose_t *out)
{
    kc_pose_t C;
    kc_m3_mul_v3(A->R, B->p_m, C.p_m);
    kc_v3_add_scaled(C.p_m, 1.0, A->p_m, C.p_m);
    kc_m3_mul(A->R, B->R, C.R);
    *out = C;
}

void kc_pose_inv(const kc_pose_t *A, kc_pose_t *out)
{
    kc_pose_t C;
    kc_m3t_mul_v3(A->R, A->p_m, C.p_m);
    for (int i = 0; i < 3; i++) {
        C.p_m[i] = -C.p_m[i];
        for (int j = 0; j < 3; j++) { C.R[3 * i + j] = A->R[3 * j + i]; }
    }
    *out = C;
}

void kc_pose_screw(kc_pose_t *T, uint32_t axis, double shift_m, double angle_rad)
{
    if (!kc_is_zero(shift_m)) { kc_pose_shift(T, axis, shift_m); }
    if (!kc_is_zero(angle_rad)) {
        double sine, cosine;
        kc_sincos(angle_rad, &sine, &cosine);
        kc_pose_turn(T, axis, sine, cosine);
    }
}

void kc_pose_from_quat(const double xyz_m[3], const double q_wxyz[4], kc_pose_t *out)
{
    kc_v3_copy(xyz_m, out->p_m);
    kc_quat_to_R(q_wxyz, out->R);
}

double kc_quat_dist_rad(const double q1[4], const double q2[4])
{
    const double inv[4] = {q1[0], -q1[1], -q1[2], -q1[3]};
    double d[4];
    kc_quat_mul(inv, q2, d);
    return 2.0 * kc_atan2(kc_v3_norm(d + 1), kc_fabs(d[0]));
}

void kc_quat_mul(const double a[4], const double b[4], double out[4])
{
    const double w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    const double x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    const double y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    const double z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
    out[0] = w;
    out[1] = x;
    out[2] = y;
    out[3] = z;
}

kc_status_t kc_quat_normalize(double q[4])
{
    const double n = kc_sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!kc_finite(n) || n < SMALL_NORM) { return KC_ERR_NUM; }
    for (int i = 0; i < 4; i++) { q[i] /= n; }
    return KC_OK;
}

void kc_quat_to_R(const double q[4], double R[9])
{
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    R[0] = 1.0 - 2.0 * (y * y + z * z);
    R[1] = 2.0 * (x * y - w * z);
    R[2] = 2.0 * (x * z + w * y);
    R[3] = 2.0 * (x * y + w * z);
    R[4] = 1.0 - 2.0 * (x * x + z * z);
    R[5] = 2.0 * (y * z - w * x);
    R[6] = 2.0 * (x * z - w * y);
    R[7] = 2.0 * (y * z + w * x);
    R[8] = 1.0 - 2.0 * (x * x + y * y);
}

/* w > 0, or the first non-zero of the rest positive: one sign per rotation. */
static void canonical_sign(double q[4])
{
    int i = 0;
    while (i < 3 && !(kc_fabs(q[i]) > 0.0)) { i++; }
    const double s = q[i] < 0.0 ? -1.0 : 1.0;
    for (int k = 0; k < 4; k++) { q[k] = s * q[k] + 0.0; } /* + 0.0: no negative zeros */
}

void kc_R_to_quat(const double R[9], double q[4])
{
    /* Column k of 4 q q^T; its diagonal is four times the square of component k. The column
     * with the largest diagonal never divides by a small number. */
    const double t = R[0] + R[4] + R[8];
    const double d[4] = {1.0 + t, 1.0 + 2.0 * R[0] - t, 1.0 + 2.0 * R[4] - t, 1.0 + 2.0 * R[8] - t};
    int k = 0;
    for (int i = 1; i < 4; i++) {
        if (d[i] > d[k]) { k = i; }
    }
    const double wx = R[7] - R[5], wy = R[2] - R[6], wz = R[3] - R[1];
    const double xy = R[1] + R[3], xz = R[2] + R[6], yz = R[5] + R[7];
    const double col[4][4] = {{d[0], wx, wy, wz}, {wx, d[1], xy, xz}, {wy, xy, d[2], yz}, {wz, xz, yz, d[3]}};
    const double *c = col[k];
    const double n = kc_sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2] + c[3] * c[3]);
    for (int i = 0; i < 4; i++) { q[i] = c[i] / n; }
    canonical_sign(q);
}

void kc_R_log(const double R[9], double w_rad[3])
{
    double q[4];
    kc_R_to_quat(R, q);
    const double s = kc_v3_norm(q + 1);
    /* angle / sin(angle / 2), by its series near 0: 2 (1 + s^2 / 6) */
    const double f = s < SMALL_RAD ? 2.0 * (1.0 + s * s / 6.0) : 2.0 * kc_atan2(s, q[0]) / s;
    for (int i = 0; i < 3; i++) { w_rad[i] = f * q[i + 1]; }
}

void kc_R_exp(const double w_rad[3], double R[9])
{
    const double half = 0.5 * kc_v3_norm(w_rad);
    const double f = half < SMALL_RAD ? 0.5 * (1.0 - half * half / 6.0) : 0.5 * kc_sin(half) / half;
    const double q[4] = {kc_cos(half), f * w_rad[0], f * w_rad[1], f * w_rad[2]};
    kc_quat_to_R(q, R);
}

void kc_pose_residual(const kc_pose_t *meas, const kc_pose_t *model, double r[6])
{
    kc_pose_t inv;
    double D[9];
    kc_v3_sub(meas->p_m, model->p_m, r);
    kc_pose_inv(model, &inv);
    kc_m3_mul(meas->R, inv.R, D);
    kc_R_log(D, r + 3);
}
