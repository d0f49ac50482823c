#include "kc_propose.h"

#include <string.h>

#include "kc_chi2.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_observation.h"
#include "kc_vec.h"

#define PROPOSE_COST 2000000u /* bound of the instructions for covariance, image and putting in force */

/* ---- statistics ---- */

/* From the first pose, when the camera's drift is taken to begin, to a pose. */
static double since_s(const kc_est_t *est, uint32_t i) { return est->obs[i].ctx.t_s - est->obs[0].ctx.t_s; }

/* Residual of observation i with the estimate, and the model there. */
static void with_estimate(const kc_est_t *est, const kc_obs_t *obs, double r[6], kc_eval_t *eval)
{
    kc_loads_t loads;
    kc_model_loads(est->arm, est->terms, est->coef, &obs->ctx, &loads);
    (void)kc_model_residual(est->arm, est->terms, est->coef, obs, &loads, r, eval);
}

static void add_observation(kc_proposing_t *proposing, kc_consider_t *chain, const kc_view_t *view,
                            uint32_t i)
{
    const kc_obs_t *obs = &view->est->obs[i];
    double W[36], before[6], after[6], H[KC_CHAIN_COUNT][6];
    kc_pose_t seen;
    kc_eval_t eval;
    kc_observation_residual(view->tables, view->tables->kin.value, obs, before, NULL);
    proposing->pos2 += kc_v3_dot(before, before);
    proposing->rot2 += kc_v3_dot(&before[3], &before[3]);
    proposing->n++;
    (void)kc_la_whiten(obs->cov, 6u, W); /* kc_est_add has checked it */
    kc_la_whiten_apply(W, 6u, before, before);
    with_estimate(view->est, obs, after, &eval);
    kc_la_whiten_apply(W, 6u, after, after);
    for (uint32_t k = 0u; k < 6u; k++) {
        proposing->chi2_before += before[k] * before[k];
        proposing->chi2_after += after[k] * after[k];
    }
    kc_pose_from_quat(obs->p_m, obs->q_wxyz, &seen);
    kc_camera_chain(&view->tables->camera, obs->ctx.pan_rad, obs->ctx.tilt_rad, &seen, since_s(view->est, i),
                    H);
    const kc_consider_pose_t pose = {before, after, W, &eval, H};
    kc_consider_add(chain, view->est, &pose);
}

/* Residuals of the inliers with the table in force and with the estimate. False: goes on in the next step. */
static bool sum_observations(kc_proposing_t *proposing, kc_consider_t *chain, const kc_view_t *view,
                             kc_work_t *work)
{
    const uint64_t cost = 2u * kc_model_cost(&view->tables->arm, &view->tables->terms, true) +
                          KC_CAMERA_CHAIN_COST + kc_consider_add_cost(view->est);
    for (; proposing->i_obs < view->est->n_obs; proposing->i_obs++) {
        if (view->est->outlier[proposing->i_obs]) { continue; }
        if (!kc_work_take(work, cost)) { return false; }
        add_observation(proposing, chain, view, proposing->i_obs);
    }
    return true;
}

/* Chance of no change: of an arm that is right in the frame of CONFIG. Where the camera stands is no matter in its
 * own frame: an arm that goes where it sees needs no change, and one that does not, does. */
static double p_no_change(const kc_proposing_t *proposing, const kc_consider_t *chain, const kc_view_t *view)
{
    bool camera = view->tables->config.frame == (uint8_t)KC_RIGHT_IN_CAMERA;
    uint32_t n = camera ? KC_CHAIN_MAST : KC_CHAIN_COUNT;
    double before = proposing->chi2_before - kc_consider_explains_before(chain, n);
    double after = proposing->chi2_after - kc_consider_explains_after(chain, n);
    return kc_verdict_p_no_change(before - after, proposing->fit.noise_scale, view->est->rank);
}

/* All observations are summed: how well the estimate explains them. Without a solution the camera chain has no part
 * in it. */
