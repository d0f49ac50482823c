/* UPDATE: estimator, GP, next candidate; one part a step. */
#include <string.h>

#include "kc_app_priv.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_vec.h"

#define PREDICT_ITER_MAX 8u   /* enough for an approximate solution */
#define OWN_MIN 3u /* fewest poses besides the local initial poses */
#define LOCAL_TRIED_MIN 6u /* local initial poses after which a tag must have been detected */
#define MISMATCH_NOISE_SCALE 3.5 /* noise scale of local initial poses that is a mismatch ... */
#define MISMATCH_DOF_MIN 12u /* ... with at least these degrees of freedom (two redundant poses) */
#define MISMATCH_OUTLIERS_MIN 3u /* this many outliers among them are not bad detections */
#define GOOD_NOISE_SCALE 2.0 /* a fit with a larger noise scale gets a second start */

/* ---- start ---- */

static void take_candidates(kc_app_t *app)
{
    const kc_space_t *s = &app->tables.active.space;
    for (uint32_t c = 0u; c < s->n_cand; c++) {
        kc_pose_t T;
        kc_move_goal(app, c, &T);
        kc_v3_copy(T.p_m, app->cand_pt[c].p_m);
        kc_R_to_quat(T.R, app->cand_pt[c].q_wxyz);
        memcpy(&app->tables.staging.choice.cand_q[c * KC_JOINT_MAX], s->cand[c].q_seed,
               sizeof s->cand[c].q_seed);
        app->cal.usable[c] =
            (uint8_t)!kc_space_local(s, c); /* the acquisition never chooses local initial poses */
    }
}

/* Local initial poses still to come; without those in reserve if only_due. */
static uint32_t local_left(const kc_app_t *app, int only_due)
{
    const kc_space_t *s = &app->tables.active.space;
    uint32_t n = 0u;
    for (uint32_t i = app->cal.i_initial; i < s->n_initial; i++) {
        n += kc_space_local(s, s->initial[i]) && !(only_due && kc_space_reserve(s, s->initial[i])) ? 1u : 0u;
    }
    return n;
}

/* Local initial poses come on top of the requested ones: measured, current (0 or 1) and to come; one in
 * reserve counts when it is taken. */
static uint32_t goal_of(const kc_app_t *app, uint32_t under_way)
{
    uint32_t n = app->cal.n_own + app->cal.n_local + under_way + local_left(app, 1);
    return n < KC_MEAS_MAX ? n : KC_MEAS_MAX;
}

kc_status_t kc_update_start(kc_app_t *app, kc_out_t *out, kc_acq_t acq, uint32_t n_goal, uint32_t seed,
                            uint64_t free_mask)
{
    kc_active_t *a = &app->tables.active;
    kc_cal_t *c = &app->cal;
    double dist = 0.0;
    if (kc_move_node(app, &dist) == KC_NODE_NONE) {
        return kc_cmd_refuse(app, out, KC_EVT_CAL_NO_PATH, -1, dist, 1.0, KC_ERR_PATH);
    }
    kc_tbl_discard(&app->tables, &out->events);
    memset(c, 0, sizeof *c);
    c->session = ++app->session;
    c->acq = acq;
    c->n_own = kc_space_n_local(&a->space) > 0u && n_goal < OWN_MIN ? OWN_MIN : n_goal;
    c->n_goal = goal_of(app, 0u);
    c->rng = seed;
    c->free_mask = free_mask;
    c->start_us = app->now_us;
    app->energy_j = 0.0;
    app->energy_us = app->now_us;
    c->candidate = -1;
    memcpy(c->coef, a->kin.value, sizeof c->coef);
    take_candidates(app);
    app->est.arm = &a->arm;
    app->est.terms = &a->terms;
    app->est.opt = a->config.est;
    app->est.opt.free_mask = free_mask;
    app->est.hold_none = 0u;
    app->est.n_obs = 0u;
    c->gp_ok = kc_gp_init(&app->big.gp, &a->kernel, 0u, app->cand_pt, a->space.n_cand) == KC_OK;
    c->up = KC_UP_SELECT;
    kc_event(&out->events, KC_EVT_CAL_START, (int32_t)c->session, (double)n_goal, (double)acq);
    kc_app_enter(app, KC_ST_UPDATE);
    return KC_OK;
}

/* ---- objective f (eq. 6) ---- */

