/* UPDATE, REFINE, LEARN, REPORT: estimator, Gaussian process, what the newest pose taught; one part a step. */
#ifndef KC_UPDATE_H
#define KC_UPDATE_H

#include "kc_app.h"
#include "kc_arena.h"
#include "kc_view.h"

/* A new calibration that estimates the coefficients of free_mask. */
void kc_update_start(kc_learned_t *l, kc_est_t *est, kc_arena_calibration_t *work, const kc_view_t *v,
                     uint64_t free_mask);
/* Residual before, objective, first solution. */
kc_outcome_t kc_update_solve(kc_learned_t *l, kc_est_t *est, const kc_gp_t *gp, const kc_view_t *v);
/* Second start if the first estimate is not good. */
kc_outcome_t kc_update_refine(kc_learned_t *l, kc_est_t *est, const kc_view_t *v);
/* Outliers, correction for aiming, Gaussian process; ABORT on a model mismatch. AGAIN: the estimate is to be
 * repeated without one of the local initial poses. */
kc_outcome_t kc_update_learn(kc_learned_t *l, kc_est_t *est, kc_plan_t *plan, kc_arena_calibration_t *work,
                             const kc_view_t *v, kc_out_t *out);
/* Predicted uncertainty, progress. */
kc_outcome_t kc_update_report(kc_learned_t *l, const kc_view_t *v, kc_out_t *out);

#endif
