/* Inverse kinematics of the corrected arm: damped least squares with joint limits. */
#ifndef KC_IK_H
#define KC_IK_H

#include <stdint.h>

#include "kc_model.h"

typedef struct {
    uint32_t iter_max; /* 1..200 */
    double tol_pos_m, tol_rot_rad;
    double margin;   /* stay this far inside the joint limits [rad or m] */
    double step_max; /* largest joint step per iteration */
} kc_ik_opt_t;

/* Joints that bring the corrected tool (coef; NULL = nominal, without need of terms) to `goal`, starting from q (in and
 * out). KC_OK inside the tolerances; KC_ERR_REACH: not reached, q = closest found, inside the limits.
 * *evals (NULL: not wanted): how often the model was evaluated, at most iter_max + 1. Deterministic. */
kc_status_t kc_ik_solve(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                        const kc_pose_t *goal, const kc_ik_opt_t *opt, double *q, kc_eval_t *work,
                        uint32_t *evals);

#endif