static void residual_of(kc_app_t *app, const double *coef, uint32_t i, double *pos_m, double *rot_rad)
{
    const kc_active_t *a = &app->tables.active;
    const kc_obs_t *obs = &app->est.obs[i];
    kc_loads_t loads;
    double r[6];
    kc_model_loads(&a->arm, &a->terms, coef, &obs->ctx, &loads);
    (void)kc_model_residual(&a->arm, &a->terms, coef, obs, &loads, r, &app->eval);
    *pos_m = kc_v3_norm(r);
    *rot_rad = kc_v3_norm(&r[3]);
}

/* Objective of all poses with the latest correction; the last one is the newest pose. */
static void objective(kc_app_t *app)
{
    const kc_config_t *c = &app->tables.active.config;
    for (uint32_t i = 0u; i < app->cal.n_meas; i++) {
        residual_of(app, app->cal.coef, i, &app->dp_m[i], &app->dr_rad[i]);
    }
    kc_acq_objective(app->dp_m, app->dr_rad, app->cal.n_meas, c->a1, c->sp_floor_m, c->sq_floor_rad, app->y);
}

static void point_of(const kc_obs_t *obs, kc_point_t *x)
{
    kc_v3_copy(obs->p_m, x->p_m);
    memcpy(x->q_wxyz, obs->q_wxyz, sizeof x->q_wxyz);
}

/* ---- estimate ---- */

static int solved(kc_status_t st) { return st == KC_OK || st == KC_ERR_ITER; }

static void solve_from(kc_app_t *app, const double *start)
{
    memcpy(app->est.start, start, sizeof app->est.start);
    app->cal.est_status = kc_est_solve(&app->est);
}

static void report_outliers(kc_app_t *app, kc_out_t *out)
{
    for (uint32_t i = 0u; i < app->cal.n_meas; i++) {
        if (app->est.outlier[i] && !app->cal.outlier_reported[i]) {
            kc_event(&out->events, KC_EVT_CAL_OUTLIER, (int32_t)i + 1, 0.0, 0.0);
        }
        if (!app->est.outlier[i] && app->cal.outlier_reported[i]) {
            kc_event(&out->events, KC_EVT_CAL_OUTLIER_ACCEPTED, (int32_t)i + 1, 0.0, 0.0);
        }
        app->cal.outlier_reported[i] = app->est.outlier[i];
    }
}

/* While the data do not determine all coefficients, an estimate can fit the measured poses and be far off
 * elsewhere. It is used for aiming once it has predicted a new pose twice as well as the correction in
 * use; a smaller gain can be chance. */
static int predicts_better(kc_app_t *app, uint32_t newest)
{
    const kc_config_t *c = &app->tables.active.config;
    double pos_m = 0.0, rot_rad = 0.0;
    if (newest == 0u || !solved(app->cal.est_status)) { return 0; }
    residual_of(app, app->est.coef, newest, &pos_m, &rot_rad);
    return 2.0 * (c->a1 * pos_m / c->vopt_len_m + (1.0 - c->a1) * rot_rad) <
           c->a1 * app->cal.res_pos_m / c->vopt_len_m + (1.0 - c->a1) * app->cal.res_rot_rad;
}

static void add(kc_app_t *app)
{
    kc_cal_t *c = &app->cal;
    uint32_t last = c->n_meas - 1u;
    kc_point_t x;
    double var = 0.0;
    app->est.hold_none = (uint8_t)(c->n_meas ==
                                   c->n_local); /* observations near one posture leave much undetermined */
    objective(app);
    c->res_pos_m = app->dp_m[last];
    c->res_rot_rad = app->dr_rad[last];
    c->f = app->y[last];
    c->trusted = (uint8_t)predicts_better(app, last);
    point_of(&app->est.obs[last], &x);
    c->gp_mean = 0.0;
    if (c->gp_ok) { kc_gp_predict(&app->big.gp, &x, &c->gp_mean, &var); }
    c->gp_sigma = kc_sqrt(kc_max(var, 0.0));
    solve_from(app, app->tables.active.kin.value);
    c->up = KC_UP_WARM;
}

static int differ(const double *a, const double *b)
{
    int any = 0;
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) { any = any || a[c] < b[c] || a[c] > b[c]; }
    return any;
}

