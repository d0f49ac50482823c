/* The proposed correction: verdict, review in two steps, acceptance on board, rollback. */
#include <string.h>

#include "kc_chi2.h"
#include "kc_app_priv.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_vec.h"

/* ---- statistics ---- */

static int solved(const kc_app_t *app)
{
    return app->cal.est_status == KC_OK || app->cal.est_status == KC_ERR_ITER;
}

/* Residual of one observation at any coefficients. */
static void residual_at(kc_app_t *app, const double *coef, const kc_obs_t *obs, double r[6])
{
    const kc_active_t *a = &app->tables.active;
    kc_loads_t loads;
    kc_model_loads(&a->arm, &a->terms, coef, &obs->ctx, &loads);
    (void)kc_model_residual(&a->arm, &a->terms, coef, obs, &loads, r, &app->eval);
}

/* chi^2 of the inliers at any coefficients. */
static double chi2_at(kc_app_t *app, const double *coef)
{
    double sum = 0.0, W[36], r[6];
    for (uint32_t i = 0u; i < app->est.n_obs; i++) {
        const kc_obs_t *obs = &app->est.obs[i];
        if (app->est.outlier[i] || kc_la_whiten(obs->cov, 6u, W) != KC_OK) { continue; }
        residual_at(app, coef, obs, r);
        kc_la_whiten_apply(W, 6u, r, r);
        for (uint32_t k = 0u; k < 6u; k++) { sum += r[k] * r[k]; }
    }
    return sum;
}

/* Probability of so large an improvement if the active table were right: the improvement of chi^2, in units
 * of the noise that the residuals show, against the number of free coefficients. */
static double p_no_change(kc_app_t *app)
{
    const kc_est_t *e = &app->est;
    if (e->rank == 0u || !solved(app)) { return 1.0; }
    double scale = kc_max(1.0, e->noise_scale);
    double gain = chi2_at(app, app->tables.active.kin.value) - chi2_at(app, app->est.coef);
    return kc_chi2_sf(kc_max(0.0, gain) / (scale * scale), e->rank);
}

/* A fit counts as poor when the estimator did not finish, or the residuals are beyond what the stated
 * noise can explain, also without as many poses as may be rejected. Noise somewhat larger than stated is no
 * reason: sigma is scaled by it. */
static int poor(const kc_app_t *app, double p_fit)
{
    const kc_est_t *e = &app->est;
    int all_rejected = e->opt.outlier_max > 0u && e->n_outliers >= e->opt.outlier_max;
    return app->cal.est_status != KC_OK || e->dof == 0u || e->noise_scale > KC_POOR_NOISE_SCALE ||
           ((e->noise_scale > KC_POOR_NOISE_SCALE_P || all_rejected) && p_fit < KC_POOR_P_FIT);
}

static int estimated(uint8_t status)
{
    return status != (uint8_t)KC_COEF_MASKED && status != (uint8_t)KC_COEF_HELD;
}

/* ---- proposal ---- */

static void fill_kin(kc_app_t *app, kc_kin_t *k)
{
    const kc_active_t *a = &app->tables.active;
    double scale = kc_max(1.0, app->est.noise_scale);
    memset(k, 0, sizeof *k);
    k->n_coef = a->terms.n_coef;
    for (uint32_t c = 0u; c < k->n_coef; c++) {
        int est = solved(app) && estimated(app->est.status[c]);
        k->value[c] = est ? app->est.coef[c] : a->kin.value[c];
        k->sigma[c] = est ? scale * app->est.sigma[c] : a->kin.sigma[c];
    }
    k->arm_crc = a->crc[KC_TBL_ARM];
    k->terms_crc = a->crc[KC_TBL_TERMS];
    k->prev_crc = a->crc[KC_TBL_KIN];
    k->session = app->session;
    k->n_poses = app->cal.n_meas;
    k->made_us = app->clock_us;
}

