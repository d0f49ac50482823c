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
static double since_s(const kc_est_t *e, uint32_t i) { return e->obs[i].ctx.t_s - e->obs[0].ctx.t_s; }

/* Residual of observation i with the estimate, and the model there. */
static void with_estimate(const kc_est_t *e, const kc_obs_t *obs, double r[6], kc_eval_t *eval)
{
    kc_loads_t loads;
    kc_model_loads(e->arm, e->terms, e->coef, &obs->ctx, &loads);
    (void)kc_model_residual(e->arm, e->terms, e->coef, obs, &loads, r, eval);
}

static void add_observation(kc_proposing_t *j, kc_consider_t *chain, const kc_view_t *v, uint32_t i)
{
    const kc_obs_t *obs = &v->est->obs[i];
    double W[36], before[6], after[6], H[KC_CHAIN_COUNT][6];
    kc_pose_t seen;
    kc_eval_t eval;
    kc_observation_residual(v->tables, v->tables->kin.value, obs, before, NULL);
    j->pos2 += kc_v3_dot(before, before);
    j->rot2 += kc_v3_dot(&before[3], &before[3]);
    j->n++;
    (void)kc_la_whiten(obs->cov, 6u, W); /* kc_est_add has checked it */
    kc_la_whiten_apply(W, 6u, before, before);
    with_estimate(v->est, obs, after, &eval);
    kc_la_whiten_apply(W, 6u, after, after);
    for (uint32_t k = 0u; k < 6u; k++) {
        j->chi2_before += before[k] * before[k];
        j->chi2_after += after[k] * after[k];
    }
    kc_pose_from_quat(obs->p_m, obs->q_wxyz, &seen);
    kc_camera_chain(&v->tables->camera, obs->ctx.pan_rad, obs->ctx.tilt_rad, &seen, since_s(v->est, i), H);
    const kc_consider_pose_t pose = {before, after, W, &eval, H};
    kc_consider_add(chain, v->est, &pose);
}

/* Residuals of the inliers with the table in force and with the estimate. False: goes on in the next step. */
static bool sum_observations(kc_proposing_t *j, kc_consider_t *chain, const kc_view_t *v, kc_work_t *work)
{
    const uint64_t cost = 2u * kc_model_cost(&v->tables->arm, &v->tables->terms, true) +
                          KC_CAMERA_CHAIN_COST + kc_consider_add_cost(v->est);
    for (; j->i_obs < v->est->n_obs; j->i_obs++) {
        if (v->est->outlier[j->i_obs]) { continue; }
        if (!kc_work_take(work, cost)) { return false; }
        add_observation(j, chain, v, j->i_obs);
    }
    return true;
}

/* Chance of no change: of an arm that is right in the frame of CONFIG. Where the camera stands is no matter in its
 * own frame: an arm that goes where it sees needs no change, and one that does not, does. */
static double p_no_change(const kc_proposing_t *j, const kc_consider_t *chain, const kc_view_t *v)
{
    bool camera = v->tables->config.frame == (uint8_t)KC_RIGHT_IN_CAMERA;
    uint32_t n = camera ? KC_CHAIN_MAST : KC_CHAIN_COUNT;
    double before = j->chi2_before - kc_consider_explains_before(chain, n);
    double after = j->chi2_after - kc_consider_explains_after(chain, n);
    return kc_verdict_p_no_change(before - after, j->fit.noise_scale, v->est->rank);
}

/* All observations are summed: how well the estimate explains them. Without a solution the camera chain has no part
 * in it. */
static bool consider(kc_proposing_t *j, kc_consider_t *chain, const kc_view_t *v, kc_work_t *work)
{
    const kc_est_t *e = v->est;
    if (j->considered) { return true; }
    if (!kc_work_take(work, KC_CONSIDER_END_COST)) { return false; }
    j->considered = true;
    bool solved = kc_fit_solved(v->learned->status);
    if (solved) {
        kc_consider_end(chain, e);
    } else {
        kc_consider_begin(chain);
    }
    j->chi2 = e->chi2 - kc_consider_explains_after(chain, KC_CHAIN_COUNT);
    j->fit.noise_scale = e->dof > 0u ? kc_sqrt(j->chi2 / (double)e->dof) : 1.0;
    j->fit.p_fit = e->dof > 0u ? kc_chi2_sf(j->chi2, e->dof) : 1.0;
    j->fit.p_no_change = solved ? p_no_change(j, chain, v) : 1.0;
    kc_consider_scale(chain, kc_max(1.0, j->fit.noise_scale));
    return true;
}

