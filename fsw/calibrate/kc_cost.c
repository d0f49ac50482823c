#include "kc_cost.h"

#include <string.h>

#include "kc_libm.h"
#include "kc_path.h"

#define COST_MIN 1e-3 /* a table may state no time at all for frames and settling */

/* Time of a straight move at full speed [s]; q becomes its end. */
static double leg_s(const kc_active_t *tables, double *q, const double *to)
{
    double longest = 0.0;
    for (uint32_t j = 0u; j < tables->arm.n_joints; j++) {
        double speed = tables->arm.joint[j].speed_max * tables->config.speed_scale;
        longest = kc_max(longest, kc_fabs(to[j] - q[j]) / speed);
        q[j] = to[j];
    }
    return longest;
}

static double moves_s(const kc_view_t *view, uint32_t cand, const double *q)
{
    const kc_space_t *space = &view->tables->space;
    uint32_t from = view->cal->candidate < 0 ? 0u : KC_HUB_MAX + (uint32_t)view->cal->candidate, n = 0u;
    uint16_t path[KC_PATH_MAX + 1u];
    double at[KC_JOINT_MAX] = {0}, to[KC_JOINT_MAX] = {0}, sum = 0.0;
    memcpy(at, view->telemetry->arm.q, sizeof at);
    (void)kc_path_plan(space, from, KC_HUB_MAX + cand, path,
                       &n); /* without one, MOVE gives the candidate up */
    for (uint32_t i = 0u; i < n; i++) {
        kc_path_joints(space, path[i], to);
        sum += leg_s(view->tables, at, to);
    }
    return sum + leg_s(view->tables, at, q);
}

double kc_cost_candidate(const kc_view_t *view, uint32_t cand, const double *q)
{
    const kc_config_t *c = &view->tables->config;
    double steps = (double)*view->servo_steps, moves = moves_s(view, cand, q);
    double stops = steps + 1.0,
           frames = steps + (double)c->frames_per_meas; /* one a servo step, then the measurement */
    double rest = stops * (double)c->settle_us * 1e-6 + frames * c->frame_s;
    double cost = c->rate_cost == (uint8_t)KC_COST_ENERGY ? c->power_move_w * moves + c->power_idle_w * rest
                                                          : moves + rest;
    return kc_max(cost, COST_MIN);
}