/* Upper triangle of the scaled covariance, row by row, of n_coef rows. */
static void fill_cov(const kc_app_t *app, kc_proposal_t *p)
{
    double scale2 = kc_max(1.0, app->est.noise_scale) * kc_max(1.0, app->est.noise_scale);
    uint32_t k = 0u;
    if (!solved(app)) { return; }
    for (uint32_t i = 0u; i < p->kin.n_coef; i++) {
        for (uint32_t j = i; j < p->kin.n_coef; j++) {
            p->cov[k++] = scale2 * app->est.cov[i * KC_COEF_MAX + j];
        }
    }
}

/* RMS residual with the table in force, at the poses that the fit kept: those of fit_pos_m. */
static void fill_before(kc_app_t *app, kc_proposal_t *p)
{
    double pos2 = 0.0, rot2 = 0.0, r[6];
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < app->est.n_obs; i++) {
        if (app->est.outlier[i]) { continue; }
        residual_at(app, app->tables.active.kin.value, &app->est.obs[i], r);
        pos2 += kc_v3_dot(r, r);
        rot2 += kc_v3_dot(&r[3], &r[3]);
        n++;
    }
    p->before_pos_m = n > 0u ? kc_sqrt(pos2 / (double)n) : 0.0;
    p->before_rot_rad = n > 0u ? kc_sqrt(rot2 / (double)n) : 0.0;
}

static void fill_numbers(kc_app_t *app, kc_proposal_t *p)
{
    const kc_est_t *e = &app->est;
    memcpy(p->status, e->status, sizeof p->status);
    memcpy(p->confounded, e->confounded, sizeof p->confounded);
    p->session = app->session;
    p->n_poses = app->cal.n_meas;
    p->n_outliers = e->n_outliers;
    p->rank = e->rank;
    p->n_free = e->n_free;
    p->dof = e->dof;
    p->chi2 = e->chi2;
    p->noise_scale = e->noise_scale;
    p->p_fit = e->dof > 0u ? kc_chi2_sf(e->chi2, e->dof) : 1.0;
    p->p_no_change = p_no_change(app);
    p->kkt = e->kkt;
    p->cond = e->cond;
    p->fit_pos_m = e->fit_pos_m;
    p->fit_rot_rad = e->fit_rot_rad;
    p->pred_pos_m = app->cal.pred_pos_m;
    p->pred_rot_rad = app->cal.pred_rot_rad;
    p->crc_kin_before = app->tables.active.crc[KC_TBL_KIN];
}

static void make(kc_app_t *app, kc_proposal_t *p)
{
    fill_kin(app, &p->kin);
    fill_numbers(app, p);
    fill_before(app, p);
    fill_cov(app, p);
    if (poor(app, p->p_fit)) {
        p->verdict = KC_VERDICT_POOR;
    } else {
        p->verdict = p->p_no_change > app->tables.active.config.no_change_p ? KC_VERDICT_NO_CHANGE
                                                                            : KC_VERDICT_CHANGE;
    }
    (void)kc_tbl_encode(KC_TBL_KIN, &p->kin, 0u, app->proposal_image, KC_KIN_IMAGE_MAX, &app->proposal_n);
    p->crc = kc_tbl_image_crc(app->proposal_image, app->proposal_n);
    app->proposal_kin = p->kin;
}

/* Coefficients that the data could not determine. */
static void report_held(kc_app_t *app, kc_out_t *out)
{
    const kc_est_t *e = &app->est;
    if (e->rank == e->n_free) { return; }
    kc_event(&out->events, KC_EVT_CAL_RANK, -1, (double)e->rank, (double)e->n_free);
    for (uint32_t c = 0u; c < app->proposal_kin.n_coef; c++) {
        if (e->status[c] != (uint8_t)KC_COEF_HELD) { continue; }
        kc_event(&out->events, KC_EVT_CAL_HELD, (int32_t)c, app->proposal_kin.value[c], 0.0);
    }
}

/* ---- policy ---- */