static bool estimated(uint8_t status)
{
    return status != (uint8_t)KC_COEF_MASKED && status != (uint8_t)KC_COEF_HELD;
}

/* ---- proposal ---- */

/* Covariance of the estimate: of the noise, scaled up to what the residuals show, and of the camera chain. */
static double cov(const kc_proposing_t *j, const kc_consider_t *chain, const kc_est_t *e, uint32_t i,
                  uint32_t k)
{
    double scale = kc_max(1.0, j->fit.noise_scale);
    return scale * scale * e->cov[i * KC_COEF_MAX + k] + kc_consider_cov(chain, i, k);
}

static double sigma(const kc_proposing_t *j, const kc_consider_t *chain, const kc_est_t *e, uint32_t c)
{
    double noise = kc_max(1.0, j->fit.noise_scale) * e->sigma[c];
    return kc_sqrt(noise * noise + kc_consider_cov(chain, c, c));
}

static void fill_kin(const kc_proposing_t *j, const kc_consider_t *chain, const kc_view_t *v, kc_kin_t *k)
{
    const kc_active_t *a = v->tables;
    const kc_est_t *e = v->est;
    memset(k, 0, sizeof *k);
    k->n_coef = a->terms.n_coef;
    for (uint32_t c = 0u; c < k->n_coef; c++) {
        bool est = kc_fit_solved(v->learned->status) && estimated(e->status[c]);
        k->value[c] = est ? e->coef[c] : a->kin.value[c];
        k->sigma[c] = est ? sigma(j, chain, e, c) : a->kin.sigma[c];
    }
    k->arm_crc = a->crc[KC_TBL_ARM];
    k->terms_crc = a->crc[KC_TBL_TERMS];
    k->prev_crc = a->crc[KC_TBL_KIN];
    k->session = v->cal->session;
    k->n_poses = v->plan->n_meas;
    k->made_us = v->clock->clock_us;
}

