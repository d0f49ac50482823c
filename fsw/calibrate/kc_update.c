#include "kc_update.h"

#include <string.h>

#include "kc_chi2.h"
#include "kc_libm.h"
#include "kc_local.h"
#include "kc_move.h"
#include "kc_observation.h"
#include "kc_suspicion.h"
#include "kc_vec.h"

/* ---- start ---- */

static void take_candidates(kc_arena_calibration_t *work, const kc_space_t *space)
{
    for (uint32_t c = 0u; c < space->n_cand; c++) {
        kc_pose_t T;
        kc_move_goal(space, c, &T);
        kc_v3_copy(T.p_m, work->cand_pt[c].p_m);
        kc_R_to_quat(T.R, work->cand_pt[c].q_wxyz);
        memcpy(&work->cand_q[c * KC_JOINT_MAX], space->cand[c].q_seed, sizeof space->cand[c].q_seed);
    }
}

void kc_update_start(kc_latest_t *latest, kc_est_t *est, kc_arena_calibration_t *work, const kc_view_t *view,
                     uint64_t free_mask)
{
    const kc_active_t *a = view->tables;
    memset(latest, 0, sizeof *latest);
    memcpy(latest->coef, a->kin.value, sizeof latest->coef);
    take_candidates(work, &a->space);
    est->arm = &a->arm;
    est->terms = &a->terms;
    est->camera = &a->camera;
    est->opt = a->config.est;
    est->opt.free_mask = free_mask;
    est->hold_none = 0u;
    est->by_bounds = a->config.initial_design == (uint8_t)KC_INITIAL_INFORMATION ? 1u : 0u;
    est->by_prior = 0u;
    est->without = 0u;
    est->n_obs = 0u;
    est->rank = est->n_free = 0u; /* an ABORT may have left an estimate half done */
    latest->gp_ok = kc_gp_init(&work->gp, &a->kernel, 0u, work->cand_pt, a->space.n_cand) == KC_OK;
}

uint64_t kc_update_start_cost(const kc_view_t *view)
{
    return 100000u + view->tables->space.n_cand * (500u + kc_kernel_cost(&view->tables->kernel));
}

/* ---- objective f (eq. 6) ---- */

static kc_residual_t residual_of(const kc_view_t *view, const kc_fixed_t *fixed, uint32_t i)
{
    double r[6];
    kc_observation_residual(fixed, &view->est->obs[i], r, NULL);
    return (kc_residual_t){kc_v3_norm(r), kc_v3_norm(&r[3])};
}

/* Residuals of all observations at coef into dp_m, dr_rad. False: goes on in the next step. */
static bool residuals(kc_update_t *cursor, kc_latest_t *latest, const kc_view_t *view, const double *coef,
                      kc_work_t *work)
{
    const uint64_t cost = kc_model_cost(&view->tables->arm, &view->tables->terms, coef, false);
    kc_fixed_t fixed;
    fixed.arm = NULL; /* it is made once there is work for it */
    for (; cursor->i < view->plan->n_obs; cursor->i++) {
        if (!kc_work_take(work, cost)) { return false; }
        if (fixed.arm == NULL) { kc_model_fix(&view->tables->arm, &view->tables->terms, coef, &fixed); }
        kc_residual_t residual = residual_of(view, &fixed, cursor->i);
        latest->dp_m[cursor->i] = residual.pos_m;
        latest->dr_rad[cursor->i] = residual.rot_rad;
    }
    return true;
}

/* Objective of all poses from their residuals with the latest correction; observations on the way to them are not in
 * it. */
static void objective(kc_latest_t *latest, const kc_view_t *view)
{
    const kc_config_t *c = &view->tables->config;
    const kc_plan_t *p = view->plan;
    double dp_m[KC_MEAS_MAX], dr_rad[KC_MEAS_MAX];
    for (uint32_t k = 0u; k < p->n_meas; k++) {
        dp_m[k] = latest->dp_m[p->obs_of[k]];
        dr_rad[k] = latest->dr_rad[p->obs_of[k]];
    }
    kc_acq_objective(dp_m, dr_rad, p->n_meas, c->a1, c->sp_floor_m, c->sq_floor_rad, latest->y);
}

