#include "kc_evaluation.h"

#include <string.h>

#include "kc_chi2.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_observation.h"
#include "kc_vec.h"

static bool in_camera(const kc_view_t *view)
{
    return view->tables->config.frame == (uint8_t)KC_RIGHT_IN_CAMERA;
}

/* ---- observations ---- */

/* The model with the table in force, and with what was estimated. */
typedef struct {
    kc_fixed_t before, after;
} models_t;

/* The first time, once there is work for them. */
static void fix_models(const kc_view_t *view, const double *after, models_t *models)
{
    const kc_active_t *a = view->tables;
    if (models->after.arm != NULL) { return; }
    kc_model_fix(&a->arm, &a->terms, a->kin.value, &models->before);
    kc_model_fix(view->est->arm, view->est->terms, after, &models->after);
}

/* Residual of an observation with the estimate, and the model there. */
static void with_estimate(const kc_fixed_t *fixed, const kc_obs_t *obs, double r[6], kc_eval_t *eval)
{
    kc_loads_t work;
    (void)kc_fixed_residual(fixed, obs, kc_fixed_needed_loads(fixed, &obs->ctx, &work), r, eval);
}

static void add_observation(kc_evaluated_t *evaluated, kc_consider_t *chain, const kc_view_t *view,
                            const models_t *models, uint32_t i)
{
    const kc_obs_t *obs = &view->est->obs[i];
    double W[36], before[6], after[6], H[KC_CHAIN_COUNT][6];
    kc_eval_t eval;
    kc_observation_residual(&models->before, obs, before, NULL);
    evaluated->pos2 += kc_v3_dot(before, before);
    evaluated->rot2 += kc_v3_dot(&before[3], &before[3]);
    evaluated->n++;
    (void)kc_la_whiten(obs->cov, 6u, W); /* kc_est_add has checked it */
    kc_la_whiten_apply(W, before, before);
    with_estimate(&models->after, obs, after, &eval);
    kc_la_whiten_apply(W, after, after);
    for (uint32_t k = 0u; k < 6u; k++) {
        evaluated->chi2_before += before[k] * before[k];
        evaluated->chi2_after += after[k] * after[k];
    }
    kc_est_chain_motion(view->est, &view->tables->camera, i, H);
    const kc_consider_pose_t pose = {before, after, W, &eval, H};
    kc_consider_add(chain, view->est, &pose);
}

/* Residuals of the inliers with the table in force and with the estimate. False: goes on in the next step. */
static bool sum_observations(kc_evaluated_t *evaluated, kc_consider_t *chain, const kc_view_t *view,
                             kc_work_t *work)
{
    const uint64_t cost = kc_model_cost(&view->tables->arm, &view->tables->terms, view->tables->kin.value,
                                        false) +
                          kc_model_cost(&view->tables->arm, &view->tables->terms, view->est->coef, true) +
                          KC_CAMERA_CHAIN_COST + kc_consider_add_cost(view->est);
    models_t models;
    models.after.arm = NULL;
    for (; evaluated->i_obs < view->est->n_obs; evaluated->i_obs++) {
        if (view->est->outlier[evaluated->i_obs]) { continue; }
        if (!kc_work_take(work, cost)) { return false; }
        fix_models(view, view->est->coef, &models);
        add_observation(evaluated, chain, view, &models, evaluated->i_obs);
    }
    return true;
}

/* Parameters of the chain that an arm which is right in the frame of CONFIG may be off by. */
static uint32_t counted(const kc_view_t *view) { return in_camera(view) ? KC_CHAIN_MAST : KC_CHAIN_COUNT; }

/* Chance of no change: of an arm that is right in the frame of CONFIG. Where the camera stands is no matter in its
 * own frame: an arm that goes where it sees needs no change, and one that does not, does. */
static double p_no_change(const kc_evaluated_t *evaluated, const kc_consider_t *chain, const kc_view_t *view)
{
    const uint32_t n = counted(view);
    double before = evaluated->chi2_before - kc_consider_explains_before(chain, n);
    double after = evaluated->chi2_after - kc_consider_explains_after(chain, n);
    return kc_verdict_p_no_change(before - after, evaluated->fit.noise_scale, view->est->rank);
}

/* All observations are summed: how well the estimate explains them. Without a solution the camera chain has no part
 * in it. */
static bool consider(kc_evaluated_t *evaluated, kc_consider_t *chain, const kc_view_t *view, kc_work_t *work)
{
    const kc_est_t *e = view->est;
    if (evaluated->considered) { return true; }
    if (!kc_work_take(work, KC_CONSIDER_END_COST)) { return false; }
    evaluated->considered = true;
    bool solved = kc_fit_solved(view->latest->status);
    if (solved) {
        kc_consider_visible(chain, e, counted(view));
        kc_consider_end(chain, e);
    } else {
        kc_consider_begin(chain);
    }
    evaluated->chi2 = e->chi2 - kc_consider_explains_after(chain, KC_CHAIN_COUNT);
    evaluated->fit.noise_scale = e->dof > 0u ? kc_sqrt(evaluated->chi2 / (double)e->dof) : 1.0;
    evaluated->fit.p_fit = e->dof > 0u ? kc_chi2_sf(evaluated->chi2, e->dof) : 1.0;
    evaluated->fit.p_no_change = solved ? p_no_change(evaluated, chain, view) : 1.0;
    kc_consider_scale(chain, kc_max(1.0, evaluated->fit.noise_scale));
    return true;
}

