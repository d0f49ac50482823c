/* Judging an estimate: does it need a second start, is it used for aiming, is it certain enough, is this the
 * arm that the paths were verified for? */
#ifndef KC_FIT_H
#define KC_FIT_H

#include <stdbool.h>

#include "kc_estimate.h"
#include "kc_plan.h"
#include "kc_tables.h"

/* What an estimate is compared by. */
typedef struct {
    kc_status_t status;
    double noise_scale, cost;
    uint32_t n_outliers;
    bool nothing_held; /* no requested coefficient was held, or none could be */
} kc_fit_quality_t;

/* The solver left a solution: it converged, or stopped at its best. */
bool kc_fit_solved(kc_status_t status);
kc_fit_quality_t kc_fit_quality(const kc_est_t *est, kc_status_t status);
/* Large errors like the paper's can make a first fit converge to a wrong minimum, where good observations look
 * like outliers: such a fit gets a second start. */
bool kc_fit_needs_second_start(const kc_config_t *config, const kc_fit_quality_t *first);
/* Whether the second start won: fewer outliers, then the lower cost. Only if nothing is held: a held
 * coefficient keeps the active table's value, not that of a trial. */
bool kc_fit_second_is_better(const kc_fit_quality_t *first, const kc_fit_quality_t *second);

/* Residual of a pose against its prediction, in position and rotation; also what is predicted of it: a sigma, a bound. */
typedef struct {
    double pos_m, rot_rad;
} kc_residual_t;

/* While the data do not determine all coefficients, an estimate can fit the measured poses and be far off
 * elsewhere. It is used for aiming once it has predicted a new pose twice as well as the correction in use; a
 * smaller gain can be chance. */
bool kc_fit_predicts_better(const kc_config_t *config, kc_residual_t with_new, kc_residual_t with_used);

/* Whether a pose that was not used yet was predicted so well: to within the requirement and the noise of its
 * measurement (cov, 6x6). */
bool kc_fit_checked(const kc_config_t *config, kc_residual_t residual, const double cov[36]);
/* Whether CONFIG requires an accuracy at all. */
bool kc_fit_required(const kc_config_t *config);
/* Whether it can be evaluated: every coefficient is determined, by twice as many rows as there are coefficients. */
bool kc_fit_determined(const kc_est_t *est, kc_status_t status);
/* Whether bounds of the error are within what is required; a requirement of 0 is none. */
bool kc_fit_meets(const kc_config_t *config, kc_residual_t bound);

/* Model mismatch: observations that no correction within its bounds explains. residual: residuals of the observations of
 * the plan with the estimate. True if the paths were not verified for such an arm; *worst is the newest such
 * observation, from 0. One is enough at the local initial poses, where one bad detection is left out beforehand
 * (kc_leave_out.h; it does not count here); later those of two poses are needed, since one can be a bad detection, and
 * what is wrong with a detection on the way to a pose may still be wrong there. */
bool kc_fit_mismatch(const kc_config_t *config, const kc_est_t *est, const kc_residual_t *residual,
                     const kc_plan_t *plan, uint32_t *worst);

#endif