/* Upper triangle of the covariance, row by row, of n_coef rows. */
static void fill_cov(const kc_proposing_t *j, const kc_consider_t *chain, const kc_view_t *v,
                     kc_proposal_t *p)
{
    uint32_t at = 0u;
    if (!kc_fit_solved(v->learned->status)) { return; }
    for (uint32_t i = 0u; i < p->kin.n_coef; i++) {
        for (uint32_t k = i; k < p->kin.n_coef; k++) { p->cov[at++] = cov(j, chain, v->est, i, k); }
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
    p->chi2 = j->chi2;
    p->noise_scale = j->fit.noise_scale;
    p->p_fit = j->fit.p_fit;
    p->p_no_change = j->fit.p_no_change;
    p->kkt = e->kkt;
    p->cond = e->cond;
    p->fit_pos_m = e->fit_pos_m;
    p->fit_rot_rad = e->fit_rot_rad;
    p->crc_kin_before = v->tables->crc[KC_TBL_KIN];
}

/* RMS over the search space of what noise and camera chain leave unknown. */
static double rms(const kc_proposing_t *j, const kc_view_t *v, double noise, double sum2)
{
    uint32_t count = j->i_cand / kc_view_stride(v);
    return kc_sqrt(noise * noise + sum2 / (double)count);
}

static void fill_predicted(const kc_proposing_t *j, const kc_view_t *v, kc_proposal_t *p)
{
    const kc_miss_t *noise =
        &v->learned->pred; /* scaled by residuals that hold the camera chain's part too */
    double scale = kc_max(1.0, j->fit.noise_scale) / kc_max(1.0, v->est->noise_scale);
    bool camera = v->tables->config.frame == (uint8_t)KC_RIGHT_IN_CAMERA;
    p->frame = v->tables->config.frame;
    p->pred_noise_pos_m = scale * noise->pos_m;
    p->pred_noise_rot_rad = scale * noise->rot_rad;
    p->pred_camera_pos_m = rms(j, v, p->pred_noise_pos_m, j->camera_pos2);
    p->pred_camera_rot_rad = rms(j, v, p->pred_noise_rot_rad, j->camera_rot2);
    p->pred_lander_pos_m = rms(j, v, p->pred_noise_pos_m, j->lander_pos2);
    p->pred_lander_rot_rad = rms(j, v, p->pred_noise_rot_rad, j->lander_rot2);
    p->pred_pos_m = camera ? p->pred_camera_pos_m : p->pred_lander_pos_m;
    p->pred_rot_rad = camera ? p->pred_camera_rot_rad : p->pred_lander_rot_rad;
}

static void make(const kc_proposing_t *j, const kc_consider_t *chain, const kc_view_t *v, kc_proposal_t *p)
{
    fill_kin(j, chain, v, &p->kin);
    fill_numbers(j, v, p);
    fill_before(j, p);
    fill_cov(j, chain, v, p);
    fill_predicted(j, v, p);
    p->verdict = (int32_t)kc_verdict(&v->tables->config, v->est, v->learned->status, &j->fit);
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

/* One candidate: how far the correction moves the tool there, and what the camera chain does to it. */
static void add_candidate(kc_proposing_t *j, const kc_consider_t *chain, const kc_view_t *v,
                          const double *coef)
{
    const kc_cand_t *cand = &v->tables->space.cand[j->i_cand];
    const kc_est_t *e = v->est;
    double d[3], pos2, rot2, H[KC_CHAIN_COUNT][6];
    kc_pose_t before;
    kc_loads_t loads;
    kc_ctx_t ctx;
    kc_eval_t eval;
    kc_view_pose(v, v->tables->kin.value, j->i_cand, &before);
    kc_view_ctx(v, j->i_cand, &ctx);
    kc_model_loads(e->arm, e->terms, coef, &ctx, &loads);
    kc_model_eval(e->arm, e->terms, coef, &ctx, &loads, true, &eval);
    kc_v3_sub(eval.T.p_m, before.p_m, d);
    j->change2 += kc_v3_dot(d, d);
    kc_camera_chain(&v->tables->camera, (double)cand->pan_rad, (double)cand->tilt_rad, &eval.T,
                    since_s(e, e->n_obs - 1u), H);
    kc_consider_pose(chain, e, &eval, H, &pos2, &rot2);
    j->camera_pos2 += pos2;
    j->camera_rot2 += rot2;
    kc_consider_pose(chain, e, &eval, NULL, &pos2, &rot2);
    j->lander_pos2 += pos2;
    j->lander_rot2 += rot2;
}

/* Over the search space. False: goes on in the next step. */
static bool sum_candidates(kc_proposing_t *j, const kc_consider_t *chain, const kc_view_t *v, kc_work_t *work)
{
    const uint64_t cost = kc_model_cost(&v->tables->arm, &v->tables->terms, false) +
                          kc_model_cost(&v->tables->arm, &v->tables->terms, true) + KC_CAMERA_CHAIN_COST +
                          2u * kc_consider_pose_cost(v->est);
    uint32_t n = v->tables->space.n_cand, stride = kc_view_stride(v);
    kc_kin_t kin;
    fill_kin(j, chain, v, &kin);
    for (; j->i_cand < n; j->i_cand += stride) {
        if (!kc_work_take(work, cost)) { return false; }
        add_candidate(j, chain, v, kin.value);
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

void kc_propose_begin(kc_proposing_t *j, kc_consider_t *chain)
{
    memset(j, 0, sizeof *j);
    kc_consider_begin(chain);
}

kc_outcome_t kc_propose_run(kc_proposing_t *j, kc_consider_t *chain, kc_review_t *r,
                            const kc_tables_t *tables, const kc_view_t *v, bool *accepted, kc_work_t *work,
                            kc_out_t *out)
{
    kc_proposal_t *p = &out->proposal;
    if (!sum_observations(j, chain, v, work) || !consider(j, chain, v, work) ||
        !sum_candidates(j, chain, v, work) || !kc_work_take(work, PROPOSE_COST)) {
        return kc_outcome(KC_OC_STAY);
    }
    make(j, chain, v, p);
    p->crc = kc_review_encode(r, &p->kin, (kc_verdict_t)p->verdict);
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