/* ---- the search space ---- */

bool kc_evaluation_estimated(uint8_t status)
{
    return status != (uint8_t)KC_COEF_MASKED && status != (uint8_t)KC_COEF_HELD;
}

void kc_evaluation_values(const kc_view_t *view, double *value)
{
    const bool solved = kc_fit_solved(view->latest->status);
    for (uint32_t c = 0u; c < view->tables->terms.n_coef; c++) {
        value[c] = solved && kc_evaluation_estimated(view->est->status[c]) ? view->est->coef[c]
                                                                           : view->tables->kin.value[c];
    }
}

/* One candidate: how far the correction moves the tool there, and what the camera chain does to it. */
static void add_candidate(kc_evaluated_t *evaluated, kc_evaluation_t *evaluation, const kc_view_t *view,
                          const models_t *models)
{
    const kc_cand_t *cand = &view->tables->space.cand[evaluated->i_cand];
    const kc_consider_t *chain = &evaluation->chain;
    const kc_est_t *e = view->est;
    double d[3], pos2, rot2, H[KC_CHAIN_COUNT][6], move[6][KC_CHAIN_COUNT];
    kc_pose_t before;
    kc_loads_t work;
    kc_ctx_t ctx;
    kc_eval_t eval;
    kc_view_pose(view, &models->before, evaluated->i_cand, &before);
    kc_view_ctx(view, evaluated->i_cand, &ctx);
    kc_fixed_eval(&models->after, &ctx, kc_fixed_needed_loads(&models->after, &ctx, &work), true, &eval);
    kc_v3_sub(eval.T.p_m, before.p_m, d);
    evaluated->change2 += kc_v3_dot(d, d);
    kc_camera_chain(&view->tables->camera, (double)cand->pan_rad, (double)cand->tilt_rad, &eval.T,
                    kc_est_since_s(e, e->n_obs - 1u), H);
    kc_consider_pose(chain, e, &eval, H, &pos2, &rot2);
    evaluated->camera_pos2 += pos2;
    evaluated->camera_rot2 += rot2;
    kc_consider_pose(chain, e, &eval, NULL, &pos2, &rot2);
    evaluated->lander_pos2 += pos2;
    evaluated->lander_rot2 += rot2;
    kc_consider_motion(chain, e, &eval, in_camera(view) ? H : NULL, move);
    kc_accuracy_add(&evaluation->error, &eval, move);
}

/* Over the search space. False: goes on in the next step. */
static bool sum_candidates(kc_evaluated_t *evaluated, kc_evaluation_t *evaluation, const kc_view_t *view,
                           kc_work_t *work)
{
    const kc_active_t *a = view->tables;
    const uint64_t cost = kc_model_cost(&a->arm, &a->terms, a->kin.value, false) +
                          kc_model_cost(&a->arm, &a->terms, view->est->coef, true) + KC_CAMERA_CHAIN_COST +
                          3u * kc_consider_pose_cost(view->est) + kc_accuracy_add_cost(view->est);
    uint32_t n = view->tables->space.n_cand, stride = kc_view_stride(view);
    double value[KC_COEF_MAX];
    models_t models;
    models.after.arm = NULL;
    kc_evaluation_values(view, value);
    for (; evaluated->i_cand < n; evaluated->i_cand += stride) {
        if (!kc_work_take(work, cost)) { return false; }
        fix_models(view, value, &models);
        add_candidate(evaluated, evaluation, view, &models);
    }
    return true;
}

double kc_evaluation_rms(const kc_evaluated_t *evaluated, const kc_view_t *view, double noise, double sum2)
{
    uint32_t count = evaluated->i_cand / kc_view_stride(view);
    return kc_sqrt(noise * noise + sum2 / (double)count);
}

double kc_evaluation_change_m(const kc_evaluated_t *evaluated, const kc_view_t *view)
{
    return kc_evaluation_rms(evaluated, view, 0.0, evaluated->change2);
}

/* ---- the answer ---- */

#define N_BOUNDS 4u

/* Error that is exceeded with probability 1 - stop_confidence: of position or rotation, of noise of this scale and the
 * chain. */
static double bound(const kc_evaluation_t *evaluation, const kc_view_t *view, const float *sums, double scale,
                    double rms)
{
    if (!kc_fit_solved(view->latest->status)) { return rms; } /* there is no covariance */
    double dof = kc_accuracy_dof(&evaluation->error, sums, view->est, scale, evaluation->chain.b_after);
    return kc_accuracy_bound(rms, dof, view->tables->config.stop_confidence);
}