/* Large errors like the paper's can make a first fit converge to a wrong minimum, where good observations
 * look like outliers. If a fit is not good, the solution so far is the second start; fewer outliers win,
 * then the lower cost. Only if nothing is held: a held coefficient keeps the active table's value, not
 * that of a trial. */
static void warm(kc_app_t *app)
{
    const kc_est_t *e = &app->est;
    const double *start = app->tables.active.kin.value;
    uint32_t n_out = e->n_outliers;
    int good = app->cal.est_status == KC_OK && e->noise_scale <= GOOD_NOISE_SCALE && n_out == 0u;
    double cost = solved(app->cal.est_status) ? e->cost : KC_INF;
    if (!good && differ(app->cal.coef, start)) {
        solve_from(app, app->cal.coef);
        int free = e->hold_none || e->rank == e->n_free;
        int better = e->n_outliers < n_out || (e->n_outliers == n_out && e->cost < cost);
        if (!solved(app->cal.est_status) || !free || !better) { solve_from(app, start); }
    }
    app->cal.up = KC_UP_GP;
}

/* Whether all coefficients of TERMS are requested: then residuals are not due to a choice of the operator. */
static int all_requested(const kc_est_t *e)
{
    for (uint32_t c = 0u; c < e->terms->n_coef; c++) {
        if (e->terms->coef[c].enabled != 0u && (e->opt.free_mask >> c & 1u) == 0u) { return 0; }
    }
    return 1;
}

/* Local initial poses that are all a little off, or several that do not fit the others. Effects that a
 * model lacks are nearly the same at all of them, so they are not the reason. */
static int local_mismatch(const kc_app_t *app)
{
    const kc_config_t *c = &app->tables.active.config;
    const kc_est_t *e = &app->est;
    int limited = c->mismatch_pos_m > 0.0 || c->mismatch_rot_rad > 0.0;
    int noisy = e->dof >= MISMATCH_DOF_MIN && e->noise_scale > MISMATCH_NOISE_SCALE;
    return limited && e->hold_none && all_requested(e) && (noisy || e->n_outliers >= MISMATCH_OUTLIERS_MIN);
}

/* Model mismatch: observations that no correction within its bounds explains. The paths were not verified
 * for such an arm, so it does not move on. One observation is enough at the local initial poses; later two
 * are needed, since one can be a bad detection. */
static int mismatch(kc_app_t *app, kc_out_t *out)
{
    const kc_config_t *c = &app->tables.active.config;
    if (app->est.rank < app->est.n_free && !app->est.hold_none) { return 0; } /* a coefficient is held */
    int another = local_mismatch(app);
    double pos_m = 0.0, rot_rad = 0.0, last_pos_m = 0.0, last_rot_rad = 0.0;
    uint32_t n = 0u, last = 0u;
    for (uint32_t i = 0u; i < app->cal.n_meas; i++) {
        residual_of(app, app->est.coef, i, &pos_m, &rot_rad);
        int off = (c->mismatch_pos_m > 0.0 && pos_m > c->mismatch_pos_m) ||
                  (c->mismatch_rot_rad > 0.0 && rot_rad > c->mismatch_rot_rad);
        if (!off && !(another && i + 1u == app->cal.n_meas)) { continue; }
        n++;
        last = i;
        last_pos_m = pos_m;
        last_rot_rad = rot_rad;
    }
    if (n == 0u || (n == 1u && app->cal.n_meas > app->cal.n_local)) { return 0; }
    kc_event(&out->events, KC_EVT_CAL_MODEL_MISMATCH, (int32_t)last + 1, last_pos_m, last_rot_rad);
    kc_app_abort(app, out, KC_CAUSE_MODEL_MISMATCH);
    return 1;
}

static void learn(kc_app_t *app, kc_out_t *out)
{
    kc_cal_t *c = &app->cal;
    uint32_t last = c->n_meas - 1u;
    kc_point_t x;
    report_outliers(app, out);
    if (!solved(c->est_status)) {
        kc_event(&out->events, KC_EVT_CAL_EST, -1, (double)c->est_status, 0.0);
    } else if (mismatch(app, out)) {
        return;
    } else if (app->est.rank == app->est.n_free || app->est.hold_none || c->trusted) {
        memcpy(c->coef, app->est.coef, sizeof c->coef);
    }
    objective(app);
    point_of(&app->est.obs[last], &x);
    if (c->gp_ok) { c->gp_ok = kc_gp_add(&app->big.gp, &x, app->y[last], app->cand_pt) == KC_OK; }
    if (c->gp_ok) {
        kc_gp_set_y(&app->big.gp, app->y);
        if (app->tables.active.kernel.choose) { (void)kc_gp_choose(&app->big.gp, app->cand_pt); }
    }
    c->up = KC_UP_REPORT;
}

