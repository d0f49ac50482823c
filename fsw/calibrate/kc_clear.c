#include "kc_clear.h"

#include <string.h>

#include "kc_guard.h"
#include "kc_libm.h"

#define STEP 1e-3 /* of forward differences, in scales of the coefficient */

static double clearance_m(kc_guard_request_t *request, const kc_view_t *view, uint32_t coef, double by,
                          uint64_t *cost)
{
    double changed[KC_COEF_MAX];
    memcpy(changed, view->latest->coef, sizeof changed);
    changed[coef] += by;
    request->coef = changed;
    double d = kc_guard_clearance_at(request, cost);
    request->coef = view->latest->coef;
    return d;
}

bool kc_clear_step(const kc_view_t *view, const float *q, const kc_acq_work_t *acq, kc_clear_t *clear,
                   kc_work_t *work)
{
    const kc_active_t *a = view->tables;
    double at[KC_JOINT_MAX];
    kc_ctx_t ctx;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { at[j] = (double)q[j]; }
    kc_view_ctx(view, 0u, &ctx);
    kc_guard_request_t request = {.arm = &a->arm,
                                  .terms = &a->terms,
                                  .coef = view->latest->coef,
                                  .space = &a->space,
                                  .ctx = &ctx,
                                  .q_from = at,
                                  .q_to = at};
    const uint64_t cost = kc_guard_clearance_cost(&request);
    for (; clear->k <= acq->n; clear->k++) {
        uint64_t used = 0u;
        if (!kc_work_take(work, cost)) { return false; }
        if (clear->k == 0u) {
            clear->clearance_m = clearance_m(&request, view, 0u, 0.0, &used);
        } else {
            const uint32_t i = clear->k - 1u, coef = acq->idx[i];
            const double h = STEP * a->terms.coef[coef].scale;
            clear->slope_m[i] = (clearance_m(&request, view, coef, h, &used) - clear->clearance_m) / STEP;
        }
        kc_work_return(work, cost - used);
    }
    return true;
}

bool kc_clear_enough(const kc_acq_work_t *acq, const kc_clear_t *clear)
{
    double sigma2_m2 = 0.0;
    if (!(clear->clearance_m < KC_INF)) { return true; }
    for (uint32_t i = 0u; i < acq->n; i++) {
        double sum_m = 0.0;
        for (uint32_t j = 0u; j < acq->n; j++) { sum_m += acq->M[i * KC_COEF_MAX + j] * clear->slope_m[j]; }
        sigma2_m2 += clear->slope_m[i] * sum_m;
    }
    const double sigma_m = kc_sqrt(sigma2_m2 < 0.0 ? 0.0 : sigma2_m2); /* NaN stays: not enough */
    return clear->clearance_m >= KC_GUARD_CLEAR_M + KC_CLEAR_SIGMAS * sigma_m;
}
