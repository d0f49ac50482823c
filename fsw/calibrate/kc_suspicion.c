#include "kc_suspicion.h"

#include "kc_libm.h"
#include "kc_local.h"

/* A term that moves the tool as the joint of its frame does. */
static bool is_offset(const kc_arm_t *arm, const kc_term_t *t)
{
    uint32_t comp = arm->joint[t->frame].type == KC_PRISMATIC ? (uint32_t)KC_TZ : (uint32_t)KC_RZ;
    return t->comp == comp && t->basis[0].var == (uint8_t)KC_VAR_ONE &&
           t->basis[1].var == (uint8_t)KC_VAR_ONE;
}

uint64_t kc_suspicion_offsets(const kc_active_t *tables, uint32_t joints, uint64_t mask)
{
    uint64_t found = 0u;
    for (uint32_t i = 0u; i < tables->terms.n_term; i++) {
        const kc_term_t *t = &tables->terms.term[i];
        bool in = t->frame < tables->arm.n_joints && (joints >> t->frame & 1u) != 0u;
        if (in && is_offset(&tables->arm, t)) { found |= (uint64_t)1u << t->coef; }
    }
    return found & mask;
}

/* Of a coefficient if nothing is known but that it is inside its bounds. */
static double wide(const kc_est_t *est, const kc_coef_t *k)
{
    return est->opt.use_prior != 0u && k->prior_sigma > 0.0 ? k->prior_sigma : kc_est_bound_sigma(k);
}

/* With this chance wide, else narrow: the variance of the mixture. */
static double mixed(double chance, double wide, double narrow)
{
    return kc_sqrt(chance * wide * wide + (1.0 - chance) * narrow * narrow);
}

void kc_suspicion_begin(kc_est_t *est, const kc_view_t *view, const kc_suspects_t *suspects, kc_out_t *out)
{
    const kc_active_t *a = view->tables;
    for (uint32_t c = 0u; c < a->terms.n_coef; c++) {
        const kc_coef_t *k = &a->terms.coef[c];
        double most = wide(est, k);
        est->prior_sigma[c] = kc_min(kc_max(a->kin.sigma[c], a->config.rest_part * k->scale), most);
    }
    for (uint32_t j = 0u; j < a->arm.n_joints; j++) {
        uint64_t offsets = kc_suspicion_offsets(a, 1u << j, ~(uint64_t)0u);
        double chance = kc_min(suspects->chance[j], 1.0);
        for (uint32_t c = 0u; c < a->terms.n_coef; c++) {
            if ((offsets >> c & 1u) == 0u) { continue; }
            est->prior_sigma[c] = mixed(chance, wide(est, &a->terms.coef[c]), est->prior_sigma[c]);
        }
    }
    est->prior_mean = a->kin.value;
    est->by_prior = 1u;
    kc_event(&out->events, KC_EVT_CAL_SUSPECTS, -1, (double)suspects->joints, (double)suspects->suspects);
}

bool kc_suspicion_fails(kc_est_t *est, const kc_view_t *view, kc_out_t *out)
{
    const kc_config_t *c = &view->tables->config;
    double p = 0.0;
    if (est->by_prior == 0u || !kc_local_doubt(c, est, view->latest->status, &p)) { return false; }
    est->by_prior = 0u;
    kc_event(&out->events, KC_EVT_CAL_SUSPECTS_DROPPED, (int32_t)view->plan->n_meas, p, c->doubt_p);
    return true;
}