/* Observation of the newest pose. */
static uint32_t newest_obs(const kc_view_t *view) { return view->plan->obs_of[view->plan->n_meas - 1u]; }

static kc_point_t newest_point(const kc_view_t *view)
{
    const kc_obs_t *obs = &view->est->obs[newest_obs(view)];
    kc_point_t x;
    kc_v3_copy(obs->p_m, x.p_m);
    memcpy(x.q_wxyz, obs->q_wxyz, sizeof x.q_wxyz);
    return x;
}

/* ---- parts of a state ---- */

void kc_update_begin(kc_update_t *cursor)
{
    cursor->part = 0u;
    cursor->i = 0u;
    cursor->sum2 = (kc_residual_t){0.0, 0.0};
}

static void next_part(kc_update_t *cursor)
{
    cursor->part++;
    cursor->i = 0u;
}

static uint64_t gp_cost(const kc_latest_t *latest, const kc_gp_t *gp)
{
    return latest->gp_ok ? kc_gp_cost(gp) : 0u;
}

/* ---- UPDATE, REFINE ---- */

static void solve_from(kc_est_t *est, const double *start)
{
    memcpy(est->start, start, sizeof est->start);
    kc_est_begin(est);
}

static bool solved(kc_latest_t *latest, kc_est_t *est, kc_work_t *work)
{
    if (!kc_est_step(est, work)) { return false; }
    latest->status = est->job.status;
    return true;
}

static bool predicts_better(const kc_latest_t *latest, const kc_view_t *view, uint32_t newest)
{
    kc_fixed_t fixed;
    if (newest == 0u || !kc_fit_solved(latest->status)) { return false; }
    kc_model_fix(&view->tables->arm, &view->tables->terms, view->est->coef, &fixed);
    return kc_fit_predicts_better(&view->tables->config, residual_of(view, &fixed, newest), latest->res);
}

/* What the newest pose says of the estimate before it; a new one begins. */
static void begin_estimate(kc_latest_t *latest, kc_est_t *est, const kc_gp_t *gp, const kc_view_t *view)
{
    const kc_plan_t *p = view->plan;
    uint32_t newest = newest_obs(view);
    kc_point_t x = newest_point(view);
    double var = 0.0;
    /* observations near one posture leave much undetermined */
    bool few = kc_plan_only_local(p) || (p->by_information && !kc_plan_enough(p));
    est->hold_none = few || est->by_prior != 0u ? 1u : 0u;
    est->by_bounds = p->by_information ? 1u : 0u;
    objective(latest, view);
    latest->res = (kc_residual_t){latest->dp_m[newest], latest->dr_rad[newest]};
    latest->f = latest->y[p->n_meas - 1u];
    latest->trusted = predicts_better(latest, view, newest);
    bool checked = kc_fit_required(&view->tables->config) &&
                   kc_fit_checked(&view->tables->config, latest->res, view->est->obs[newest].cov);
    latest->n_checked = checked ? latest->n_checked + 1u : 0u;
    latest->gp_mean = 0.0;
    if (latest->gp_ok) { kc_gp_predict(gp, &x, &latest->gp_mean, &var); }
    latest->gp_sigma = kc_sqrt(kc_max(var, 0.0));
    solve_from(est, view->tables->kin.value);
}

kc_outcome_t kc_update_solve(kc_update_t *cursor, kc_latest_t *latest, kc_est_t *est, const kc_gp_t *gp,
                             const kc_view_t *view, kc_work_t *work)
{
    if (cursor->part == 0u) {
        if (!residuals(cursor, latest, view, latest->coef, work) ||
            !kc_work_take(work, gp_cost(latest, gp))) {
            return kc_outcome(KC_OC_STAY);
        }
        begin_estimate(latest, est, gp, view);
        next_part(cursor);
    }
    return kc_outcome(solved(latest, est, work) ? KC_OC_DONE : KC_OC_STAY);
}