static void predict(kc_evaluated_t *evaluated, const kc_view_t *view)
{
    const kc_residual_t *noise = &view->latest->pred; /* scaled by residuals that hold the chain's part too */
    const double scale = kc_max(1.0, evaluated->fit.noise_scale) / kc_max(1.0, view->est->noise_scale);
    const double pos2 = in_camera(view) ? evaluated->camera_pos2 : evaluated->lander_pos2;
    const double rot2 = in_camera(view) ? evaluated->camera_rot2 : evaluated->lander_rot2;
    evaluated->noise = (kc_residual_t){scale * noise->pos_m, scale * noise->rot_rad};
    evaluated->predicted.pos_m = kc_evaluation_rms(evaluated, view, evaluated->noise.pos_m, pos2);
    evaluated->predicted.rot_rad = kc_evaluation_rms(evaluated, view, evaluated->noise.rot_rad, rot2);
    evaluated->chain.pos_m = kc_evaluation_rms(evaluated, view, 0.0, pos2);
    evaluated->chain.rot_rad = kc_evaluation_rms(evaluated, view, 0.0, rot2);
}

/* Bounds of the predicted errors, one after another. False: goes on in the next step. */
static bool bounds(kc_evaluated_t *evaluated, const kc_evaluation_t *evaluation, const kc_view_t *view,
                   kc_work_t *work)
{
    const double scale = kc_max(1.0, evaluated->fit.noise_scale);
    const float *pos = evaluation->error.pos, *rot = evaluation->error.rot;
    for (; evaluated->i_bound < N_BOUNDS; evaluated->i_bound++) {
        if (!kc_work_take(work, kc_accuracy_dof_cost(view->est))) { return false; }
        switch (evaluated->i_bound) {
        case 0u:
            predict(evaluated, view);
            evaluated->bound.pos_m = bound(evaluation, view, pos, scale, evaluated->predicted.pos_m);
            break;
        case 1u:
            evaluated->bound.rot_rad = bound(evaluation, view, rot, scale, evaluated->predicted.rot_rad);
            break;
        case 2u: evaluated->chain.pos_m = bound(evaluation, view, pos, 0.0, evaluated->chain.pos_m); break;
        default:
            evaluated->chain.rot_rad = bound(evaluation, view, rot, 0.0, evaluated->chain.rot_rad);
            break;
        }
    }
    return true;
}

void kc_evaluation_begin(kc_evaluated_t *evaluated, kc_evaluation_t *evaluation, const kc_view_t *view)
{
    memset(evaluated, 0, sizeof *evaluated);
    kc_consider_begin(&evaluation->chain);
    kc_accuracy_begin(&evaluation->error, view->est);
}

bool kc_evaluation_run(kc_evaluated_t *evaluated, kc_evaluation_t *evaluation, const kc_view_t *view,
                       kc_work_t *work)
{
    return sum_observations(evaluated, &evaluation->chain, view, work) &&
           consider(evaluated, &evaluation->chain, view, work) &&
           sum_candidates(evaluated, evaluation, view, work) && bounds(evaluated, evaluation, view, work);
}

/* ---- power of the test of the active table ---- */

/* Squared size of an error of coefficient c that puts the tool off by what is required: the smaller of the two. */
static double size2(const kc_evaluation_t *evaluation, const kc_config_t *c, uint32_t coef)
{
    const double pos2 = kc_accuracy_square(&evaluation->error, evaluation->error.pos, coef);
    const double rot2 = kc_accuracy_square(&evaluation->error, evaluation->error.rot, coef);
    double least = KC_INF;
    if (c->stop_pos_m > 0.0 && pos2 > 0.0) { least = c->stop_pos_m * c->stop_pos_m / pos2; }
    if (c->stop_rot_rad > 0.0 && rot2 > 0.0) {
        least = kc_min(least, c->stop_rot_rad * c->stop_rot_rad / rot2);
    }
    return least;
}

double kc_evaluation_power(const kc_evaluated_t *evaluated, const kc_evaluation_t *evaluation,
                           const kc_view_t *view, double level, bool with_chain)
{
    const double *information = with_chain ? evaluation->chain.visible : evaluation->chain.JJ;
    const kc_est_t *e = view->est;
    const double scale = kc_max(1.0, evaluated->fit.noise_scale);
    double least = KC_INF;
    for (uint32_t c = 0u; c < e->terms->n_coef; c++) {
        if (e->status[c] == (uint8_t)KC_COEF_MASKED) { continue; }
        least = kc_min(least, size2(evaluation, &view->tables->config, c) * information[c]);
    }
    return kc_chi2_noncentral_sf(kc_chi2_quantile(level, e->rank), e->rank, least / (scale * scale));
}
