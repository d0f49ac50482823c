#include "kc_ik.h"

#include <string.h>

#include "kc_dls.h"
#include "kc_libm.h"
#include "kc_vec.h"

#define DAMPING_START 1e-2
#define DAMPING_MIN 1e-6
#define DAMPING_MAX 1e2
#define ITER_MAX 200u

/* Where the search stands: pose error of the corrected tool at q, and its Jacobian. */
typedef struct {
    double e[6], cost, Jq[KC_JOINT_MAX][6];
} point_t;

/* Pose error of the corrected tool at q, with the Jacobian in work. */
static double pose_error(const kc_fixed_t *fixed, const kc_pose_t *goal, const double *q, kc_eval_t *work,
                         double e[6])
{
    kc_dls_eval(fixed, q, work);
    kc_pose_residual(goal, &work->T, e);
    return kc_dls_cost(e);
}

static void keep(point_t *at, const double e[6], double cost, const kc_eval_t *work)
{
    memcpy(at->e, e, sizeof at->e);
    memcpy(at->Jq, work->Jq, sizeof at->Jq);
    at->cost = cost;
}

static bool inside(const double e[6], const kc_ik_opt_t *opt)
{
    return kc_v3_norm(e) <= opt->tol_pos_m && kc_v3_norm(&e[3]) <= opt->tol_rot_rad;
}

/* Start inside the limits. */
static void clip_start(const kc_arm_t *arm, double margin, double *q)
{
    for (uint32_t j = 0u; j < arm->n_joints; j++) {
        double mid = 0.5 * (arm->joint[j].q_min + arm->joint[j].q_max);
        double lo = kc_min(arm->joint[j].q_min + margin, mid);
        double hi = kc_max(arm->joint[j].q_max - margin, mid);
        q[j] = kc_clamp(q[j], lo, hi);
    }
}

/* Trial joints q + dq; KC_ERR_NUM when no step can be computed. */
static kc_status_t trial(const kc_arm_t *arm, const kc_ik_opt_t *opt, double damping, const point_t *at,
                         const double *q, double *q_try)
{
    double lo[KC_JOINT_MAX], hi[KC_JOINT_MAX], dq[KC_JOINT_MAX];
    kc_status_t st;
    for (uint32_t j = 0u; j < arm->n_joints; j++) {
        kc_dls_box(&arm->joint[j], opt->margin, q[j], &lo[j], &hi[j]);
    }
    st = kc_dls_step(at->Jq, arm->n_joints, at->e, damping, lo, hi, dq);
    kc_dls_limit(dq, arm->n_joints, opt->step_max);
    for (uint32_t j = 0u; j < arm->n_joints; j++) { q_try[j] = q[j] + dq[j]; }
    return st;
}

/* Levenberg-Marquardt: a step that makes the error smaller is kept and the damping eased, one that does
 * not is dropped and the damping raised. One evaluation per iteration. */
kc_status_t kc_ik_solve(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                        const kc_pose_t *goal, const kc_ik_opt_t *opt, double *q, kc_eval_t *work,
                        uint32_t *evals)
{
    double e[6], q_try[KC_JOINT_MAX];
    double damping = DAMPING_START, cost;
    point_t at;
    kc_fixed_t fixed;
    uint32_t n = 1u, iters = opt->iter_max < ITER_MAX ? opt->iter_max : ITER_MAX;
    clip_start(arm, opt->margin, q);
    kc_model_fix(arm, terms, coef, &fixed);
    cost = pose_error(&fixed, goal, q, work, e);
    keep(&at, e, cost, work);
    for (uint32_t i = 0u; i < iters && !inside(at.e, opt) && damping <= DAMPING_MAX; i++) {
        if (trial(arm, opt, damping, &at, q, q_try) != KC_OK) { break; }
        cost = pose_error(&fixed, goal, q_try, work, e);
        n++;
        if (cost < at.cost) { /* NaN fails */
            keep(&at, e, cost, work);
            memcpy(q, q_try, arm->n_joints * sizeof *q);
            damping = kc_max(damping * 0.3, DAMPING_MIN);
        } else {
            damping *= 4.0;
        }
    }
    if (evals != NULL) { *evals = n; }
    return inside(at.e, opt) ? KC_OK : KC_ERR_REACH;
}