static bool differ(const double *a, const double *b)
{
    bool any = false;
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) { any = any || a[c] < b[c] || a[c] > b[c]; }
    return any;
}

/* Parts: is it needed; the second start; the first one again if that was better. */
kc_outcome_t kc_update_refine(kc_update_t *cursor, kc_latest_t *latest, kc_est_t *est, const kc_view_t *view,
                              kc_work_t *work)
{
    const double *start = view->tables->kin.value;
    if (cursor->part == 0u) {
        cursor->first = kc_fit_quality(est, latest->status);
        if (!kc_fit_needs_second_start(&view->tables->config, &cursor->first) ||
            !differ(latest->coef, start)) {
            return kc_outcome(KC_OC_DONE);
        }
        solve_from(est, latest->coef);
        next_part(cursor);
    }
    if (!solved(latest, est, work)) { return kc_outcome(KC_OC_STAY); }
    if (cursor->part == 1u) {
        kc_fit_quality_t second = kc_fit_quality(est, latest->status);
        if (kc_fit_second_is_better(&cursor->first, &second)) { return kc_outcome(KC_OC_DONE); }
        solve_from(est, start);
        next_part(cursor);
    }
    return kc_outcome(solved(latest, est, work) ? KC_OC_DONE : KC_OC_STAY);
}

/* ---- LEARN ---- */

static kc_event_id_t outlier_event(bool outlier, bool extra)
{
    if (extra) { return outlier ? KC_EVT_CAL_EXTRA_OUTLIER : KC_EVT_CAL_EXTRA_OUTLIER_ACCEPTED; }
    return outlier ? KC_EVT_CAL_OUTLIER : KC_EVT_CAL_OUTLIER_ACCEPTED;
}

static void report_outliers(kc_latest_t *latest, const kc_view_t *view, kc_out_t *out)
{
    const uint8_t *outlier = view->est->outlier;
    const kc_plan_t *p = view->plan;
    for (uint32_t i = 0u; i < p->n_obs; i++) {
        bool extra = p->taken_at[i] != (uint8_t)KC_AT_CANDIDATE;
        if (!outlier[i] != !latest->outlier_reported[i]) {
            kc_event(&out->events, outlier_event(outlier[i] != 0u, extra), (int32_t)p->pose_of[i],
                     extra ? (double)i + 1.0 : 0.0, 0.0);
        }
        latest->outlier_reported[i] = outlier[i];
    }
}

/* By the residuals at the new estimate; *worst: the newest observation that is a mismatch. */
static bool mismatch(const kc_latest_t *latest, const kc_view_t *view, uint32_t *worst)
{
    kc_residual_t residual[KC_MEAS_MAX];
    for (uint32_t i = 0u; i < view->plan->n_obs; i++) {
        residual[i] = (kc_residual_t){latest->dp_m[i], latest->dr_rad[i]};
    }
    return kc_fit_mismatch(&view->tables->config, view->est, residual, view->plan, worst);
}

/* Whether the estimate is that of the arm that was verified. Among local initial poses, one bad detection is
 * searched for first; its pose is the next to be measured. */
