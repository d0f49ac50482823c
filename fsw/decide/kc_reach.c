#include "kc_reach.h"

#include "kc_libm.h"

#define RANGE_MIN_M 0.1   /* nearer than this the tool is not measured */

kc_no_tags_t kc_reach_no_tags(const kc_tried_t *tried, bool at_seed)
{
    if (tried->detected) { return tried->retreated ? KC_NO_TAGS_SKIP : KC_NO_TAGS_RETREAT; }
    if (!tried->seed && !at_seed) { return KC_NO_TAGS_SEED; }
    return tried->searched ? KC_NO_TAGS_SKIP : KC_NO_TAGS_SEARCH;
}

void kc_reach_spiral(uint32_t i, double *x, double *y)
{
    int32_t cx = 0, cy = 0, dx = 0, dy = -1;
    for (uint32_t k = 0u; k < i; k++) { /* i <= config.search_steps <= 49 */
        if (cx == cy || (cx < 0 && cx == -cy) || (cx > 0 && cx == 1 - cy)) {
            int32_t t = dx;
            dx = -dy;
            dy = t;
        }
        cx += dx;
        cy += dy;
    }
    *x = (double)cx;
    *y = (double)cy;
}

uint32_t kc_reach_search_limit(const kc_camera_t *camera, const kc_config_t *config, uint32_t n_meas,
                               double residual_m, double range_m)
{
    if (n_meas == 0u) { return config->search_steps; }
    double half = kc_atan2(0.5 * (double)camera->height_px, camera->fy_px);
    double off = config->search_safety * kc_atan2(residual_m, kc_max(range_m, RANGE_MIN_M)) - 0.5 * half;
    double rings = kc_floor(kc_max(0.0, off) / config->search_step_rad + 0.999);
    double cells = (2.0 * rings + 1.0) * (2.0 * rings + 1.0) - 1.0;
    return cells < (double)config->search_steps ? (uint32_t)cells : config->search_steps;
}

double kc_reach_draw_back(double q, double lo, double hi, double by, bool below)
{
    if ((below ? q - lo : hi - q) < by) { below = q - lo > hi - q; }
    return below ? kc_max(q - by, kc_min(lo, q)) : kc_min(q + by, kc_max(hi, q));
}
