#include "kc_observation.h"

#include <string.h>

#include "kc_libm.h"
#include "kc_vec.h"

/* Covariance from camera to base axes: both blocks turn with R. */
static void turn_cov(const double R[9], const double C[36], double out[36])
{
    for (uint32_t i = 0u; i < 6u; i++) {
        for (uint32_t j = 0u; j < 6u; j++) {
            const double *ri = &R[3u * (i % 3u)], *rj = &R[3u * (j % 3u)];
            const uint32_t bi = 3u * (i / 3u), bj = 3u * (j / 3u);
            double s = 0.0;
            for (uint32_t a = 0u; a < 3u; a++) {
                for (uint32_t b = 0u; b < 3u; b++) { s += ri[a] * C[6u * (bi + a) + bj + b] * rj[b]; }
            }
            out[6u * i + j] = s;
        }
    }
}

static void fill_ctx(const kc_camera_t *cam, const kc_detection_t *det, const kc_posture_t *at, kc_ctx_t *ctx)
{
    const kc_arm_state_t *arm = at->arm;
    memset(ctx, 0, sizeof *ctx);
    memcpy(ctx->q, arm->q, sizeof ctx->q);
    memcpy(ctx->dir, arm->dir, sizeof ctx->dir);
    memcpy(ctx->qdot, arm->dq, sizeof ctx->qdot);
    kc_v3_copy(arm->g_m_s2, ctx->g_m_s2);
    ctx->temp_c = arm->temp_c;
    ctx->t_s = at->t_s;
    ctx->payload_kg = arm->payload_kg;
    ctx->range_m = det->range_m;
    ctx->incid_rad = det->incid_rad;
    ctx->u_norm = (det->u_px - cam->cx_px) / cam->fx_px;
    ctx->v_norm = (det->v_px - cam->cy_px) / cam->fy_px;
    ctx->pan_rad = at->pantilt->pan_rad;
    ctx->tilt_rad = at->pantilt->tilt_rad;
    kc_v3_copy(det->p_cam_tool_m, ctx->p_cam_tool_m);
}

void kc_observation(const kc_camera_t *camera, const kc_detection_t *det, const kc_posture_t *at,
                    kc_obs_t *obs)
{
    kc_pose_t T_cam, T;
    memset(obs, 0, sizeof *obs);
    kc_camera_pose(camera, at->pantilt->pan_rad, at->pantilt->tilt_rad, &T_cam);
    kc_v3_copy(det->p_cam_tool_m, T.p_m);
    kc_quat_to_R(det->q_cam_tool_wxyz, T.R);
    kc_pose_mul(&T_cam, &T, &T);
    kc_v3_copy(T.p_m, obs->p_m);
    kc_R_to_quat(T.R, obs->q_wxyz);
    turn_cov(T_cam.R, det->cov, obs->cov);
    kc_v3_copy(T_cam.p_m, obs->p_cam_m);
    kc_R_to_quat(T_cam.R, obs->q_cam_wxyz);
    obs->has_rot = 1u;
    obs->has_cam = 1u;
    fill_ctx(camera, det, at, &obs->ctx);
}

void kc_observation_residual(const kc_fixed_t *fixed, const kc_obs_t *obs, double r[6], kc_pose_t *predicted)
{
    kc_loads_t work;
    kc_eval_t eval;
    (void)kc_fixed_miss(fixed, obs, kc_fixed_needed_loads(fixed, &obs->ctx, &work), r, &eval);
    if (predicted != NULL) { *predicted = eval.T; }
}

static void swap_solutions(kc_detection_t *det)
{
    kc_detection_t s = *det;
    memcpy(det->p_cam_tool_m, s.p_alt_m, sizeof det->p_cam_tool_m);
    memcpy(det->q_cam_tool_wxyz, s.q_alt_wxyz, sizeof det->q_cam_tool_wxyz);
    memcpy(det->p_alt_m, s.p_cam_tool_m, sizeof det->p_alt_m);
    memcpy(det->q_alt_wxyz, s.q_cam_tool_wxyz, sizeof det->q_alt_wxyz);
    det->rms_px = s.rms_alt_px;
    det->rms_alt_px = s.rms_px;
}

bool kc_observation_is_flipped(const kc_config_t *config, double rms_px, double rms_alt_px, double angle_rad,
                               double angle_alt_rad)
{
    return rms_alt_px <= config->flip_rms_ratio * rms_px && angle_alt_rad < angle_rad &&
           angle_alt_rad <= config->flip_trust_rad;
}

static double angle_to_prediction(const kc_camera_t *camera, const kc_fixed_t *fixed, const kc_posture_t *at,
                                  const kc_detection_t *det)
{
    kc_obs_t obs;
    double r[6];
    kc_observation(camera, det, at, &obs);
    kc_observation_residual(fixed, &obs, r, NULL);
    return kc_v3_norm(&r[3]);
}

void kc_observation_unflip(const kc_active_t *tables, const double *coef, const kc_posture_t *at,
                           kc_detection_t *det)
{
    kc_detection_t second = *det;
    kc_fixed_t fixed;
    if (det->n_tags == 0u) { return; }
    swap_solutions(&second);
    kc_model_fix(&tables->arm, &tables->terms, coef, &fixed);
    double angle_rad = angle_to_prediction(&tables->camera, &fixed, at, det);
    double angle_alt_rad = angle_to_prediction(&tables->camera, &fixed, at, &second);
    if (kc_observation_is_flipped(&tables->config, det->rms_px, det->rms_alt_px, angle_rad, angle_alt_rad)) {
        *det = second;
    }
}