static kc_outcome_t evaluate(kc_latest_t *latest, kc_est_t *est, kc_plan_t *plan, const kc_view_t *view,
                             kc_out_t *out)
{
    uint32_t worst = 0u, without = est->without;
    bool is_solved = kc_fit_solved(latest->status);
    bool fits = !is_solved || !mismatch(latest, view, &worst);
    kc_leave_out_answer_t answer = fits ? KC_LEAVE_OUT_DONE : KC_LEAVE_OUT_NONE;
    if (kc_plan_only_local(plan)) {
        double cost = is_solved ? est->cost : KC_INF;
        answer = kc_leave_out_next(&latest->leave_out, &view->tables->config, plan, est->obs, fits, cost,
                                   &est->without);
    }
    if (answer == KC_LEAVE_OUT_AGAIN) { return kc_outcome(KC_OC_AGAIN); }
    report_outliers(latest, view, out);
    if (answer == KC_LEAVE_OUT_NONE) {
        if (fits) { worst = without - 1u; } /* the rest agrees, but that one was seen twice alike */
        kc_event(&out->events, KC_EVT_CAL_MODEL_MISMATCH, (int32_t)plan->pose_of[worst], latest->dp_m[worst],
                 latest->dr_rad[worst]);
        return kc_abort_for(KC_CAUSE_MODEL_MISMATCH);
    }
    if (without > 0u && kc_plan_only_local(plan)) { kc_plan_again(plan, without - 1u); }
    return kc_outcome(KC_OC_DONE);
}

static void grow_gp(kc_latest_t *latest, kc_arena_calibration_t *work, const kc_view_t *view)
{
    kc_point_t x = newest_point(view);
    if (!latest->gp_ok) { return; }
    latest->gp_ok = kc_gp_add(&work->gp, &x, latest->y[view->plan->n_meas - 1u], work->cand_pt) == KC_OK;
    if (!latest->gp_ok) { return; }
    kc_gp_set_y(&work->gp, latest->y);
    kc_gp_choose_begin(&work->gp);
}

enum { EVALUATE = 0, OBJECTIVE, CHOOSE };

static kc_outcome_t learn_evaluate(kc_update_t *cursor, kc_latest_t *latest, kc_est_t *est, kc_plan_t *plan,
                                   const kc_view_t *view, kc_work_t *work, kc_out_t *out)
{
    bool is_solved = kc_fit_solved(latest->status);
    if (is_solved && !residuals(cursor, latest, view, est->coef, work)) { return kc_outcome(KC_OC_STAY); }
    kc_work_spend(work, est->by_prior != 0u ? KC_LOCAL_DOUBT_COST : 0u);
    if (kc_suspicion_fails(est, view, out)) {
        latest->n_checked = 0u;
        return kc_outcome(KC_OC_AGAIN);
    }
    kc_outcome_t evaluated = evaluate(latest, est, plan, view, out);
    if (evaluated.id != KC_OC_DONE) { return evaluated; }
    if (!is_solved) {
        kc_event(&out->events, KC_EVT_CAL_EST, -1, (double)latest->status, 0.0);
    } else if (est->rank == est->n_free || est->hold_none || latest->trusted) {
        memcpy(latest->coef, est->coef, sizeof latest->coef);
    }
    next_part(cursor);
    return kc_outcome(KC_OC_DONE);
}

static kc_outcome_t learn_objective(kc_update_t *cursor, kc_latest_t *latest, kc_arena_calibration_t *arena,
                                    const kc_view_t *view, kc_work_t *work)
{
    if (!residuals(cursor, latest, view, latest->coef, work) ||
        !kc_work_take(work, gp_cost(latest, &arena->gp))) {
        return kc_outcome(KC_OC_STAY);
    }
    objective(latest, view);
    grow_gp(latest, arena, view);
    next_part(cursor);
    return kc_outcome(KC_OC_DONE);
}

kc_outcome_t kc_update_learn(kc_update_t *cursor, kc_latest_t *latest, kc_est_t *est, kc_plan_t *plan,
                             kc_arena_calibration_t *arena, const kc_view_t *view, kc_work_t *work,
                             kc_out_t *out)
{
    kc_outcome_t oc = kc_outcome(KC_OC_DONE);
    if (cursor->part == EVALUATE) { oc = learn_evaluate(cursor, latest, est, plan, view, work, out); }
    if (oc.id == KC_OC_DONE && cursor->part == OBJECTIVE) {
        oc = learn_objective(cursor, latest, arena, view, work);
    }
    if (oc.id != KC_OC_DONE || !latest->gp_ok || !view->tables->kernel.choose) { return oc; }
    return kc_outcome(kc_gp_choose_step(&arena->gp, arena->cand_pt, work) ? KC_OC_DONE : KC_OC_STAY);
}

