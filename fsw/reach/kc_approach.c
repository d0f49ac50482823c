#include "kc_approach.h"

#include "kc_move.h"
#include "kc_reach.h"
#include "kc_rng.h"

bool kc_approach_wanted(const kc_view_t *view)
{
    return view->tables->config.approach_rad > 0.0 && !kc_view_local(view);
}

void kc_approach_start(const kc_view_t *view, uint64_t *rng, const double *q_meas, double *q)
{
    const kc_active_t *a = view->tables;
    double lo[KC_JOINT_MAX], hi[KC_JOINT_MAX];
    kc_move_box(a, (uint32_t)view->cal->candidate, lo, hi);
    for (uint32_t j = 0u; j < a->arm.n_joints; j++) {
        bool below = kc_rng_below(rng, 2u) == 0u;
        q[j] = kc_reach_draw_back(q_meas[j], lo[j], hi[j], a->config.approach_rad, below);
    }
}