/* ---- predicted uncertainty ---- */

void kc_update_ctx(const kc_app_t *app, uint32_t cand, kc_ctx_t *ctx)
{
    memset(ctx, 0, sizeof *ctx);
    kc_path_joints(&app->tables.active.space, KC_HUB_MAX + cand, ctx->q);
    kc_v3_copy(app->arm.g_m_s2, ctx->g_m_s2);
    ctx->temp_c = app->arm.temp_c;
    ctx->payload_kg = app->arm.payload_kg;
    ctx->t_s = (double)app->now_us * 1e-6;
}

/* RMS of the predicted pose sigma over the search space, from at most KC_PRED_MAX candidates; the stated
 * noise is scaled up to what the residuals show. */
void kc_update_predict(kc_app_t *app)
{
    uint32_t n = app->tables.active.space.n_cand;
    uint32_t stride = (n + KC_PRED_MAX - 1u) / KC_PRED_MAX, count = 0u;
    double pos = 0.0, rot = 0.0, cov[36];
    for (uint32_t c = 0u; c < n; c += stride, count++) {
        kc_ctx_t ctx;
        kc_update_ctx(app, c, &ctx);
        kc_est_pose_cov(&app->est, &ctx, &app->eval, cov);
        pos += cov[0] + cov[7] + cov[14];
        rot += cov[21] + cov[28] + cov[35];
    }
    double scale = kc_max(1.0, app->est.noise_scale);
    app->cal.pred_pos_m = scale * kc_sqrt(pos / (double)count);
    app->cal.pred_rot_rad = scale * kc_sqrt(rot / (double)count);
}

/* ---- report, stop ---- */

static void fill_progress(const kc_app_t *app, kc_progress_t *p)
{
    const kc_cal_t *c = &app->cal;
    const kc_est_t *e = &app->est;
    p->session = app->session;
    p->pose = c->n_meas;
    p->n_goal = c->n_goal;
    p->candidate = c->candidate;
    p->replicate = c->replicate;
    p->servo_steps = c->servo_steps;
    p->acquisition = c->chosen_by;
    p->acquisition_value = c->acq_value;
    p->res_pos_m = c->res_pos_m;
    p->res_rot_rad = c->res_rot_rad;
    p->f = c->f;
    p->gp_mean = c->gp_mean;
    p->gp_sigma = c->gp_sigma;
    p->pred_pos_m = c->pred_pos_m;
    p->pred_rot_rad = c->pred_rot_rad;
    p->rank = e->rank;
    p->n_free = e->n_free;
    p->dof = e->dof;
    p->chi2 = e->chi2;
    p->est_status = (int32_t)c->est_status;
    p->fit_pos_m = e->fit_pos_m;
    p->fit_rot_rad = e->fit_rot_rad;
    p->energy_j = app->energy_j;
    memcpy(p->coef, c->coef, sizeof p->coef);
}

/* Local initial poses alone are never enough for a proposal. */
static int enough(const kc_cal_t *c) { return c->n_meas - c->n_local >= (c->n_local > 0u ? OWN_MIN : 1u); }

/* A requirement of 0 is none. It is not met while a coefficient is undetermined. */
static int certain(const kc_app_t *app)
{
    const kc_config_t *c = &app->tables.active.config;
    if (c->stop_pos_m <= 0.0 && c->stop_rot_rad <= 0.0) { return 0; }
    return enough(&app->cal) && app->cal.est_status == KC_OK && app->est.rank == app->est.n_free &&
           app->est.dof >= app->est.n_free &&
           (c->stop_pos_m <= 0.0 || app->cal.pred_pos_m <= c->stop_pos_m) &&
           (c->stop_rot_rad <= 0.0 || app->cal.pred_rot_rad <= c->stop_rot_rad);
}

