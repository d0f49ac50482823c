#include "kc_leave_out.h"

#include "kc_rot.h"
#include "kc_vec.h"

static bool agree(const kc_config_t *c, const kc_obs_t *a, const kc_obs_t *b)
{
    kc_pose_t Ta, Tb;
    double r[6];
    kc_v3_copy(a->p_m, Ta.p_m);
    kc_quat_to_R(a->q_wxyz, Ta.R);
    kc_v3_copy(b->p_m, Tb.p_m);
    kc_quat_to_R(b->q_wxyz, Tb.R);
    kc_pose_residual(&Ta, &Tb, r);
    return kc_v3_norm(r) <= c->jump_pos_m && kc_v3_norm(&r[3]) <= c->jump_rot_rad;
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
static uint32_t next_trial(const kc_leave_out_t *s, const kc_config_t *config, const kc_plan_t *plan,
                           const kc_obs_t *obs)
{
    uint32_t i = s->trial;
    while (i < plan->n_meas && kc_leave_out_repeated(config, plan, obs, i)) { i++; }
    return i < plan->n_meas ? i + 1u : 0u;
}

kc_leave_out_answer_t kc_leave_out_next(kc_leave_out_t *s, const kc_config_t *config, const kc_plan_t *plan,
                                        const kc_obs_t *obs, bool fits, double cost, uint32_t *without)
{
    bool searching = s->trial > 0u || s->decided;
    bool good = fits && (*without == 0u || !kc_leave_out_repeated(config, plan, obs, *without - 1u));
    if (s->decided || (!searching && good)) {
        *s = (kc_leave_out_t){0};
        return good ? KC_LEAVE_OUT_DONE : KC_LEAVE_OUT_NONE;
    }
    if (searching && good && (s->best == 0u || cost < s->best_cost)) {
        s->best = s->trial;
        s->best_cost = cost;
    }
    s->trial = next_trial(s, config, plan, obs);
    s->decided = s->trial == 0u;
    *without = s->decided ? s->best : s->trial;
    return KC_LEAVE_OUT_AGAIN;
}
