#include "kc_propose.h"

#include <string.h>

#include "kc_chi2.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_observation.h"
#include "kc_vec.h"

#define PROPOSE_COST 2000000u /* bound of the instructions for covariance, image and putting in force */

/* ---- statistics ---- */

static void add_observation(kc_proposing_t *j, const kc_view_t *v, const kc_obs_t *obs)
{
    double W[36], r[6];
    kc_observation_residual(v->tables, v->tables->kin.value, obs, r, NULL);
    j->pos2 += kc_v3_dot(r, r);
    j->rot2 += kc_v3_dot(&r[3], &r[3]);
    j->n++;
    (void)kc_la_whiten(obs->cov, 6u, W); /* kc_est_add has checked it */
    kc_la_whiten_apply(W, 6u, r, r);
    for (uint32_t k = 0u; k < 6u; k++) { j->chi2_before += r[k] * r[k]; }
    kc_observation_residual(v->tables, v->est->coef, obs, r, NULL);
    kc_la_whiten_apply(W, 6u, r, r);
    for (uint32_t k = 0u; k < 6u; k++) { j->chi2_after += r[k] * r[k]; }
}

/* Residuals of the inliers with the table in force and with the estimate. False: goes on in the next step. */
static bool sum_observations(kc_proposing_t *j, const kc_view_t *v, kc_work_t *work)
{
    const uint64_t cost = 2u * kc_model_cost(&v->tables->arm, &v->tables->terms, true);
    for (; j->i_obs < v->est->n_obs; j->i_obs++) {
        if (v->est->outlier[j->i_obs]) { continue; }
        if (!kc_work_take(work, cost)) { return false; }
        add_observation(j, v, &v->est->obs[j->i_obs]);
    }
    return true;
}

static double p_no_change(const kc_proposing_t *j, const kc_view_t *v)
{
    const kc_est_t *e = v->est;
    if (e->rank == 0u || !kc_fit_solved(v->learned->status)) { return 1.0; }
    return kc_verdict_p_no_change(j->chi2_before - j->chi2_after, e->noise_scale, e->rank);
}

static bool estimated(uint8_t status)
{
    return status != (uint8_t)KC_COEF_MASKED && status != (uint8_t)KC_COEF_HELD;
}

/* ---- proposal ---- */

static void fill_kin(const kc_view_t *v, kc_kin_t *k)
{
    const kc_active_t *a = v->tables;
    const kc_est_t *e = v->est;
    double scale = kc_max(1.0, e->noise_scale);
    memset(k, 0, sizeof *k);
    k->n_coef = a->terms.n_coef;
    for (uint32_t c = 0u; c < k->n_coef; c++) {
        bool est = kc_fit_solved(v->learned->status) && estimated(e->status[c]);
        k->value[c] = est ? e->coef[c] : a->kin.value[c];
        k->sigma[c] = est ? scale * e->sigma[c] : a->kin.sigma[c];
    }
    k->arm_crc = a->crc[KC_TBL_ARM];
    k->terms_crc = a->crc[KC_TBL_TERMS];
    k->prev_crc = a->crc[KC_TBL_KIN];
    k->session = v->cal->session;
    k->n_poses = v->plan->n_meas;
    k->made_us = v->clock->clock_us;
}

/* Upper triangle of the scaled covariance, row by row, of n_coef rows. */
static void fill_cov(const kc_view_t *v, kc_proposal_t *p)
{
    double scale = kc_max(1.0, v->est->noise_scale);
    uint32_t k = 0u;
    if (!kc_fit_solved(v->learned->status)) { return; }
    for (uint32_t i = 0u; i < p->kin.n_coef; i++) {
        for (uint32_t j = i; j < p->kin.n_coef; j++) {
            p->cov[k++] = scale * scale * v->est->cov[i * KC_COEF_MAX + j];
        }
    }
}

/* RMS residual with the table in force, at the poses that the fit kept: those of fit_pos_m. */
static void fill_before(const kc_proposing_t *j, kc_proposal_t *p)
{
    p->before_pos_m = j->n > 0u ? kc_sqrt(j->pos2 / (double)j->n) : 0.0;
    p->before_rot_rad = j->n > 0u ? kc_sqrt(j->rot2 / (double)j->n) : 0.0;
}

static void fill_numbers(const kc_proposing_t *j, const kc_view_t *v, kc_proposal_t *p)
{
    const kc_est_t *e = v->est;
    memcpy(p->status, e->status, sizeof p->status);
    memcpy(p->confounded, e->confounded, sizeof p->confounded);
    p->session = v->cal->session;
    p->n_poses = v->plan->n_meas;
    p->n_outliers = e->n_outliers;
    p->rank = e->rank;
    p->n_free = e->n_free;
    p->dof = e->dof;
    p->chi2 = e->chi2;
    p->noise_scale = e->noise_scale;
    p->p_fit = e->dof > 0u ? kc_chi2_sf(e->chi2, e->dof) : 1.0;
    p->p_no_change = p_no_change(j, v);
    p->kkt = e->kkt;
    p->cond = e->cond;
    p->fit_pos_m = e->fit_pos_m;
    p->fit_rot_rad = e->fit_rot_rad;
    p->pred_pos_m = v->learned->pred.pos_m;
    p->pred_rot_rad = v->learned->pred.rot_rad;
    p->crc_kin_before = v->tables->crc[KC_TBL_KIN];
}