static bool consider(kc_proposing_t *proposing, kc_consider_t *chain, const kc_view_t *view, kc_work_t *work)
{
    const kc_est_t *e = view->est;
    if (proposing->considered) { return true; }
    if (!kc_work_take(work, KC_CONSIDER_END_COST)) { return false; }
    proposing->considered = true;
    bool solved = kc_fit_solved(view->learned->status);
    if (solved) {
        kc_consider_end(chain, e);
    } else {
        kc_consider_begin(chain);
    }
    proposing->chi2 = e->chi2 - kc_consider_explains_after(chain, KC_CHAIN_COUNT);
    proposing->fit.noise_scale = e->dof > 0u ? kc_sqrt(proposing->chi2 / (double)e->dof) : 1.0;
    proposing->fit.p_fit = e->dof > 0u ? kc_chi2_sf(proposing->chi2, e->dof) : 1.0;
    proposing->fit.p_no_change = solved ? p_no_change(proposing, chain, view) : 1.0;
    kc_consider_scale(chain, kc_max(1.0, proposing->fit.noise_scale));
    return true;
}

static bool estimated(uint8_t status)
{
    return status != (uint8_t)KC_COEF_MASKED && status != (uint8_t)KC_COEF_HELD;
}

/* ---- proposal ---- */

/* Covariance of the estimate: of the noise, scaled up to what the residuals show, and of the camera chain. */
static double cov(const kc_proposing_t *proposing, const kc_consider_t *chain, const kc_est_t *est,
                  uint32_t i, uint32_t k)
{
    double scale = kc_max(1.0, proposing->fit.noise_scale);
    return scale * scale * est->cov[i * KC_COEF_MAX + k] + kc_consider_cov(chain, i, k);
}

static double sigma(const kc_proposing_t *proposing, const kc_consider_t *chain, const kc_est_t *est,
                    uint32_t c)
{
    double noise = kc_max(1.0, proposing->fit.noise_scale) * est->sigma[c];
    return kc_sqrt(noise * noise + kc_consider_cov(chain, c, c));
}

static void fill_kin(const kc_proposing_t *proposing, const kc_consider_t *chain, const kc_view_t *view,
                     kc_kin_t *kin)
{
    const kc_active_t *a = view->tables;
    const kc_est_t *e = view->est;
    memset(kin, 0, sizeof *kin);
    kin->n_coef = a->terms.n_coef;
    for (uint32_t c = 0u; c < kin->n_coef; c++) {
        bool est = kc_fit_solved(view->learned->status) && estimated(e->status[c]);
        kin->value[c] = est ? e->coef[c] : a->kin.value[c];
        kin->sigma[c] = est ? sigma(proposing, chain, e, c) : a->kin.sigma[c];
    }
    kin->arm_crc = a->crc[KC_TBL_ARM];
    kin->terms_crc = a->crc[KC_TBL_TERMS];
    kin->prev_crc = a->crc[KC_TBL_KIN];
    kin->session = view->cal->session;
    kin->n_poses = view->plan->n_meas;
    kin->made_us = view->clock->clock_us;
}

/* Upper triangle of the covariance, row by row, of n_coef rows. */
static void fill_cov(const kc_proposing_t *proposing, const kc_consider_t *chain, const kc_view_t *view,
                     kc_proposal_t *proposal)
{
    uint32_t at = 0u;
    if (!kc_fit_solved(view->learned->status)) { return; }
    for (uint32_t i = 0u; i < proposal->kin.n_coef; i++) {
        for (uint32_t k = i; k < proposal->kin.n_coef; k++) {
            proposal->cov[at++] = cov(proposing, chain, view->est, i, k);
        }
    }
}

/* RMS residual with the table in force, at the poses that the fit kept: those of fit_pos_m. */
static void fill_before(const kc_proposing_t *proposing, kc_proposal_t *proposal)
{
    proposal->before_pos_m = proposing->n > 0u ? kc_sqrt(proposing->pos2 / (double)proposing->n) : 0.0;
    proposal->before_rot_rad = proposing->n > 0u ? kc_sqrt(proposing->rot2 / (double)proposing->n) : 0.0;
}

