/* Rotations and rigid transforms.
 *
 * Quaternions are (w, x, y, z); either sign is the same rotation. Rotation matrices
 * are row-major 3x3. A pose maps tool coordinates to the frame it is expressed in.
 * No function here fails except where it says so; inputs must be finite. */
#ifndef KC_ROT_H
#define KC_ROT_H

#include <stdint.h>

#include "kc_status.h"
#include "kc_vec.h"

typedef struct {
    double p_m[3]; /* origin [m] */
    double R[9];   /* rotation matrix, row-major */
} kc_pose_t;

void kc_pose_identity(kc_pose_t *T);
/* out = A B. out may alias A or B. */
void kc_pose_mul(const kc_pose_t *A, const kc_pose_t *B, kc_pose_t *out);
/* out = A^-1. out may alias A. */
void kc_pose_inv(const kc_pose_t *A, kc_pose_t *out);
/* T <- T S, S on T's own axis (0 x, 1 y, 2 z): a shift; a turn by the angle of this sine and cosine; or a screw, both. */
static inline void kc_pose_shift(kc_pose_t *T, uint32_t axis, double shift_m)
{
    T->p_m[0] += shift_m * T->R[axis];
    T->p_m[1] += shift_m * T->R[3u + axis];
    T->p_m[2] += shift_m * T->R[6u + axis];
}
static inline void kc_pose_turn(kc_pose_t *T, uint32_t axis, double sine, double cosine)
{
    const uint32_t u = axis < 2u ? axis + 1u : 0u, v = axis > 0u ? axis - 1u : 2u; /* the next two axes */
    kc_m3_turn(T->R, u, v, sine, cosine);
}
void kc_pose_screw(kc_pose_t *T, uint32_t axis, double shift_m, double angle_rad);
/* Pose from origin and unit quaternion, as tables hold it. */
void kc_pose_from_quat(const double xyz_m[3], const double q_wxyz[4], kc_pose_t *out);

/* eq. 1: rotation angle between two unit quaternions, 0..pi [rad]; computed as
 * 2 atan2(|v|, |w|) of q1^-1 q2, which keeps its digits near 0 (METHOD.md 2). */
double kc_quat_dist_rad(const double q1[4], const double q2[4]);
void kc_quat_mul(const double a[4], const double b[4], double out[4]);
/* Scale to unit norm. KC_ERR_NUM, q unchanged, if the norm is not finite or < 1e-12. */
kc_status_t kc_quat_normalize(double q[4]);
void kc_quat_to_R(const double q[4], double R[9]);
/* Largest-component form; exact for half turns; result has w >= 0, and the first
 * non-zero of x, y, z is positive when w = 0. */
void kc_R_to_quat(const double R[9], double q[4]);
/* log: rotation vector [rad], |w| <= pi; and its inverse (Rodrigues). */
void kc_R_log(const double R[9], double w_rad[3]);
void kc_R_exp(const double w_rad[3], double R[9]);

/* Residual of METHOD.md 2: r = (p_meas - p_model ; log(R_meas R_model^T)), both in
 * the frame that the poses are expressed in. r: [m m m rad rad rad]. */
void kc_pose_residual(const kc_pose_t *meas, const kc_pose_t *model, double r[6]);

#endif
