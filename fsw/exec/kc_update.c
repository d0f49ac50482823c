/* UPDATE: estimator, GP, next candidate; one part a step. */
#include <string.h>

#include "kc_app_priv.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_vec.h"

#define PREDICT_ITER_MAX 8u   /* enough for a good guess of the joints at a candidate */
#define OWN_MIN 3u            /* poses beside the first looks, which alone say little about the rest */
#define FIRST_TRIED_MIN 6u    /* first looks, small turns all, one of which has to show a tag */
#define STRAY_NOISE_SCALE 3.5 /* first looks with more residual than this are those of another arm ... */
#define STRAY_DOF_MIN 12u     /* ... once two of them are not needed to explain the others */
#define STRAY_OUTLIERS_MIN 3u /* and so many of them that do not fit the others are no bad detections */
#define GOOD_NOISE_SCALE 2.0  /* a first fit with more residual than this is tried from a second start */

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
        app->cal.usable[c] = (uint8_t)!kc_space_first(s, c); /* first looks only by their turn */
    }
}

/* First looks from here on; spare ones are not counted if only_due. */
static uint32_t looks_left(const kc_app_t *app, int only_due)
{
    const kc_space_t *s = &app->tables.active.space;
    uint32_t n = 0u;
    for (uint32_t i = app->cal.i_prior; i < s->n_prior; i++) {
        n += kc_space_first(s, s->prior[i]) && !(only_due && kc_space_spare(s, s->prior[i])) ? 1u : 0u;
    }
    return n;
}

/* First looks come on top: those that were measured, under way (0, 1) and to come; a spare one counts when it
 * is taken. */
static uint32_t goal_of(const kc_app_t *app, uint32_t under_way)
{
    uint32_t n = app->cal.n_own + app->cal.n_first + under_way + looks_left(app, 1);
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
    c->n_own = kc_space_n_first(&a->space) > 0u && n_goal < OWN_MIN ? OWN_MIN : n_goal;
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

/* ---- f of eq. 6 ---- */

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

/* All y with the latest correction; the last one is the newest pose. */
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
        if (app->est.outlier[i] && !app->cal.outlier_told[i]) {
            kc_event(&out->events, KC_EVT_CAL_OUTLIER, (int32_t)i, 0.0, 0.0);
        }
        app->cal.outlier_told[i] = app->est.outlier[i];
    }
}

/* While the data do not determine everything yet, an estimate can fit what was measured and be far off
 * elsewhere. It is used to aim once it has told a pose it did not know twice as well as the correction in
 * use; a little better can be chance. */
static int told_better(kc_app_t *app, uint32_t newest)
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
    app->est.hold_none = (uint8_t)(c->n_meas == c->n_first); /* looks about one place leave much open */
    objective(app);
    c->res_pos_m = app->dp_m[last];
    c->res_rot_rad = app->dr_rad[last];
    c->f = app->y[last];
    c->trusted = (uint8_t)told_better(app, last);
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

/* Errors of the size of the paper's can lead a first fit astray, and then good looks seem to be outliers. When
 * it is not good, the solution so far is the second start; fewer outliers win, then the lower cost. Only where
 * nothing is held: what is held is held at the active table's value, not at a guess. */
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

/* Everything in the TERMS table is asked for: what is left is not what somebody chose to leave. */
static int all_asked(const kc_est_t *e)
{
    for (uint32_t c = 0u; c < e->terms->n_coef; c++) {
        if (e->terms->coef[c].enabled != 0u && (e->opt.free_mask >> c & 1u) == 0u) { return 0; }
    }
    return 1;
}

/* First looks that are all a little off, or several that do not fit the others. What a model lacks is nearly
 * the same about one place, so it is not that. */
static int another_arm(const kc_app_t *app)
{
    const kc_config_t *c = &app->tables.active.config;
    const kc_est_t *e = &app->est;
    int limited = c->stray_pos_m > 0.0 || c->stray_rot_rad > 0.0;
    int noisy = e->dof >= STRAY_DOF_MIN && e->noise_scale > STRAY_NOISE_SCALE;
    return limited && e->hold_none && all_asked(e) && (noisy || e->n_outliers >= STRAY_OUTLIERS_MIN);
}

/* Looks that no correction within its bounds explains: the arm is not one that the ground proved motions
 * for, and goes nowhere. One look far off is enough while all were taken about one place; later one can be a
 * bad detection. */
static int stray(kc_app_t *app, kc_out_t *out)
{
    const kc_config_t *c = &app->tables.active.config;
    if (app->est.rank < app->est.n_free && !app->est.hold_none) { return 0; } /* something is held */
    int another = another_arm(app);
    double pos_m = 0.0, rot_rad = 0.0, last_pos_m = 0.0, last_rot_rad = 0.0;
    uint32_t n = 0u, last = 0u;
    for (uint32_t i = 0u; i < app->cal.n_meas; i++) {
        residual_of(app, app->est.coef, i, &pos_m, &rot_rad);
        int off = (c->stray_pos_m > 0.0 && pos_m > c->stray_pos_m) ||
                  (c->stray_rot_rad > 0.0 && rot_rad > c->stray_rot_rad);
        if (!off && !(another && i + 1u == app->cal.n_meas)) { continue; }
        n++;
        last = i;
        last_pos_m = pos_m;
        last_rot_rad = rot_rad;
    }
    if (n == 0u || (n == 1u && app->cal.n_meas > app->cal.n_first)) { return 0; }
    kc_event(&out->events, KC_EVT_CAL_STRAY, (int32_t)last, last_pos_m, last_rot_rad);
    kc_app_abort(app, out, KC_CAUSE_STRAY);
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
    } else if (stray(app, out)) {
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

/* RMS of the predicted pose sigma over the search space, at most KC_PRED_MAX candidates of it, with the
 * stated noise scaled up to what the residuals show. */
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
    p->pose = c->n_meas - 1u;
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

/* First looks alone are never enough. */
static int enough(const kc_cal_t *c) { return c->n_meas - c->n_first >= (c->n_first > 0u ? OWN_MIN : 1u); }

/* A requirement of 0 is no requirement. Nothing is certain while the data leave something open. */
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
    kc_event(&out->events, KC_EVT_CAL_POSE, (int32_t)c->n_meas - 1, c->res_pos_m, c->res_rot_rad);
    if (certain(app)) {
        kc_event(&out->events, KC_EVT_CAL_CONVERGED, -1, c->pred_pos_m, app->tables.active.config.stop_pos_m);
        c->stop = 1u;
    }
    c->up = KC_UP_SELECT;
}

