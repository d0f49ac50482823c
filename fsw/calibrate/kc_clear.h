/* Whether an arm whose errors are known in part stands clear at a pose: its clearance there with the latest correction,
 * and the standard deviation of it. The tool may be known well, and the gap between two links, which depends on other
 * errors, hardly at all. */
#ifndef KC_CLEAR_H
#define KC_CLEAR_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_acquire.h"
#include "kc_view.h"

#define KC_CLEAR_SIGMAS 2.0 /* of the clearance, on top of KC_GUARD_CLEAR_M */

/* Where the computation stands between two steps. */
typedef struct {
    uint32_t k; /* 0: the clearance itself is next; then coefficient k - 1 of kc_acq_work_t.idx */
    double clearance_m; /* KC_INF: nothing can touch */
    double slope_m[KC_COEF_MAX]; /* of the clearance, by coefficient, in units of its scale */
} kc_clear_t;

/* Clearance and slopes (forward differences) at joints q (KC_JOINT_MAX of them) by the coefficients that acq has the
 * covariance of. False: goes on in the next step, with the same arguments. One posture of the guard a coefficient. */
bool kc_clear_step(const kc_view_t *view, const float *q, const kc_acq_work_t *acq, kc_clear_t *clear,
                   kc_work_t *work);
/* Then: whether the clearance is at least KC_GUARD_CLEAR_M and KC_CLEAR_SIGMAS times its sigma. O(n_coef^2) */
bool kc_clear_enough(const kc_acq_work_t *acq, const kc_clear_t *clear);
#define KC_CLEAR_COST 40000u /* bound of its instructions */

#endif
