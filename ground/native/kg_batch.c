#include "kg_batch.h"

#include <string.h>

#include "kc_libm.h"
#include "kc_vec.h"

static bool looks_at_view(const kc_basis_t *b) { return kc_var_from(b->var) == KC_FROM_VIEW; }

static uint32_t view_passes(const kc_terms_t *terms)
{
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        if (looks_at_view(&terms->term[k].basis[0]) || looks_at_view(&terms->term[k].basis[1])) {
            return KG_VIEW_PASS_MAX;
        }
    }
    return 1u;
}

static bool on_camera_side(const kc_terms_t *terms)
{
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        if (terms->term[k].frame >= KC_FRAME_CAMERA) { return true; }
    }
    return false;
}

/* The residual alone, to rounding that of kc_model_residual: without corrections on the camera side, where the
 * camera stands plays no part, and no derivative is worked out. */
static void residual(const kc_fixed_t *fixed, const kc_obs_t *obs, const kc_loads_t *loads, bool camera_side,
                     double r[6], kc_eval_t *ev)
{
    kc_pose_t M;
    if (camera_side) {
        (void)kc_fixed_residual(fixed, obs, loads, r, ev);
        return;
    }
    kc_fixed_eval(fixed, &obs->ctx, loads, false, ev);
    kc_pose_from_quat(obs->p_m, obs->q_wxyz, &M);
    kc_pose_residual(&M, &ev->T, r);
}

/* Tool in the sensor frame as the residual says; returns how far that is from what ctx held [m]. */
static double set_view(kc_obs_t *obs, const double r[6], bool keep_image)
{
    kc_ctx_t *ctx = &obs->ctx;
    double R[9], d[3], seen[3], moved = 0.0;
    kc_quat_to_R(obs->q_cam_wxyz, R);
    for (uint32_t i = 0u; i < 3u; i++) { d[i] = obs->p_m[i] - r[i] - obs->p_cam_m[i]; }
    kc_m3t_mul_v3(R, d, seen);
    for (uint32_t i = 0u; i < 3u; i++) {
        moved = kc_max(moved, kc_fabs(seen[i] - ctx->p_cam_tool_m[i]));
        ctx->p_cam_tool_m[i] = seen[i];
    }
    if (!keep_image && seen[2] > 0.0) {
        ctx->u_norm = seen[0] / seen[2];
        ctx->v_norm = seen[1] / seen[2];
    }
    return moved;
}

void kg_hold(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, uint32_t n,
             const kc_obs_t *obs, bool keep_image, kc_obs_t *held, kc_loads_t *loads)
{
    const uint32_t passes = view_passes(terms);
    const bool camera_side = on_camera_side(terms);
    double r[6];
    kc_eval_t ev;
    kc_fixed_t fixed;
    kc_model_fix(arm, terms, coef, &fixed);
    for (uint32_t i = 0u; i < n; i++) {
        held[i] = obs[i];
        kc_fixed_loads(&fixed, &held[i].ctx, &loads[i]);
        for (uint32_t pass = 0u; pass < passes; pass++) {
            residual(&fixed, &held[i], &loads[i], camera_side, r, &ev);
            if (set_view(&held[i], r, keep_image) <= KG_VIEW_TOL_M) { break; }
        }
    }
}

static void put_jacobian(const kc_eval_t *ev, uint32_t rows, uint32_t n_coef, double *J)
{
    for (uint32_t c = 0u; c < rows; c++) {
        for (uint32_t k = 0u; k < n_coef; k++) { J[c * n_coef + k] = ev->J[k][c]; }
    }
}

static void put_twist(const kc_eval_t *ev, uint32_t rows, uint32_t n_joints, double *twist)
{
    for (uint32_t f = 0u; f < KG_FRAMES(n_joints); f++) {
        const uint32_t frame = f <= n_joints ? f : KC_FRAME_TOOL + (f - n_joints - 1u);
        for (uint32_t k = 0u; k < 6u; k++) {
            double row[6];
            kc_model_twist(ev, frame, k, row);
            memcpy(&twist[(6u * f + k) * rows], row, rows * sizeof(double));
        }
    }
}