/* RMS change of the predicted tool position over the search space. */
static double change_m(kc_app_t *app)
{
    const kc_active_t *a = &app->tables.active;
    uint32_t n = a->space.n_cand, stride = (n + KC_PRED_MAX - 1u) / KC_PRED_MAX, count = 0u;
    double sum = 0.0;
    for (uint32_t c = 0u; c < n; c += stride, count++) {
        kc_ctx_t ctx;
        kc_loads_t loads;
        double p[3];
        kc_update_ctx(app, c, &ctx);
        kc_model_loads(&a->arm, &a->terms, a->kin.value, &ctx, &loads);
        kc_model_eval(&a->arm, &a->terms, a->kin.value, &ctx, &loads, 0, &app->eval);
        kc_v3_copy(app->eval.T.p_m, p);
        kc_model_loads(&a->arm, &a->terms, app->proposal_kin.value, &ctx, &loads);
        kc_model_eval(&a->arm, &a->terms, app->proposal_kin.value, &ctx, &loads, 0, &app->eval);
        kc_v3_sub(app->eval.T.p_m, p, p);
        sum += kc_v3_dot(p, p);
    }
    return kc_sqrt(sum / (double)count);
}

static int bounds_active(const kc_proposal_t *p)
{
    int any = 0;
    for (uint32_t c = 0u; c < p->kin.n_coef; c++) {
        any = any || p->status[c] == (uint8_t)KC_COEF_AT_LOWER || p->status[c] == (uint8_t)KC_COEF_AT_UPPER;
    }
    return any;
}

/* Small, well determined, nothing odd about it: the table may allow to take it without the ground. */
static int acceptable(kc_app_t *app, const kc_proposal_t *p)
{
    const kc_config_t *c = &app->tables.active.config;
    return c->accept_on_board && p->rank == p->n_free && !bounds_active(p) &&
           p->p_fit >= c->accept_p_fit_min && p->pred_pos_m <= c->accept_sigma_max_pos_m &&
           change_m(app) <= c->accept_change_max_pos_m;
}

/* ---- activation ---- */

static void forget(kc_app_t *app, kc_out_t *out)
{
    app->proposal_crc = 0u;
    kc_journal_store(out, KC_STORE_PROPOSAL, app->proposal_image, 0u);
}

/* New table in force, the old one kept, both stored before the proposal is forgotten, so that a kill
 * between any two of the writes leaves something consistent. */
static kc_status_t activate(kc_app_t *app, kc_out_t *out)
{
    kc_status_t st = kc_tbl_set_kin(&app->tables, &app->proposal_kin, &out->events);
    if (st != KC_OK) { return st; }
    kc_journal_kin(app, out);
    forget(app, out);
    kc_event(&out->events, KC_EVT_COR_ACTIVE, -1, (double)app->tables.active.crc[KC_TBL_KIN], 0.0);
    kc_app_enter(app, KC_ST_IDLE);
    return KC_OK;
}

static void review(kc_app_t *app, kc_out_t *out)
{
    const kc_proposal_t *p = &out->proposal;
    app->proposal_crc = p->crc;
    kc_journal_store(out, KC_STORE_PROPOSAL, app->proposal_image, app->proposal_n);
    kc_event(&out->events, KC_EVT_COR_PROPOSED, -1, (double)p->crc, (double)p->n_poses);
    kc_app_enter(app, KC_ST_REVIEW);
}

int kc_propose_run(kc_app_t *app, kc_out_t *out)
{
    kc_proposal_t *p = &out->proposal;
    make(app, p);
    report_held(app, out);
    out->has_proposal = 1u;
    if (p->verdict == KC_VERDICT_NO_CHANGE) {
        kc_event(&out->events, KC_EVT_COR_NO_CHANGE, -1, p->p_no_change, 0.0);
        kc_app_enter(app, KC_ST_IDLE);
        return 0;
    }
    if (p->verdict == KC_VERDICT_POOR) {
        kc_event(&out->events, KC_EVT_CAL_POOR, -1, p->p_fit, p->noise_scale);
    } else if (acceptable(app, p) && activate(app, out) == KC_OK) {
        kc_event(&out->events, KC_EVT_COR_ON_BOARD, -1, (double)p->crc, 0.0);
        return 0;
    }
    review(app, out);
    return 0;
}