/* ---- next candidate ---- */

/* Spare first looks serve an arm that shows few tags; the last ones also one of which something is left open. */
static int skip_spare(const kc_app_t *app)
{
    int open = app->est.rank < app->est.n_free && looks_left(app, 1) == 0u;
    return 2u * app->cal.n_first >= app->cal.n_tried && !open;
}

/* Prior poses in their order, without those that turned out unusable. */
static int next_prior(kc_app_t *app, uint32_t *cand)
{
    const kc_space_t *s = &app->tables.active.space;
    while (app->cal.i_prior < s->n_prior) {
        *cand = s->prior[app->cal.i_prior++];
        if (kc_space_first(s, *cand)) {
            if (kc_space_spare(s, *cand) && skip_spare(app)) { continue; }
            app->cal.n_tried++;
            return 1;
        }
        if (app->cal.usable[*cand]) { return 1; }
    }
    return 0;
}

/* The first measured poses again (not the first looks), one after every replicate_every poses. */
static int next_replicate(kc_app_t *app, uint32_t *cand)
{
    kc_cal_t *c = &app->cal;
    uint32_t every = app->tables.active.config.replicate_every, n = c->n_meas - c->n_first;
    if (every == 0u || n == 0u || n % every != 0u || c->rep_at == n) { return 0; }
    c->rep_at = n;
    *cand = c->cand_of[c->n_first + c->n_rep++];
    return 1;
}

static int32_t times_measured(const kc_cal_t *c, uint32_t cand)
{
    int32_t n = 0;
    for (uint32_t i = 0u; i < c->n_meas; i++) { n += c->cand_of[i] == cand; }
    return n;
}

/* Where the joints will be at each candidate once the servo is done there: with large errors far from the
 * seeds, and what a pose tells depends on the joints (tests/bench/samples.py --space). */
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

/* The acquisition asked for; random where it cannot be evaluated (GP lost, nothing solved yet). */
static kc_status_t acquire(kc_app_t *app, uint32_t *cand)
{
    const kc_active_t *a = &app->tables.active;
    kc_cal_t *c = &app->cal;
    kc_status_t st = KC_ERR_ARG;
    if (c->acq == KC_ACQ_UCB && c->gp_ok) {
        double beta = kc_acq_beta(a->space.n_cand, c->n_meas + 1u, a->config.beta_scale);
        st = kc_acq_ucb(&app->big.gp, c->usable, beta, cand, &c->acq_value);
    } else if ((c->acq == KC_ACQ_DOPT || c->acq == KC_ACQ_VOPT) && c->n_meas > 0u && solved(c->est_status)) {
        const double *cov = app->est.obs[c->n_meas - 1u].cov; /* the next one will be about as good */
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
    if (next_prior(app, cand) || next_replicate(app, cand)) { return KC_OK; }
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

/* The first looks see too little to tell what is wrong with the arm: an arm that shows nothing after small turns
 * is not turned any further, nor does one leave that showed hardly anything. */
static int unseen(kc_app_t *app, kc_out_t *out)
{
    const kc_cal_t *c = &app->cal;
    int nothing = c->n_first == 0u && c->n_tried >= FIRST_TRIED_MIN;
    int little = 3u * c->n_first < c->n_tried && looks_left(app, 0) == 0u;
    if (!nothing && !little) { return 0; }
    kc_event(&out->events, KC_EVT_CAL_NOT_SEEN, -1, (double)c->n_first, (double)c->n_tried);
    kc_app_abort(app, out, KC_CAUSE_NOT_SEEN);
    return 1;
}

static int select(kc_app_t *app, kc_out_t *out)
{
    kc_cal_t *c = &app->cal;
    uint32_t cand = 0u;
    if (unseen(app, out)) { return 0; }
    if (c->stop || c->n_meas >= goal_of(app, 0u)) { return finish(app, out, KC_CAUSE_NO_CANDIDATE); }
    if (choose(app, &cand) != KC_OK) {
        kc_event(&out->events, KC_EVT_CAL_NO_CANDIDATE, -1, 0.0, 0.0);
        return finish(app, out, KC_CAUSE_NO_CANDIDATE);
    }
    c->n_goal = goal_of(app, kc_space_first(&app->tables.active.space, cand) ? 1u : 0u);
    c->candidate = (int32_t)cand;
    c->replicate = times_measured(c, cand);
    c->servo_steps = 0u;
    kc_status_t st = kc_move_begin(app, out, cand);
    if (st == KC_ERR_STATE) {
        kc_app_abort(app, out, KC_CAUSE_NO_PATH);
    } else if (st != KC_OK) {
        kc_look_skip(app, out); /* another one next step */
    }
    return 0;
}

/* What was used since the step before, by what moves now. */
static void count_energy(kc_app_t *app)
{
    const kc_config_t *c = &app->tables.active.config;
    double power_w = app->arm.moving || app->head.moving ? c->power_move_w : c->power_idle_w;
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
        app->look.waiting = 0u;
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
