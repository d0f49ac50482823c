#include "kc_leave_out.h"

#include "kc_rot.h"
#include "kc_vec.h"

static bool agree(const kc_config_t *config, const kc_obs_t *a, const kc_obs_t *b)
{
    kc_pose_t Ta, Tb;
    double r[6];
    kc_v3_copy(a->p_m, Ta.p_m);
    kc_quat_to_R(a->q_wxyz, Ta.R);
    kc_v3_copy(b->p_m, Tb.p_m);
    kc_quat_to_R(b->q_wxyz, Tb.R);
    kc_pose_residual(&Ta, &Tb, r);
    return kc_v3_norm(r) <= config->jump_pos_m && kc_v3_norm(&r[3]) <= config->jump_rot_rad;
}

bool kc_leave_out_repeated(const kc_config_t *config, const kc_plan_t *plan, const kc_obs_t *obs, uint32_t i)
{
    bool repeated = false;
    for (uint32_t k = 0u; k < plan->n_meas; k++) {
        bool other = k != i && plan->cand_of[k] == plan->cand_of[i];
        repeated = repeated || (other && agree(config, &obs[k], &obs[i]));
    }
    return repeated;
}

/* The next observation to try without; 0 after the last one. */
static uint32_t next_trial(const kc_leave_out_t *search, const kc_config_t *config, const kc_plan_t *plan,
                           const kc_obs_t *obs)
{
    uint32_t i = search->trial;
    while (i < plan->n_meas && kc_leave_out_repeated(config, plan, obs, i)) { i++; }
    return i < plan->n_meas ? i + 1u : 0u;
}

kc_leave_out_answer_t kc_leave_out_next(kc_leave_out_t *search, const kc_config_t *config,
                                        const kc_plan_t *plan, const kc_obs_t *obs, bool fits, double cost,
                                        uint32_t *without)
{
    bool searching = search->trial > 0u || search->decided;
    bool good = fits && (*without == 0u || !kc_leave_out_repeated(config, plan, obs, *without - 1u));
    if (search->decided || (!searching && good)) {
        *search = (kc_leave_out_t){0};
        return good ? KC_LEAVE_OUT_DONE : KC_LEAVE_OUT_NONE;
    }
    if (searching && good && (search->best == 0u || cost < search->best_cost)) {
        search->best = search->trial;
        search->best_cost = cost;
    }
    search->trial = next_trial(search, config, plan, obs);
    search->decided = search->trial == 0u;
    *without = search->decided ? search->best : search->trial;
    return KC_LEAVE_OUT_AGAIN;
}