static void put_joints(const kc_eval_t *ev, uint32_t rows, uint32_t n_joints, double *Jq)
{
    for (uint32_t c = 0u; c < rows; c++) {
        for (uint32_t j = 0u; j < n_joints; j++) { Jq[c * n_joints + j] = ev->Jq[j][c]; }
    }
}

void kg_evaluate(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, uint32_t n, uint32_t rows,
                 const kc_obs_t *held, const kc_loads_t *loads, double *r, double *J, double *twist,
                 double *Jq)
{
    const size_t n_coef = terms->n_coef, n_joints = arm->n_joints;
    double ri[6];
    kc_eval_t ev;
    kc_fixed_t fixed;
    kc_model_fix(arm, terms, coef, &fixed);
    for (size_t i = 0u; i < n; i++) {
        (void)kc_fixed_residual(&fixed, &held[i], &loads[i], ri, &ev);
        if (r != NULL) { memcpy(&r[i * rows], ri, rows * sizeof(double)); }
        if (J != NULL) { put_jacobian(&ev, rows, terms->n_coef, &J[i * rows * n_coef]); }
        if (twist != NULL) {
            put_twist(&ev, rows, arm->n_joints, &twist[i * KG_FRAMES(n_joints) * 6u * rows]);
        }
        if (Jq != NULL) { put_joints(&ev, rows, arm->n_joints, &Jq[i * rows * n_joints]); }
    }
}

void kg_residuals(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, uint32_t n, uint32_t rows,
                  const kc_obs_t *held, const kc_loads_t *loads, double *r)
{
    const bool camera_side = on_camera_side(terms);
    double ri[6];
    kc_eval_t ev;
    kc_fixed_t fixed;
    kc_model_fix(arm, terms, coef, &fixed);
    for (size_t i = 0u; i < n; i++) {
        residual(&fixed, &held[i], &loads[i], camera_side, ri, &ev);
        memcpy(&r[i * rows], ri, rows * sizeof(double));
    }
}

void kg_poses(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, uint32_t n,
              const kc_obs_t *held, const kc_loads_t *loads, kc_pose_t *pose, double *J)
{
    const size_t n_coef = terms->n_coef;
    kc_eval_t ev;
    kc_fixed_t fixed;
    kc_model_fix(arm, terms, coef, &fixed);
    for (size_t i = 0u; i < n; i++) {
        kc_fixed_eval(&fixed, &held[i].ctx, &loads[i], J != NULL, &ev);
        if (pose != NULL) { pose[i] = ev.T; }
        if (J != NULL) { put_jacobian(&ev, 6u, terms->n_coef, &J[i * 6u * n_coef]); }
    }
}

void kg_basis(const kc_basis_t *basis, uint32_t n, const kc_obs_t *held, const kc_loads_t *loads, double *out)
{
    for (uint32_t i = 0u; i < n; i++) { out[i] = kc_basis_eval(basis, &held[i].ctx, &loads[i]); }
}

void kg_frames(const kc_arm_t *arm, uint32_t n, const double *q, kc_pose_t *frames)
{
    const size_t joints = arm->n_joints;
    kc_pose_t tool;
    kc_pose_from_quat(arm->tool_xyz_m, arm->tool_quat_wxyz, &tool);
    for (size_t i = 0u; i < n; i++) {
        kc_pose_t *T = &frames[i * (joints + 2u)];
        kc_pose_from_quat(arm->base_xyz_m, arm->base_quat_wxyz, &T[0]);
        for (size_t j = 0u; j < joints; j++) {
            T[j + 1u] = T[j];
            kc_arm_link(&arm->joint[j], q[i * joints + j], &T[j + 1u]);
        }
        kc_pose_mul(&T[joints], &tool, &T[joints + 1u]);
    }
}
