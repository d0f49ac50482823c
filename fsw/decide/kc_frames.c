#include "kc_frames.h"

#include <string.h>

#include "kc_libm.h"
#include "kc_vec.h"

void kc_frames_clear(kc_frames_t *f) { memset(f, 0, sizeof *f); }

/* Position and rotation vector (camera axes) of a frame against the first one. */
static void difference(const kc_frames_t *f, const kc_detection_t *det, double dp[3], double dw[3])
{
    kc_pose_t T;
    double r[6];
    kc_v3_copy(det->p_cam_tool_m, T.p_m);
    kc_quat_to_R(det->q_cam_tool_wxyz, T.R);
    kc_pose_residual(&T, &f->first, r);
    kc_v3_copy(r, dp);
    kc_v3_copy(&r[3], dw);
}

void kc_frames_jump(const kc_frames_t *f, const kc_detection_t *det, double *pos_m, double *rot_rad)
{
    double dp[3], dw[3];
    *pos_m = 0.0;
    *rot_rad = 0.0;
    if (f->n == 0u) { return; }
    difference(f, det, dp, dw);
    kc_v3_add_scaled(dp, -1.0 / (double)f->n, f->dp_m, dp);
    kc_v3_add_scaled(dw, -1.0 / (double)f->n, f->dw_rad, dw);
    *pos_m = kc_v3_norm(dp);
    *rot_rad = kc_v3_norm(dw);
}

static void add_scalars(kc_frames_t *f, const kc_detection_t *d, const kc_arm_state_t *arm,
                        const kc_pantilt_state_t *pantilt)
{
    f->range_m += d->range_m;
    f->incid_rad += d->incid_rad;
    f->u_px += d->u_px;
    f->v_px += d->v_px;
    f->rms_px += d->rms_px;
    f->rms_alt_px += d->rms_alt_px;
    f->pan_rad += pantilt->pan_rad;
    f->tilt_rad += pantilt->tilt_rad;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        f->q[j] += arm->q[j];
        f->dq[j] += arm->dq[j];
    }
    for (uint32_t i = 0u; i < 8u * KC_TAG_MAX; i++) { f->corner_px[i] += d->corner_px[i]; }
    for (uint32_t i = 0u; i < 36u; i++) { f->cov[i] += d->cov[i]; }
}

static bool same_tags(const kc_detection_t *a, const kc_detection_t *b)
{
    bool same = a->n_tags == b->n_tags;
    for (uint32_t i = 0u; i < a->n_tags; i++) { same = same && a->tag_id[i] == b->tag_id[i]; }
    return same;
}

void kc_frames_add(kc_frames_t *f, const kc_detection_t *det, const kc_arm_state_t *arm,
                   const kc_pantilt_state_t *pantilt)
{
    double dp[3], dw[3];
    if (f->n == 0u) {
        f->det = *det;
        f->same_tags = true;
        kc_v3_copy(det->p_cam_tool_m, f->first.p_m);
        kc_quat_to_R(det->q_cam_tool_wxyz, f->first.R);
    }
    difference(f, det, dp, dw);
    kc_v3_add_scaled(f->dp_m, 1.0, dp, f->dp_m);
    kc_v3_add_scaled(f->dw_rad, 1.0, dw, f->dw_rad);
    f->same_tags = f->same_tags && same_tags(&f->det, det);
    add_scalars(f, det, arm, pantilt);
    f->n++;
}

/* Covariance of the mean of n frames whose errors are correlated by frame_shared:
 * C (1 + (n - 1) shared) / n. What all poses share (lens, tag size) stays too: no variance goes below
 * its floor. */
static void mean_cov(const kc_frames_t *f, const kc_config_t *c, double cov[36])
{
    double n = (double)f->n;
    double share = (1.0 + (n - 1.0) * c->frame_shared) / n;
    for (uint32_t i = 0u; i < 36u; i++) { cov[i] = f->cov[i] / n * share; }
    for (uint32_t i = 0u; i < 6u; i++) {
        double floor = i < 3u ? c->sigma_pos_min_m : c->sigma_rot_min_rad;
        cov[7u * i] = kc_max(cov[7u * i], floor * floor);
    }
}

static void mean_pose(const kc_frames_t *f, kc_detection_t *d)
{
    double n = (double)f->n, w[3], E[9], R[9];
    kc_v3_add_scaled(f->first.p_m, 1.0 / n, f->dp_m, d->p_cam_tool_m);
    for (uint32_t i = 0u; i < 3u; i++) { w[i] = f->dw_rad[i] / n; }
    kc_R_exp(w, E);
    kc_m3_mul(E, f->first.R, R);
    kc_R_to_quat(R, d->q_cam_tool_wxyz);
}

static void mean_detection(const kc_frames_t *f, const kc_config_t *c, kc_detection_t *d)
{
    double n = (double)f->n;
    *d = f->det;
    mean_pose(f, d);
    mean_cov(f, c, d->cov);
    d->range_m = f->range_m / n;
    d->incid_rad = f->incid_rad / n;
    d->u_px = f->u_px / n;
    d->v_px = f->v_px / n;
    d->rms_px = f->rms_px / n;
    d->rms_alt_px = f->rms_alt_px / n;
    if (!f->same_tags) { return; }
    for (uint32_t i = 0u; i < 8u * KC_TAG_MAX; i++) { d->corner_px[i] = f->corner_px[i] / n; }
}

void kc_frames_mean(const kc_frames_t *f, const kc_config_t *config, kc_detection_t *det, kc_arm_state_t *arm,
                    kc_pantilt_state_t *pantilt)
{
    double n = (double)f->n;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        arm->q[j] = f->q[j] / n;
        arm->dq[j] = f->dq[j] / n;
    }
    pantilt->pan_rad = f->pan_rad / n;
    pantilt->tilt_rad = f->tilt_rad / n;
    mean_detection(f, config, det);
}