static void report(kc_app_t *app, kc_out_t *out)
{
    kc_cal_t *c = &app->cal;
    if (solved(c->est_status)) { kc_update_predict(app); }
    out->has_progress = 1u;
    fill_progress(app, &out->progress);
    kc_event(&out->events, KC_EVT_CAL_POSE, (int32_t)c->n_meas, c->res_pos_m, c->res_rot_rad);
    if (certain(app)) {
        kc_event(&out->events, KC_EVT_CAL_CONVERGED, -1, c->pred_pos_m, app->tables.active.config.stop_pos_m);
        c->stop = 1u;
    }
    c->up = KC_UP_SELECT;
}

/* ---- next candidate ---- */

/* Local initial poses in reserve are taken while tags are detected at few; the last ones also while a
 * coefficient is undetermined. */
static int skip_reserve(const kc_app_t *app)
{
    int open = app->est.rank < app->est.n_free && local_left(app, 1) == 0u;
    return 2u * app->cal.n_local >= app->cal.n_tried && !open;
}

/* Initial poses in their order, without those that have become unusable. */
static int next_initial(kc_app_t *app, uint32_t *cand)
{
    const kc_space_t *s = &app->tables.active.space;
    while (app->cal.i_initial < s->n_initial) {
        *cand = s->initial[app->cal.i_initial++];
        if (kc_space_local(s, *cand)) {
            if (kc_space_reserve(s, *cand) && skip_reserve(app)) { continue; }
            app->cal.n_tried++;
            return 1;
        }
        if (app->cal.usable[*cand]) { return 1; }
    }
    return 0;
}

/* The first measured poses again (not the local initial poses), one after every replicate_every poses. */
static int next_replicate(kc_app_t *app, uint32_t *cand)
{
    kc_cal_t *c = &app->cal;
    uint32_t every = app->tables.active.config.replicate_every, n = c->n_meas - c->n_local;
    if (every == 0u || n == 0u || n % every != 0u || c->rep_at == n) { return 0; }
    c->rep_at = n;
    *cand = c->cand_of[c->n_local + c->n_rep++];
    return 1;
}

static int32_t times_measured(const kc_cal_t *c, uint32_t cand)
{
    int32_t n = 0;
    for (uint32_t i = 0u; i < c->n_meas; i++) { n += c->cand_of[i] == cand; }
    return n;
}

/* Joints expected at each candidate after the servo: with large errors they are far from the seeds, and the
 * information of a pose depends on them (tests/bench/samples.py --space). */
static void predict_joints(kc_app_t *app)
{
    for (uint32_t c = 0u; c < app->tables.active.space.n_cand; c++) {
        double q[KC_JOINT_MAX] = {0};
        if (app->cal.usable[c] == 0u) { continue; }
        kc_move_joints(app, c, PREDICT_ITER_MAX, q);
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
            app->tables.staging.choice.cand_q[c * KC_JOINT_MAX + j] = (float)q[j];
        }
    }
}

/* The requested acquisition; random where it cannot be evaluated (GP lost, nothing solved yet). */
static kc_status_t acquire(kc_app_t *app, uint32_t *cand)
{
    const kc_active_t *a = &app->tables.active;
    kc_cal_t *c = &app->cal;
    kc_status_t st = KC_ERR_ARG;
    if (c->acq == KC_ACQ_UCB && c->gp_ok) {
        double beta = kc_acq_beta(a->space.n_cand, c->n_meas + 1u, a->config.beta_scale);
        st = kc_acq_ucb(&app->big.gp, c->usable, beta, cand, &c->acq_value);
    } else if ((c->acq == KC_ACQ_DOPT || c->acq == KC_ACQ_VOPT) && c->n_meas > 0u && solved(c->est_status)) {
        const double *cov = app->est.obs[c->n_meas - 1u].cov; /* expected noise of the next one */
        predict_joints(app);
        kc_choice_work_t *w = &app->tables.staging.choice;
        st = kc_acq_info(c->acq, &app->est, w->cand_q, a->space.n_cand, c->usable, cov, a->config.vopt_len_m,
                         &w->acq, cand, &c->acq_value);
    }
    c->chosen_by = (int32_t)c->acq;
    if (st == KC_OK) { return st; }
    c->chosen_by = (int32_t)KC_ACQ_RANDOM;
    c->acq_value = 0.0;
    return kc_acq_random(c->usable, a->space.n_cand, &c->rng, cand);
}

static kc_status_t choose(kc_app_t *app, uint32_t *cand)
{
    app->cal.acq_value = 0.0;
    app->cal.chosen_by = -1;
    if (next_initial(app, cand) || next_replicate(app, cand)) { return KC_OK; }
    return acquire(app, cand);
}