static void make(const kc_proposing_t *j, const kc_view_t *v, kc_proposal_t *p)
{
    fill_kin(v, &p->kin);
    fill_numbers(j, v, p);
    fill_before(j, p);
    fill_cov(v, p);
    p->verdict = (int32_t)kc_verdict(&v->tables->config, v->est, v->learned->status, p->p_fit,
                                     p->p_no_change);
}

/* Coefficients that the data could not determine. */
static void report_held(const kc_view_t *v, const kc_kin_t *kin, kc_out_t *out)
{
    const kc_est_t *e = v->est;
    if (e->rank == e->n_free) { return; }
    kc_event(&out->events, KC_EVT_CAL_RANK, -1, (double)e->rank, (double)e->n_free);
    for (uint32_t c = 0u; c < kin->n_coef; c++) {
        if (e->status[c] != (uint8_t)KC_COEF_HELD) { continue; }
        kc_event(&out->events, KC_EVT_CAL_HELD, (int32_t)c, kin->value[c], 0.0);
    }
}

/* ---- policy ---- */

/* Change of the predicted tool position over the search space. False: goes on in the next step. */
static bool sum_changes(kc_proposing_t *j, const kc_view_t *v, kc_work_t *work)
{
    const uint64_t cost = 2u * kc_model_cost(&v->tables->arm, &v->tables->terms, false);
    uint32_t n = v->tables->space.n_cand, stride = kc_view_stride(v);
    kc_kin_t kin;
    double d[3];
    fill_kin(v, &kin);
    for (; j->i_cand < n; j->i_cand += stride) {
        kc_pose_t before, after;
        if (!kc_work_take(work, cost)) { return false; }
        kc_view_pose(v, v->tables->kin.value, j->i_cand, &before);
        kc_view_pose(v, kin.value, j->i_cand, &after);
        kc_v3_sub(after.p_m, before.p_m, d);
        j->change2 += kc_v3_dot(d, d);
    }
    return true;
}

static double change_m(const kc_proposing_t *j, const kc_view_t *v)
{
    uint32_t count = j->i_cand / kc_view_stride(v);
    return kc_sqrt(j->change2 / (double)count);
}

static bool bounds_active(const kc_proposal_t *p)
{
    bool any = false;
    for (uint32_t c = 0u; c < p->kin.n_coef; c++) {
        any = any || p->status[c] == (uint8_t)KC_COEF_AT_LOWER || p->status[c] == (uint8_t)KC_COEF_AT_UPPER;
    }
    return any;
}

static bool acceptable(const kc_proposing_t *j, const kc_view_t *v, const kc_proposal_t *p)
{
    kc_verdict_case_t proposed = {
        .determined = p->rank == p->n_free,
        .bounds_active = bounds_active(p),
        .all_rejected = kc_verdict_all_rejected(v->est),
        .p_fit = p->p_fit,
        .sigma_pos_m = p->pred_pos_m,
        .change_pos_m = change_m(j, v),
    };
    return kc_verdict_acceptable(&v->tables->config, &proposed);
}

void kc_propose_begin(kc_proposing_t *j) { memset(j, 0, sizeof *j); }

kc_outcome_t kc_propose_run(kc_proposing_t *j, kc_review_t *r, const kc_tables_t *tables, const kc_view_t *v,
                            bool *accepted, kc_work_t *work, kc_out_t *out)
{
    kc_proposal_t *p = &out->proposal;
    if (!sum_observations(j, v, work) || !sum_changes(j, v, work) || !kc_work_take(work, PROPOSE_COST)) {
        return kc_outcome(KC_OC_STAY);
    }
    make(j, v, p);
    p->crc = kc_review_encode(r, &p->kin);
    report_held(v, &p->kin, out);
    out->has_proposal = 1u;
    *accepted = false;
    if (p->verdict == (int32_t)KC_VERDICT_NO_CHANGE) {
        kc_event(&out->events, KC_EVT_COR_NO_CHANGE, -1, p->p_no_change, 0.0);
        return kc_outcome(KC_OC_DONE);
    }
    if (p->verdict == (int32_t)KC_VERDICT_POOR) {
        kc_event(&out->events, KC_EVT_CAL_POOR, -1, p->p_fit, p->noise_scale);
    } else {
        *accepted = acceptable(j, v, p) && kc_tbl_kin_fits(tables, &p->kin, &out->events) == KC_OK;
    }
    return kc_outcome(KC_OC_STORE);
}