static void fill_numbers(const kc_proposing_t *proposing, const kc_view_t *view, kc_proposal_t *proposal)
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
    proposal->chi2 = proposing->chi2;
    proposal->noise_scale = proposing->fit.noise_scale;
    proposal->p_fit = proposing->fit.p_fit;
    proposal->p_no_change = proposing->fit.p_no_change;
    proposal->kkt = e->kkt;
    proposal->cond = e->cond;
    proposal->fit_pos_m = e->fit_pos_m;
    proposal->fit_rot_rad = e->fit_rot_rad;
    proposal->crc_kin_before = view->tables->crc[KC_TBL_KIN];
}

/* RMS over the search space of what noise and camera chain leave unknown. */
static double rms(const kc_proposing_t *proposing, const kc_view_t *view, double noise, double sum2)
{
    uint32_t count = proposing->i_cand / kc_view_stride(view);
    return kc_sqrt(noise * noise + sum2 / (double)count);
}

static void fill_predicted(const kc_proposing_t *proposing, const kc_view_t *view, kc_proposal_t *proposal)
{
    const kc_miss_t *noise =
        &view->learned->pred; /* scaled by residuals that hold the camera chain's part too */
    double scale = kc_max(1.0, proposing->fit.noise_scale) / kc_max(1.0, view->est->noise_scale);
    bool camera = view->tables->config.frame == (uint8_t)KC_RIGHT_IN_CAMERA;
    proposal->frame = view->tables->config.frame;
    proposal->pred_noise_pos_m = scale * noise->pos_m;
    proposal->pred_noise_rot_rad = scale * noise->rot_rad;
    proposal->pred_camera_pos_m = rms(proposing, view, proposal->pred_noise_pos_m, proposing->camera_pos2);
    proposal->pred_camera_rot_rad = rms(proposing, view, proposal->pred_noise_rot_rad,
                                        proposing->camera_rot2);
    proposal->pred_lander_pos_m = rms(proposing, view, proposal->pred_noise_pos_m, proposing->lander_pos2);
    proposal->pred_lander_rot_rad = rms(proposing, view, proposal->pred_noise_rot_rad,
                                        proposing->lander_rot2);
    proposal->pred_pos_m = camera ? proposal->pred_camera_pos_m : proposal->pred_lander_pos_m;
    proposal->pred_rot_rad = camera ? proposal->pred_camera_rot_rad : proposal->pred_lander_rot_rad;
}