static int finish(kc_app_t *app, kc_out_t *out, kc_cause_t if_nothing)
{
    if (!enough(&app->cal)) {
        kc_app_abort(app, out, if_nothing);
        return 0;
    }
    app->cal.up = KC_UP_PROPOSE;
    return 1;
}

/* Too few detections at the local initial poses to determine the errors of the arm: without any it makes
 * no larger moves, and with hardly any it does not leave the park pose. */
static int too_few_detections(kc_app_t *app, kc_out_t *out)
{
    const kc_cal_t *c = &app->cal;
    int nothing = c->n_local == 0u && c->n_tried >= LOCAL_TRIED_MIN;
    int little = 3u * c->n_local < c->n_tried && local_left(app, 0) == 0u;
    if (!nothing && !little) { return 0; }
    kc_event(&out->events, KC_EVT_CAL_TAGS_NOT_DETECTED, -1, (double)c->n_local, (double)c->n_tried);
    kc_app_abort(app, out, KC_CAUSE_TAGS_NOT_DETECTED);
    return 1;
}

static int select(kc_app_t *app, kc_out_t *out)
{
    kc_cal_t *c = &app->cal;
    uint32_t cand = 0u;
    if (too_few_detections(app, out)) { return 0; }
    if (c->stop || c->n_meas >= goal_of(app, 0u)) { return finish(app, out, KC_CAUSE_NO_CANDIDATE); }
    if (choose(app, &cand) != KC_OK) {
        kc_event(&out->events, KC_EVT_CAL_NO_CANDIDATE, -1, 0.0, 0.0);
        return finish(app, out, KC_CAUSE_NO_CANDIDATE);
    }
    c->n_goal = goal_of(app, kc_space_local(&app->tables.active.space, cand) ? 1u : 0u);
    c->candidate = (int32_t)cand;
    c->replicate = times_measured(c, cand);
    c->servo_steps = 0u;
    kc_status_t st = kc_move_begin(app, out, cand);
    if (st == KC_ERR_STATE) {
        kc_app_abort(app, out, KC_CAUSE_NO_PATH);
    } else if (st != KC_OK) {
        kc_observe_skip(app, out); /* the next step chooses another one */
    }
    return 0;
}

/* Energy used since the step before, by what moves now. */
static void count_energy(kc_app_t *app)
{
    const kc_config_t *c = &app->tables.active.config;
    double power_w = app->arm.moving || app->pantilt.moving ? c->power_move_w : c->power_idle_w;
    app->energy_j += power_w * (double)(app->now_us - app->energy_us) * 1e-6;
    app->energy_us = app->now_us;
}

static int used_up(const kc_app_t *app, kc_out_t *out)
{
    const kc_config_t *c = &app->tables.active.config;
    uint64_t used_us = app->now_us - app->cal.start_us;
    int late = c->budget_us > 0u && used_us > c->budget_us;
    int flat = c->energy_budget_j > 0.0 && app->energy_j > c->energy_budget_j;
    if (late) { kc_event(&out->events, KC_EVT_CAL_BUDGET, -1, (double)used_us, (double)c->budget_us); }
    if (flat) { kc_event(&out->events, KC_EVT_CAL_ENERGY, -1, app->energy_j, c->energy_budget_j); }
    return late || flat;
}

void kc_update_budget(kc_app_t *app, kc_out_t *out)
{
    if (!kc_app_calibrating(app)) { return; }
    count_energy(app);
    int selecting = app->state != KC_ST_UPDATE || app->cal.up == KC_UP_SELECT;
    if (!selecting || !used_up(app, out)) { return; }
    if (app->state != KC_ST_UPDATE) {
        kc_move_hold(app, out);
        app->observe.waiting = 0u;
        kc_app_enter(app, KC_ST_UPDATE);
    }
    (void)finish(app, out, KC_CAUSE_BUDGET);
}

int kc_update_run(kc_app_t *app, kc_out_t *out)
{
    switch (app->cal.up) {
    case KC_UP_ADD: add(app); return 0;
    case KC_UP_WARM: warm(app); return 0;
    case KC_UP_GP: learn(app, out); return 0;
    case KC_UP_REPORT: report(app, out); return 0;
    case KC_UP_PROPOSE: return kc_propose_run(app, out);
    default: return select(app, out);
    }
}
