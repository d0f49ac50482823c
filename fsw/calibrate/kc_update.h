/* UPDATE, REFINE, LEARN, REPORT: estimator, Gaussian process, what the newest pose taught. Each takes as many
 * steps as its computations need; it answers STAY until they are done. */
#ifndef KC_UPDATE_H
#define KC_UPDATE_H

#include "kc_channels.h"
#include "kc_choice.h"
#include "kc_view.h"

/* Where a state of the update stands between two steps. */
typedef struct {
    uint32_t part, i;
    kc_fit_quality_t first; /* estimate of the first start */
    kc_residual_t sum2; /* of predicted variances */
} kc_update_t;

/* A new calibration that estimates the coefficients of free_mask. */
void kc_update_start(kc_latest_t *latest, kc_est_t *est, kc_arena_calibration_t *work, const kc_view_t *view,
                     uint64_t free_mask);
/* Bound of its instructions. */
uint64_t kc_update_start_cost(const kc_view_t *view);
/* One of the four states begins. */
void kc_update_begin(kc_update_t *cursor);
/* Residual before, objective, first solution. */
kc_outcome_t kc_update_solve(kc_update_t *cursor, kc_latest_t *latest, kc_est_t *est, const kc_gp_t *gp,
                             const kc_view_t *view, kc_work_t *work);
/* Second start if the first estimate is not good. */
kc_outcome_t kc_update_refine(kc_update_t *cursor, kc_latest_t *latest, kc_est_t *est, const kc_view_t *view,
                              kc_work_t *work);
/* Outliers, correction for aiming, Gaussian process; ABORT on a model mismatch. AGAIN: the estimate is to be
 * repeated without one of the local initial poses. */
kc_outcome_t kc_update_learn(kc_update_t *cursor, kc_latest_t *latest, kc_est_t *est, kc_plan_t *plan,
                             kc_arena_calibration_t *arena, const kc_view_t *view, kc_work_t *work,
                             kc_out_t *out);
/* Predicted uncertainty, whether more poses are needed, progress. */
kc_outcome_t kc_update_report(kc_update_t *cursor, kc_latest_t *latest, kc_evaluated_t *evaluated,
                              kc_evaluation_t *evaluation, const kc_view_t *view, kc_work_t *work,
                              kc_out_t *out);

#endif
