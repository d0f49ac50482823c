/* The approach: last motion before a measurement. Backlash, friction and wind-up displace a joint by an
 * amount that depends on the side from which it came, and a servo always comes from the side of its error.
 * If CONFIG enables it, every joint moves back by approach_rad to a side chosen at random and comes from
 * there, so that both sides occur and the effect can be identified later. */
#include <string.h>

#include "kc_app_priv.h"
#include "kc_libm.h"
#include "kc_rng.h"

enum { NONE = 0, DRAWING_BACK = 1, COMING = 2 };

/* Where a joint at q moves back to. The side is changed if the other one has more room, so that the arm
 * stays within its limits and the servo bound. */
static double start_of(kc_app_t *app, double q, double lo, double hi)
{
    double by = app->tables.active.config.approach_rad;
    int below = kc_rng_below(&app->cal.rng, 2u) == 0u;
    if ((below ? q - lo : hi - q) < by) { below = q - lo > hi - q; }
    return below ? kc_max(q - by, kc_min(lo, q)) : kc_min(q + by, kc_max(hi, q));
}

int kc_approach_begin(kc_app_t *app, kc_out_t *out)
{
    const kc_active_t *a = &app->tables.active;
    kc_leg_t *l = &app->leg;
    double q[KC_JOINT_MAX], lo[KC_JOINT_MAX], hi[KC_JOINT_MAX];
    int first = kc_space_local(&a->space, (uint32_t)app->cal.candidate);
    if (a->config.approach_rad <= 0.0 || first) { return 0; }
    memcpy(l->q_meas, l->q_target, sizeof l->q_meas);
    kc_move_box(app, (uint32_t)app->cal.candidate, lo, hi);
    for (uint32_t j = 0u; j < a->arm.n_joints; j++) { q[j] = start_of(app, l->q_meas[j], lo[j], hi[j]); }
    l->approach = DRAWING_BACK;
    if (kc_move_near(app, out, q)) { kc_app_enter(app, KC_ST_SERVO); }
    return 1;
}

int kc_approach_arrived(kc_app_t *app, kc_out_t *out)
{
    kc_leg_t *l = &app->leg;
    if (l->approach == NONE) { return 0; }
    if (l->approach == DRAWING_BACK) {
        l->approach = COMING;
        (void)kc_move_near(app, out, l->q_meas);
        return 1;
    }
    l->approach = NONE; /* the pan-tilt unit points there already */
    kc_measure_begin(app);
    kc_move_settle(app, KC_ST_MEASURE);
    return 1;
}