/* ---- review ---- */

int kc_propose_expire(kc_app_t *app, kc_out_t *out)
{
    if (app->now_us - app->state_us <= KC_ARMED_US) { return 0; }
    kc_event(&out->events, KC_EVT_COR_EXPIRED, -1, (double)app->proposal_crc, 0.0);
    kc_app_enter(app, KC_ST_REVIEW);
    return 0;
}

static kc_status_t named(kc_app_t *app, kc_out_t *out, uint32_t crc, uint32_t want)
{
    if (crc == want) { return KC_OK; }
    return kc_cmd_refuse(app, out, KC_EVT_CMD_CRC, -1, (double)crc, (double)want, KC_ERR_CRC);
}

kc_status_t kc_propose_arm(kc_app_t *app, kc_out_t *out, uint32_t crc)
{
    kc_status_t st = named(app, out, crc, app->proposal_crc);
    if (st != KC_OK) { return st; }
    kc_event(&out->events, KC_EVT_COR_ARMED, -1, (double)crc, 0.0);
    kc_app_enter(app, KC_ST_ARMED);
    return KC_OK;
}

kc_status_t kc_propose_go(kc_app_t *app, kc_out_t *out, uint32_t crc)
{
    kc_status_t st = named(app, out, crc, app->proposal_crc);
    return st == KC_OK ? activate(app, out) : st;
}

void kc_propose_drop(kc_app_t *app, kc_out_t *out)
{
    if (app->proposal_crc == 0u) { return; }
    kc_event(&out->events, KC_EVT_COR_REJECTED, -1, (double)app->proposal_crc, 0.0);
    forget(app, out);
}

kc_status_t kc_propose_reject(kc_app_t *app, kc_out_t *out, uint32_t crc)
{
    kc_status_t st = named(app, out, crc, app->proposal_crc);
    if (st != KC_OK) { return st; }
    kc_propose_drop(app, out);
    kc_app_enter(app, KC_ST_IDLE);
    return KC_OK;
}

kc_status_t kc_propose_rollback(kc_app_t *app, kc_out_t *out, uint32_t crc)
{
    kc_status_t st = named(app, out, crc, app->tables.active.crc[KC_TBL_KIN]);
    if (st == KC_OK) { st = kc_tbl_rollback(&app->tables, &out->events); }
    if (st != KC_OK) { return st; }
    kc_journal_kin(app, out);
    kc_app_enter(app, KC_ST_IDLE);
    return KC_OK;
}

/* A stored proposal is kept for review if it still belongs to the active tables. */
kc_status_t kc_propose_load(kc_app_t *app, const uint8_t *image, uint32_t n)
{
    kc_events_t *ev = &app->boot_events;
    kc_kin_t *k = &app->proposal_kin;
    uint32_t active = app->tables.active.crc[KC_TBL_KIN];
    if (app->proposal_crc != 0u || kc_tbl_image_crc(image, n) == active) { return KC_ERR_STATE; }
    kc_status_t st = n <= KC_KIN_IMAGE_MAX ? kc_tbl_decode(KC_TBL_KIN, image, n, k, ev) : KC_ERR_FORMAT;
    if (st == KC_OK) { st = kc_tbl_kin_fits(&app->tables, k, ev); }
    if (st != KC_OK) { return st; }
    if (k->prev_crc != active) {
        kc_event(ev, KC_EVT_TBL_DEPENDS, KC_TBL_KIN, (double)k->prev_crc, (double)active);
        return KC_ERR_STATE;
    }
    memcpy(app->proposal_image, image, n);
    app->proposal_n = n;
    app->proposal_crc = kc_tbl_image_crc(image, n);
    return KC_OK;
}
