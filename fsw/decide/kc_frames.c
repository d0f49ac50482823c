#include "kc_frames.h"

#include <string.h>

#include "kc_libm.h"
#include "kc_vec.h"

void kc_frames_clear(kc_frames_t *frames) { memset(frames, 0, sizeof *frames); }

/* Position and rotation vector (camera axes) of a frame against the first one. */
static void difference(const kc_frames_t *frames, const kc_detection_t *det, double dp[3], double dw[3])
{
    kc_pose_t T;
    double r[6];
    kc_v3_copy(det->p_cam_tool_m, T.p_m);
    kc_quat_to_R(det->q_cam_tool_wxyz, T.R);
    kc_pose_residual(&T, &frames->first, r);
    kc_v3_copy(r, dp);
    kc_v3_copy(&r[3], dw);
}

void kc_frames_jump(const kc_frames_t *frames, const kc_detection_t *det, double *pos_m, double *rot_rad)
{
    double dp[3], dw[3];
    *pos_m = 0.0;
    *rot_rad = 0.0;
    if (frames->n == 0u) { return; }
    difference(frames, det, dp, dw);
    kc_v3_add_scaled(dp, -1.0 / (double)frames->n, frames->dp_m, dp);
    kc_v3_add_scaled(dw, -1.0 / (double)frames->n, frames->dw_rad, dw);
    *pos_m = kc_v3_norm(dp);
    *rot_rad = kc_v3_norm(dw);
}

static void add_scalars(kc_frames_t *frames, const kc_detection_t *det, const kc_arm_state_t *arm,
                        const kc_pantilt_state_t *pantilt)
{
    frames->range_m += det->range_m;
    frames->incid_rad += det->incid_rad;
    frames->u_px += det->u_px;
    frames->v_px += det->v_px;
    frames->rms_px += det->rms_px;
    frames->rms_alt_px += det->rms_alt_px;
    frames->pan_rad += pantilt->pan_rad;
    frames->tilt_rad += pantilt->tilt_rad;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        frames->q[j] += arm->q[j];
        frames->dq[j] += arm->dq[j];
    }
    for (uint32_t i = 0u; i < 8u * KC_TAG_MAX; i++) { frames->corner_px[i] += det->corner_px[i]; }
    for (uint32_t i = 0u; i < 36u; i++) { frames->cov[i] += det->cov[i]; }
}

static bool same_tags(const kc_detection_t *one, const kc_detection_t *other)
{
    bool same = one->n_tags == other->n_tags;
    for (uint32_t i = 0u; i < one->n_tags; i++) { same = same && one->tag_id[i] == other->tag_id[i]; }
    return same;
}

void kc_frames_add(kc_frames_t *frames, const kc_detection_t *det, const kc_arm_state_t *arm,
                   const kc_pantilt_state_t *pantilt)
{
    double dp[3], dw[3];
    if (frames->n == 0u) {
        frames->det = *det;
        frames->same_tags = true;
        kc_v3_copy(det->p_cam_tool_m, frames->first.p_m);
        kc_quat_to_R(det->q_cam_tool_wxyz, frames->first.R);
    }
    difference(frames, det, dp, dw);
    kc_v3_add_scaled(frames->dp_m, 1.0, dp, frames->dp_m);
    kc_v3_add_scaled(frames->dw_rad, 1.0, dw, frames->dw_rad);
    frames->same_tags = frames->same_tags && same_tags(&frames->det, det);
    add_scalars(frames, det, arm, pantilt);
    frames->n++;
}

/* Covariance of the mean of n frames whose errors are correlated by frame_shared:
 * C (1 + (n - 1) shared) / n. What all poses share (lens, tag size) stays too: no variance goes below
 * its floor. */
static void mean_cov(const kc_frames_t *frames, const kc_config_t *config, double cov[36])
{
    double n = (double)frames->n;
    double share = (1.0 + (n - 1.0) * config->frame_shared) / n;
    for (uint32_t i = 0u; i < 36u; i++) { cov[i] = frames->cov[i] / n * share; }
    for (uint32_t i = 0u; i < 6u; i++) {
        double floor = i < 3u ? config->sigma_pos_min_m : config->sigma_rot_min_rad;
        cov[7u * i] = kc_max(cov[7u * i], floor * floor);
    }
}

static void mean_pose(const kc_frames_t *frames, kc_detection_t *det)
{
    double n = (double)frames->n, w[3], E[9], R[9];
    kc_v3_add_scaled(frames->first.p_m, 1.0 / n, frames->dp_m, det->p_cam_tool_m);
    for (uint32_t i = 0u; i < 3u; i++) { w[i] = frames->dw_rad[i] / n; }
    kc_R_exp(w, E);
    kc_m3_mul(E, frames->first.R, R);
    kc_R_to_quat(R, det->q_cam_tool_wxyz);
}

static void mean_detection(const kc_frames_t *frames, const kc_config_t *config, kc_detection_t *det)
{
    double n = (double)frames->n;
    *det = frames->det;
    mean_pose(frames, det);
    mean_cov(frames, config, det->cov);
    det->range_m = frames->range_m / n;
    det->incid_rad = frames->incid_rad / n;
    det->u_px = frames->u_px / n;
    det->v_px = frames->v_px / n;
    det->rms_px = frames->rms_px / n;
    det->rms_alt_px = frames->rms_alt_px / n;
    if (!frames->same_tags) { return; }
    for (uint32_t i = 0u; i < 8u * KC_TAG_MAX; i++) { det->corner_px[i] = frames->corner_px[i] / n; }
}

void kc_frames_mean(const kc_frames_t *frames, const kc_config_t *config, kc_detection_t *det,
                    kc_arm_state_t *arm, kc_pantilt_state_t *pantilt)
{
    double n = (double)frames->n;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
        arm->q[j] = frames->q[j] / n;
        arm->dq[j] = frames->dq[j] / n;
    }
    pantilt->pan_rad = frames->pan_rad / n;
    pantilt->tilt_rad = frames->tilt_rad / n;
    mean_detection(frames, config, det);
}
