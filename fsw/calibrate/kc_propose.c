#include "kc_propose.h"

#include <string.h>

#include "kc_libm.h"

#define PROPOSE_COST 2000000u /* bound of the instructions for covariance, image and putting in force */

/* ---- proposal ---- */

/* Covariance of the estimate: of the noise, scaled up to what the residuals show, and of the camera chain. */
static double cov(const kc_evaluated_t *evaluated, const kc_consider_t *chain, const kc_est_t *est,
                  uint32_t i, uint32_t k)
{
    double scale = kc_max(1.0, evaluated->fit.noise_scale);
    return scale * scale * est->cov[i * KC_COEF_MAX + k] + kc_consider_cov(chain, i, k);
}

static double sigma(const kc_evaluated_t *evaluated, const kc_consider_t *chain, const kc_est_t *est,
                    uint32_t c)
{
    double noise = kc_max(1.0, evaluated->fit.noise_scale) * est->sigma[c];
    return kc_sqrt(noise * noise + kc_consider_cov(chain, c, c));
}

static void fill_kin(const kc_evaluated_t *evaluated, const kc_consider_t *chain, const kc_view_t *view,
                     kc_kin_t *kin)
{
    const kc_active_t *a = view->tables;
    const kc_est_t *e = view->est;
    kin->n_coef = a->terms.n_coef;
    kc_evaluation_values(view, kin->value);
    for (uint32_t c = 0u; c < kin->n_coef; c++) {
        bool est = kc_fit_solved(view->latest->status) && kc_evaluation_estimated(e->status[c]);
        kin->sigma[c] = est ? sigma(evaluated, chain, e, c) : a->kin.sigma[c];
    }
    kin->arm_crc = a->crc[KC_TBL_ARM];
    kin->terms_crc = a->crc[KC_TBL_TERMS];
    kin->prev_crc = a->crc[KC_TBL_KIN];
    kin->session = view->cal->session;
    kin->n_poses = view->plan->n_meas;
    kin->made_us = view->clock->clock_us;
}

/* Upper triangle of the covariance, row by row, of n_coef rows. */
static void fill_cov(const kc_evaluated_t *evaluated, const kc_consider_t *chain, const kc_view_t *view,
                     kc_proposal_t *proposal)
{
    uint32_t at = 0u;
    if (!kc_fit_solved(view->latest->status)) { return; }
    for (uint32_t i = 0u; i < proposal->kin.n_coef; i++) {
        for (uint32_t k = i; k < proposal->kin.n_coef; k++) {
            proposal->cov[at++] = cov(evaluated, chain, view->est, i, k);
        }
    }
}

/* RMS residual with the table in force, at the poses that the fit kept: those of fit_pos_m. */
static void fill_before(const kc_evaluated_t *evaluated, kc_proposal_t *proposal)
{
    proposal->before_pos_m = evaluated->n > 0u ? kc_sqrt(evaluated->pos2 / (double)evaluated->n) : 0.0;
    proposal->before_rot_rad = evaluated->n > 0u ? kc_sqrt(evaluated->rot2 / (double)evaluated->n) : 0.0;
}

static void fill_numbers(const kc_evaluated_t *evaluated, const kc_view_t *view, kc_proposal_t *proposal)
{
    const kc_est_t *e = view->est;
    memcpy(proposal->status, e->status, sizeof proposal->status);
    memcpy(proposal->confounded, e->confounded, sizeof proposal->confounded);
    proposal->session = view->cal->session;
    proposal->n_poses = view->plan->n_meas;
    proposal->n_outliers = e->n_outliers;
    proposal->rank = e->rank;
    proposal->n_free = e->n_free;
    proposal->dof = e->dof;
    proposal->chi2 = evaluated->chi2;
    proposal->noise_scale = evaluated->fit.noise_scale;
    proposal->p_fit = evaluated->fit.p_fit;
    proposal->p_no_change = evaluated->fit.p_no_change;
    proposal->kkt = e->kkt;
    proposal->cond = e->cond;
    proposal->fit_pos_m = e->fit_pos_m;
    proposal->fit_rot_rad = e->fit_rot_rad;
    proposal->crc_kin_before = view->tables->crc[KC_TBL_KIN];
}

static void fill_predicted(const kc_evaluated_t *evaluated, const kc_view_t *view, kc_proposal_t *proposal)
{
    const kc_residual_t *noise = &evaluated->noise;
    proposal->frame = view->tables->config.frame;
    proposal->pred_noise_pos_m = noise->pos_m;
    proposal->pred_noise_rot_rad = noise->rot_rad;
    proposal->pred_camera_pos_m = kc_evaluation_rms(evaluated, view, noise->pos_m, evaluated->camera_pos2);
    proposal->pred_camera_rot_rad = kc_evaluation_rms(evaluated, view, noise->rot_rad,
                                                      evaluated->camera_rot2);
    proposal->pred_lander_pos_m = kc_evaluation_rms(evaluated, view, noise->pos_m, evaluated->lander_pos2);
    proposal->pred_lander_rot_rad = kc_evaluation_rms(evaluated, view, noise->rot_rad,
                                                      evaluated->lander_rot2);
    proposal->pred_pos_m = evaluated->predicted.pos_m;
    proposal->pred_rot_rad = evaluated->predicted.rot_rad;
    proposal->confidence = view->tables->config.stop_confidence;
    proposal->bound_pos_m = evaluated->bound.pos_m;
    proposal->bound_rot_rad = evaluated->bound.rot_rad;
    proposal->ended = (uint8_t)view->cal->ended;
    proposal->n_checked = view->latest->n_checked;
}