/* ---- REPORT ---- */

/* RMS of the predicted pose sigma over the search space, from at most KC_SPACE_SAMPLES candidates; the stated
 * noise is scaled up to what the residuals show. False: goes on in the next step. */
static bool predict(kc_update_t *cursor, kc_latest_t *latest, const kc_view_t *view, kc_work_t *work)
{
    const uint64_t cost = kc_est_pose_cov_cost(view->est);
    uint32_t n = view->tables->space.n_cand, stride = kc_view_stride(view);
    double cov[36];
    kc_fixed_t fixed;
    fixed.arm = NULL; /* it is made once there is work for it */
    for (; cursor->i < n; cursor->i += stride) {
        kc_ctx_t ctx;
        kc_eval_t eval;
        if (!kc_work_take(work, cost)) { return false; }
        if (fixed.arm == NULL) { kc_model_fix(view->est->arm, view->est->terms, view->est->coef, &fixed); }
        kc_view_ctx(view, cursor->i, &ctx);
        kc_est_pose_cov(view->est, &fixed, &ctx, &eval, cov);
        cursor->sum2.pos_m += cov[0] + cov[7] + cov[14];
        cursor->sum2.rot_rad += cov[21] + cov[28] + cov[35];
    }
    uint32_t count = cursor->i / stride;
    double scale = kc_max(1.0, view->est->noise_scale);
    latest->pred = (kc_residual_t){scale * kc_sqrt(cursor->sum2.pos_m / (double)count),
                                   scale * kc_sqrt(cursor->sum2.rot_rad / (double)count)};
    return true;
}

static void fill_progress(const kc_view_t *view, kc_progress_t *progress)
{
    const kc_latest_t *l = view->latest;
    const kc_est_t *e = view->est;
    progress->session = view->cal->session;
    progress->pose = view->plan->n_meas;
    progress->n_goal = view->plan->n_goal;
    progress->candidate = view->cal->candidate;
    progress->replicate = view->cal->replicate;
    progress->servo_steps = *view->servo_steps;
    progress->acquisition = view->cal->chosen_by;
    progress->acquisition_value = view->cal->acq_value;
    progress->res_pos_m = l->res.pos_m;
    progress->res_rot_rad = l->res.rot_rad;
    progress->f = l->f;
    progress->gp_mean = l->gp_mean;
    progress->gp_sigma = l->gp_sigma;
    progress->pred_pos_m = l->pred.pos_m;
    progress->pred_rot_rad = l->pred.rot_rad;
    progress->rank = e->rank;
    progress->n_free = e->n_free;
    progress->dof = e->dof;
    progress->chi2 = e->chi2;
    progress->est_status = (int32_t)l->status;
    progress->fit_pos_m = e->fit_pos_m;
    progress->fit_rot_rad = e->fit_rot_rad;
    progress->energy_j = view->cal->energy_j;
    memcpy(progress->coef, l->coef, sizeof progress->coef);
}

/* ---- whether more poses are needed ---- */

static bool determined(const kc_view_t *view)
{
    return kc_fit_required(&view->tables->config) && kc_plan_enough(view->plan) &&
           kc_fit_determined(view->est, view->latest->status);
}

/* The one look at the table in force before the end: at the first pose after which the noise does not hide an error as
 * large as required. When that is, follows from the poses and not from what they say; what the camera chain hides, more
 * poses do not show either. */