static void make(const kc_proposing_t *proposing, const kc_consider_t *chain, const kc_view_t *view,
                 kc_proposal_t *proposal)
{
    fill_kin(proposing, chain, view, &proposal->kin);
    fill_numbers(proposing, view, proposal);
    fill_before(proposing, proposal);
    fill_cov(proposing, chain, view, proposal);
    fill_predicted(proposing, view, proposal);
    proposal->verdict = (int32_t)kc_verdict(&view->tables->config, view->est, view->learned->status,
                                            &proposing->fit);
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

/* ---- policy ---- */

/* One candidate: how far the correction moves the tool there, and what the camera chain does to it. */
static void add_candidate(kc_proposing_t *proposing, const kc_consider_t *chain, const kc_view_t *view,
                          const double *coef)
{
    const kc_cand_t *cand = &view->tables->space.cand[proposing->i_cand];
    const kc_est_t *e = view->est;
    double d[3], pos2, rot2, H[KC_CHAIN_COUNT][6];
    kc_pose_t before;
    kc_loads_t loads;
    kc_ctx_t ctx;
    kc_eval_t eval;
    kc_view_pose(view, view->tables->kin.value, proposing->i_cand, &before);
    kc_view_ctx(view, proposing->i_cand, &ctx);
    kc_model_loads(e->arm, e->terms, coef, &ctx, &loads);
    kc_model_eval(e->arm, e->terms, coef, &ctx, &loads, true, &eval);
    kc_v3_sub(eval.T.p_m, before.p_m, d);
    proposing->change2 += kc_v3_dot(d, d);
    kc_camera_chain(&view->tables->camera, (double)cand->pan_rad, (double)cand->tilt_rad, &eval.T,
                    since_s(e, e->n_obs - 1u), H);
    kc_consider_pose(chain, e, &eval, H, &pos2, &rot2);
    proposing->camera_pos2 += pos2;
    proposing->camera_rot2 += rot2;
    kc_consider_pose(chain, e, &eval, NULL, &pos2, &rot2);
    proposing->lander_pos2 += pos2;
    proposing->lander_rot2 += rot2;
}

/* Over the search space. False: goes on in the next step. */
static bool sum_candidates(kc_proposing_t *proposing, const kc_consider_t *chain, const kc_view_t *view,
                           kc_work_t *work)
{
    const uint64_t cost = kc_model_cost(&view->tables->arm, &view->tables->terms, false) +
                          kc_model_cost(&view->tables->arm, &view->tables->terms, true) +
                          KC_CAMERA_CHAIN_COST + 2u * kc_consider_pose_cost(view->est);
    uint32_t n = view->tables->space.n_cand, stride = kc_view_stride(view);
    kc_kin_t kin;
    fill_kin(proposing, chain, view, &kin);
    for (; proposing->i_cand < n; proposing->i_cand += stride) {
        if (!kc_work_take(work, cost)) { return false; }
        add_candidate(proposing, chain, view, kin.value);
    }
    return true;
}

static double change_m(const kc_proposing_t *proposing, const kc_view_t *view)
{
    uint32_t count = proposing->i_cand / kc_view_stride(view);
    return kc_sqrt(proposing->change2 / (double)count);
}

static bool bounds_active(const kc_proposal_t *proposal)
{
    bool any = false;
    for (uint32_t c = 0u; c < proposal->kin.n_coef; c++) {
        any = any || proposal->status[c] == (uint8_t)KC_COEF_AT_LOWER ||
              proposal->status[c] == (uint8_t)KC_COEF_AT_UPPER;
    }
    return any;
}

static bool acceptable(const kc_proposing_t *proposing, const kc_view_t *view, const kc_proposal_t *proposal)
{
    kc_verdict_case_t proposed = {
        .determined = proposal->rank == proposal->n_free,
        .bounds_active = bounds_active(proposal),
        .all_rejected = kc_verdict_all_rejected(view->est),
        .p_fit = proposal->p_fit,
        .sigma_pos_m = proposal->pred_pos_m,
        .change_pos_m = change_m(proposing, view),
    };
    return kc_verdict_acceptable(&view->tables->config, &proposed);
}

void kc_propose_begin(kc_proposing_t *proposing, kc_consider_t *chain)
{
    memset(proposing, 0, sizeof *proposing);
    kc_consider_begin(chain);
}

kc_outcome_t kc_propose_run(kc_proposing_t *proposing, kc_consider_t *chain, kc_review_t *review,
                            const kc_tables_t *tables, const kc_view_t *view, bool *accepted, kc_work_t *work,
                            kc_out_t *out)
{
    kc_proposal_t *p = &out->proposal;
    if (!sum_observations(proposing, chain, view, work) || !consider(proposing, chain, view, work) ||
        !sum_candidates(proposing, chain, view, work) || !kc_work_take(work, PROPOSE_COST)) {
        return kc_outcome(KC_OC_STAY);
    }
    make(proposing, chain, view, p);
    p->crc = kc_review_encode(review, &p->kin, (kc_verdict_t)p->verdict);
    report_held(view, &p->kin, out);
    out->has_proposal = 1u;
    *accepted = false;
    if (p->verdict == (int32_t)KC_VERDICT_NO_CHANGE) {
        kc_event(&out->events, KC_EVT_COR_NO_CHANGE, -1, p->p_no_change, 0.0);
        return kc_outcome(KC_OC_DONE);
    }
    if (p->verdict == (int32_t)KC_VERDICT_POOR) {
        kc_event(&out->events, KC_EVT_CAL_POOR, -1, p->p_fit, p->noise_scale);
    } else {
        *accepted = acceptable(proposing, view, p) && kc_tbl_kin_fits(tables, &p->kin, &out->events) == KC_OK;
    }
    return kc_outcome(KC_OC_STORE);
}