static void make(const kc_evaluated_t *evaluated, const kc_consider_t *chain, const kc_view_t *view,
                 kc_proposal_t *proposal)
{
    fill_kin(evaluated, chain, view, &proposal->kin);
    fill_numbers(evaluated, view, proposal);
    fill_before(evaluated, proposal);
    fill_cov(evaluated, chain, view, proposal);
    fill_predicted(evaluated, view, proposal);
    proposal->verdict = (int32_t)kc_verdict(&view->tables->config, view->est, view->latest->status,
                                            &evaluated->fit, view->latest->tested_early);
}

/* Coefficients that the data could not determine. */
static void report_held(const kc_view_t *view, const kc_kin_t *kin, kc_out_t *out)
{
    const kc_est_t *e = view->est;
    if (e->rank == e->n_free) { return; }
    kc_event(&out->events, KC_EVT_CAL_RANK, -1, (double)e->rank, (double)e->n_free);
    for (uint32_t c = 0u; c < kin->n_coef; c++) {
        if (e->status[c] != (uint8_t)KC_COEF_HELD) { continue; }
        kc_event(&out->events, KC_EVT_CAL_HELD, (int32_t)c, kin->value[c], 0.0);
    }
}

/* Why the required accuracy was not reached, if the camera chain alone keeps it away at the poses that were measured. */
static void report_chain(const kc_evaluated_t *evaluated, const kc_view_t *view, kc_out_t *out)
{
    const kc_config_t *c = &view->tables->config;
    const kc_ended_t ended = view->cal->ended;
    const kc_residual_t *left = &evaluated->chain;
    if (ended == KC_ENDED_REQUIREMENT || ended == KC_ENDED_NO_CHANGE) { return; }
    if (c->stop_pos_m > 0.0 && left->pos_m > c->stop_pos_m) {
        kc_event(&out->events, KC_EVT_CAL_CHAIN_LIMIT, 0, left->pos_m, c->stop_pos_m);
    }
    if (c->stop_rot_rad > 0.0 && left->rot_rad > c->stop_rot_rad) {
        kc_event(&out->events, KC_EVT_CAL_CHAIN_LIMIT, 1, left->rot_rad, c->stop_rot_rad);
    }
}

/* ---- policy ---- */

static bool bounds_active(const kc_proposal_t *proposal)
{
    bool any = false;
    for (uint32_t c = 0u; c < proposal->kin.n_coef; c++) {
        any = any || proposal->status[c] == (uint8_t)KC_COEF_AT_LOWER ||
              proposal->status[c] == (uint8_t)KC_COEF_AT_UPPER;
    }
    return any;
}

static bool acceptable(const kc_evaluated_t *evaluated, const kc_view_t *view, const kc_proposal_t *proposal)
{
    kc_verdict_case_t proposed = {
        .determined = proposal->rank == proposal->n_free,
        .bounds_active = bounds_active(proposal),
        .all_rejected = kc_verdict_all_rejected(view->est),
        .p_fit = proposal->p_fit,
        .sigma_pos_m = proposal->pred_pos_m,
        .change_pos_m = kc_evaluation_change_m(evaluated, view),
    };
    return kc_verdict_acceptable(&view->tables->config, &proposed);
}

kc_outcome_t kc_propose_run(kc_evaluated_t *evaluated, kc_evaluation_t *evaluation, kc_review_t *review,
                            const kc_tables_t *tables, const kc_view_t *view, bool *accepted, kc_work_t *work,
                            kc_out_t *out)
{
    kc_proposal_t *p = &out->proposal;
    if (!kc_evaluation_run(evaluated, evaluation, view, work) || !kc_work_take(work, PROPOSE_COST)) {
        return kc_outcome(KC_OC_STAY);
    }
    make(evaluated, &evaluation->chain, view, p);
    p->crc = kc_review_encode(review, &p->kin, (kc_verdict_t)p->verdict);
    report_held(view, &p->kin, out);
    report_chain(evaluated, view, out);
    out->has_proposal = 1u;
    *accepted = false;
    if (p->verdict == (int32_t)KC_VERDICT_NO_CHANGE) {
        kc_event(&out->events, KC_EVT_COR_NO_CHANGE, -1, p->p_no_change, 0.0);
        return kc_outcome(KC_OC_DONE);
    }
    if (p->verdict == (int32_t)KC_VERDICT_POOR) {
        if (kc_verdict_newest_rejected(view->est)) {
            kc_event(&out->events, KC_EVT_CAL_CHANGED, (int32_t)p->n_poses, 0.0, 0.0);
        }
        kc_event(&out->events, KC_EVT_CAL_POOR, -1, p->p_fit, p->noise_scale);
    } else {
        *accepted = acceptable(evaluated, view, p) && kc_tbl_kin_fits(tables, &p->kin, &out->events) == KC_OK;
    }
    return kc_outcome(KC_OC_STORE);
}
