#include "kc_servo.h"

#include <string.h>

#include "kc_dls.h"
#include "kc_libm.h"
#include "kc_vec.h"

/* A step that cannot take away this part of the squared error, even if the model were right, is useless. */
#define USEFUL 0.02

/* What a joint may still do: limits with margin, and the leash around the candidate's seed, inside which
 * the ground proved the arm safe. */
static void box_of(const kc_joint_t *joint, const kc_servo_opt_t *opt, double q, double q_seed, double *lo,
                   double *hi)
{
    kc_dls_box(joint, opt->margin, q, lo, hi);
    *lo = kc_max(*lo, kc_min(q_seed - opt->leash - q, 0.0));
    *hi = kc_min(*hi, kc_max(q_seed + opt->leash - q, 0.0));
}

kc_servo_result_t kc_servo_step(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                                const kc_pose_t *seen, const kc_pose_t *goal, const double *q,
                                const double *q_seed, const kc_servo_opt_t *opt, double *q_cmd,
                                kc_eval_t *work)
{
    double e[6], lo[KC_JOINT_MAX], hi[KC_JOINT_MAX], dq[KC_JOINT_MAX];
    uint32_t n = arm->n_joints;
    kc_status_t st;
    memcpy(q_cmd, q, n * sizeof *q);
    kc_pose_residual(goal, seen, e);
    if (kc_v3_norm(e) <= opt->tol_pos_m && kc_v3_norm(&e[3]) <= opt->tol_rot_rad) { return KC_SERVO_THERE; }
    kc_dls_eval(arm, terms, coef, q, work);
    for (uint32_t j = 0u; j < n; j++) { box_of(&arm->joint[j], opt, q[j], q_seed[j], &lo[j], &hi[j]); }
    st = kc_dls_step(work->Jq, n, e, opt->damping, lo, hi, dq);
    if (st != KC_OK || kc_dls_predicted(work->Jq, n, e, dq) > (1.0 - USEFUL) * kc_dls_cost(e)) {
        return KC_SERVO_STUCK;
    }
    kc_dls_limit(dq, n, opt->step_max / opt->gain);
    for (uint32_t j = 0u; j < n; j++) { q_cmd[j] += opt->gain * dq[j]; }
    return KC_SERVO_MOVE;
}