static void test_early(kc_latest_t *latest, const kc_evaluated_t *evaluated,
                       const kc_evaluation_t *evaluation, const kc_view_t *view, kc_out_t *out)
{
    const kc_config_t *c = &view->tables->config;
    const double level = kc_verdict_level(c, true);
    if (c->no_change_power <= 0.0 || latest->tested_early) { return; }
    if (kc_evaluation_power(evaluated, evaluation, view, level, false) < c->no_change_power) { return; }
    latest->tested_early = true;
    bool agrees = kc_verdict(c, view->est, latest->status, &evaluated->fit, true) == KC_VERDICT_NO_CHANGE;
    if (agrees) { latest->ended = KC_ENDED_NO_CHANGE; }
    kc_event(&out->events, agrees ? KC_EVT_CAL_AGREES : KC_EVT_CAL_DISAGREES, (int32_t)view->plan->n_meas,
             evaluated->fit.p_no_change,
             agrees ? kc_evaluation_power(evaluated, evaluation, view, level, true) : level);
}

/* Whether the table in force is known to be wrong, or an error would have shown: before that a calibration that is good
 * enough goes on, so that it does not call an arm right that a longer one would call wrong. */
static bool settled(const kc_latest_t *latest, const kc_evaluated_t *evaluated, const kc_config_t *c)
{
    return c->no_change_power <= 0.0 || latest->tested_early ||
           evaluated->fit.p_no_change <= kc_verdict_level(c, true);
}

static void decide(kc_latest_t *latest, const kc_evaluated_t *evaluated, const kc_evaluation_t *evaluation,
                   const kc_view_t *view, kc_out_t *out)
{
    const kc_config_t *c = &view->tables->config;
    const kc_verdict_t verdict = kc_verdict(c, view->est, latest->status, &evaluated->fit, true);
    test_early(latest, evaluated, evaluation, view, out);
    if (verdict != KC_VERDICT_POOR && latest->n_checked >= c->stop_checks &&
        kc_fit_meets(c, evaluated->bound) && settled(latest, evaluated, c)) {
        latest->tested_early = c->no_change_power > 0.0;
        kc_event(&out->events, KC_EVT_CAL_CONVERGED, -1, evaluated->bound.pos_m, c->stop_pos_m);
        latest->ended = KC_ENDED_REQUIREMENT;
    }
}

enum { PREDICT = 0, BEGIN_EVALUATION, RUN_EVALUATION };

/* False: goes on in the next step. */
static bool evaluate_error(kc_update_t *cursor, kc_evaluated_t *evaluated, kc_evaluation_t *evaluation,
                           const kc_view_t *view, kc_work_t *work)
{
    if (cursor->part == BEGIN_EVALUATION) {
        kc_evaluation_begin(evaluated, evaluation, view);
        next_part(cursor);
    }
    return kc_evaluation_run(evaluated, evaluation, view, work) &&
           kc_work_take(work, 2u * KC_CHI2_NONCENTRAL_COST);
}

kc_outcome_t kc_update_report(kc_update_t *cursor, kc_latest_t *latest, kc_evaluated_t *evaluated,
                              kc_evaluation_t *evaluation, const kc_view_t *view, kc_work_t *work,
                              kc_out_t *out)
{
    const bool is_solved = kc_fit_solved(latest->status);
    if (cursor->part == PREDICT) {
        if (is_solved && !predict(cursor, latest, view, work)) { return kc_outcome(KC_OC_STAY); }
        next_part(cursor);
    }
    if (determined(view)) {
        if (!evaluate_error(cursor, evaluated, evaluation, view, work)) { return kc_outcome(KC_OC_STAY); }
        decide(latest, evaluated, evaluation, view, out);
    }
    out->has_progress = 1u;
    fill_progress(view, &out->progress);
    kc_event(&out->events, KC_EVT_CAL_POSE, (int32_t)view->plan->n_meas, latest->res.pos_m,
             latest->res.rot_rad);
    return kc_outcome(KC_OC_DONE);
}
