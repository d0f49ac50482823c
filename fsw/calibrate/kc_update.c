#include "kc_update.h"

#include <string.h>

#include "kc_libm.h"
#include "kc_move.h"
#include "kc_observation.h"
#include "kc_vec.h"

/* ---- start ---- */

static void take_candidates(kc_arena_calibration_t *work, const kc_space_t *s)
{
    for (uint32_t c = 0u; c < s->n_cand; c++) {
        kc_pose_t T;
        kc_move_goal(s, c, &T);
        kc_v3_copy(T.p_m, work->cand_pt[c].p_m);
        kc_R_to_quat(T.R, work->cand_pt[c].q_wxyz);
        memcpy(&work->cand_q[c * KC_JOINT_MAX], s->cand[c].q_seed, sizeof s->cand[c].q_seed);
    }
}

void kc_update_start(kc_learned_t *l, kc_est_t *est, kc_arena_calibration_t *work, const kc_view_t *v,
                     uint64_t free_mask)
{
    const kc_active_t *a = v->tables;
    memset(l, 0, sizeof *l);
    memcpy(l->coef, a->kin.value, sizeof l->coef);
    take_candidates(work, &a->space);
    est->arm = &a->arm;
    est->terms = &a->terms;
    est->opt = a->config.est;
    est->opt.free_mask = free_mask;
    est->hold_none = 0u;
    est->without = 0u;
    est->n_obs = 0u;
    est->rank = est->n_free = 0u; /* an ABORT may have left an estimate half done */
    l->gp_ok = kc_gp_init(&work->gp, &a->kernel, 0u, work->cand_pt, a->space.n_cand) == KC_OK;
}

uint64_t kc_update_start_cost(const kc_view_t *v)
{
    return 100000u + v->tables->space.n_cand * (500u + kc_kernel_cost(&v->tables->kernel));
}

/* ---- objective f (eq. 6) ---- */

static kc_miss_t miss_of(const kc_view_t *v, const double *coef, uint32_t i)
{
    double r[6];
    kc_observation_residual(v->tables, coef, &v->est->obs[i], r, NULL);
    return (kc_miss_t){kc_v3_norm(r), kc_v3_norm(&r[3])};
}

/* Residuals of all poses at coef into dp_m, dr_rad; the last one is the newest pose. False: goes on in the next
 * step. */
static bool misses(kc_update_t *cursor, kc_learned_t *l, const kc_view_t *v, const double *coef,
                   kc_work_t *work)
{
    const uint64_t cost = kc_model_cost(&v->tables->arm, &v->tables->terms, true);
    for (; cursor->i < v->plan->n_meas; cursor->i++) {
        if (!kc_work_take(work, cost)) { return false; }
        kc_miss_t miss = miss_of(v, coef, cursor->i);
        l->dp_m[cursor->i] = miss.pos_m;
        l->dr_rad[cursor->i] = miss.rot_rad;
    }
    return true;
}

/* Objective of all poses from their residuals with the latest correction. */
static void objective(kc_learned_t *l, const kc_view_t *v)
{
    const kc_config_t *c = &v->tables->config;
    kc_acq_objective(l->dp_m, l->dr_rad, v->plan->n_meas, c->a1, c->sp_floor_m, c->sq_floor_rad, l->y);
}

static kc_point_t newest_point(const kc_view_t *v)
{
    const kc_obs_t *obs = &v->est->obs[v->plan->n_meas - 1u];
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
    cursor->sum2 = (kc_miss_t){0.0, 0.0};
}

static void next_part(kc_update_t *cursor)
{
    cursor->part++;
    cursor->i = 0u;
}

static uint64_t gp_cost(const kc_learned_t *l, const kc_gp_t *gp) { return l->gp_ok ? kc_gp_cost(gp) : 0u; }

/* ---- UPDATE, REFINE ---- */

static void solve_from(kc_est_t *est, const double *start)
{
    memcpy(est->start, start, sizeof est->start);
    kc_est_begin(est);
}

static bool solved(kc_learned_t *l, kc_est_t *est, kc_work_t *work)
{
    if (!kc_est_step(est, work)) { return false; }
    l->status = est->job.status;
    return true;
}

static bool predicts_better(const kc_learned_t *l, const kc_view_t *v, uint32_t newest)
{
    if (newest == 0u || !kc_fit_solved(l->status)) { return false; }
    return kc_fit_predicts_better(&v->tables->config, miss_of(v, v->est->coef, newest), l->res);
}

/* What the newest pose says of the estimate before it; a new one begins. */
static void begin_estimate(kc_learned_t *l, kc_est_t *est, const kc_gp_t *gp, const kc_view_t *v)
{
    const kc_plan_t *p = v->plan;
    uint32_t newest = p->n_meas - 1u;
    kc_point_t x = newest_point(v);
    double var = 0.0;
    /* observations near one posture leave much undetermined */
    est->hold_none = p->n_meas == p->n_local ? 1u : 0u;
    objective(l, v);
    l->res = (kc_miss_t){l->dp_m[newest], l->dr_rad[newest]};
    l->f = l->y[newest];
    l->trusted = predicts_better(l, v, newest);
    l->gp_mean = 0.0;
    if (l->gp_ok) { kc_gp_predict(gp, &x, &l->gp_mean, &var); }
    l->gp_sigma = kc_sqrt(kc_max(var, 0.0));
    solve_from(est, v->tables->kin.value);
}

kc_outcome_t kc_update_solve(kc_update_t *cursor, kc_learned_t *l, kc_est_t *est, const kc_gp_t *gp,
                             const kc_view_t *v, kc_work_t *work)
{
    if (cursor->part == 0u) {
        if (!misses(cursor, l, v, l->coef, work) || !kc_work_take(work, gp_cost(l, gp))) {
            return kc_outcome(KC_OC_STAY);
        }
        begin_estimate(l, est, gp, v);
        next_part(cursor);
    }
    return kc_outcome(solved(l, est, work) ? KC_OC_DONE : KC_OC_STAY);
}

static bool differ(const double *a, const double *b)
{
    bool any = false;
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) { any = any || a[c] < b[c] || a[c] > b[c]; }
    return any;
}

/* Parts: is it needed; the second start; the first one again if that was better. */
kc_outcome_t kc_update_refine(kc_update_t *cursor, kc_learned_t *l, kc_est_t *est, const kc_view_t *v,
                              kc_work_t *work)
{
    const double *start = v->tables->kin.value;
    if (cursor->part == 0u) {
        cursor->first = kc_fit_quality(est, l->status);
        if (!kc_fit_needs_second_start(&v->tables->config, &cursor->first) || !differ(l->coef, start)) {
            return kc_outcome(KC_OC_DONE);
        }
        solve_from(est, l->coef);
        next_part(cursor);
    }
    if (!solved(l, est, work)) { return kc_outcome(KC_OC_STAY); }
    if (cursor->part == 1u) {
        kc_fit_quality_t second = kc_fit_quality(est, l->status);
        if (kc_fit_second_is_better(&cursor->first, &second)) { return kc_outcome(KC_OC_DONE); }
        solve_from(est, start);
        next_part(cursor);
    }
    return kc_outcome(solved(l, est, work) ? KC_OC_DONE : KC_OC_STAY);
}

/* ---- LEARN ---- */

static void report_outliers(kc_learned_t *l, const kc_view_t *v, kc_out_t *out)
{
    const uint8_t *outlier = v->est->outlier;
    for (uint32_t i = 0u; i < v->plan->n_meas; i++) {
        kc_event_id_t id = outlier[i] ? KC_EVT_CAL_OUTLIER : KC_EVT_CAL_OUTLIER_ACCEPTED;
        if (!outlier[i] != !l->outlier_reported[i]) { kc_event(&out->events, id, (int32_t)i + 1, 0.0, 0.0); }
        l->outlier_reported[i] = outlier[i];
    }
}

/* By the residuals at the new estimate; *worst: the newest pose that is a mismatch. */
static bool mismatch(const kc_learned_t *l, const kc_view_t *v, uint32_t *worst)
{
    kc_miss_t miss[KC_MEAS_MAX];
    uint32_t n = v->plan->n_meas;
    for (uint32_t i = 0u; i < n; i++) { miss[i] = (kc_miss_t){l->dp_m[i], l->dr_rad[i]}; }
    return kc_fit_mismatch(&v->tables->config, v->est, miss, n, v->plan->n_local, worst);
}

/* Whether the estimate is that of the arm that was verified. Among local initial poses, one bad detection is
 * searched for first; its pose is the next to be measured. */
static kc_outcome_t evaluate(kc_learned_t *l, kc_est_t *est, kc_plan_t *plan, const kc_view_t *v,
                             kc_out_t *out)
{
    uint32_t worst = 0u, without = est->without;
    bool is_solved = kc_fit_solved(l->status);
    bool fits = !is_solved || !mismatch(l, v, &worst);
    kc_leave_out_answer_t answer = fits ? KC_LEAVE_OUT_DONE : KC_LEAVE_OUT_NONE;
    if (plan->n_meas == plan->n_local) {
        double cost = is_solved ? est->cost : KC_INF;
        answer = kc_leave_out_next(&l->leave_out, &v->tables->config, plan, est->obs, fits, cost,
                                   &est->without);
    }
    if (answer == KC_LEAVE_OUT_AGAIN) { return kc_outcome(KC_OC_AGAIN); }
    report_outliers(l, v, out);
    if (answer == KC_LEAVE_OUT_NONE) {
        kc_event(&out->events, KC_EVT_CAL_MODEL_MISMATCH, (int32_t)worst + 1, l->dp_m[worst],
                 l->dr_rad[worst]);
        return kc_abort_for(KC_CAUSE_MODEL_MISMATCH);
    }
    if (without > 0u && plan->n_meas == plan->n_local) { kc_plan_again(plan, without - 1u); }
    return kc_outcome(KC_OC_DONE);
}

static void grow_gp(kc_learned_t *l, kc_arena_calibration_t *work, const kc_view_t *v)
{
    kc_point_t x = newest_point(v);
    if (!l->gp_ok) { return; }
    l->gp_ok = kc_gp_add(&work->gp, &x, l->y[v->plan->n_meas - 1u], work->cand_pt) == KC_OK;
    if (!l->gp_ok) { return; }
    kc_gp_set_y(&work->gp, l->y);
    kc_gp_choose_begin(&work->gp);
}

enum { EVALUATE = 0, OBJECTIVE, CHOOSE };

static kc_outcome_t learn_evaluate(kc_update_t *cursor, kc_learned_t *l, kc_est_t *est, kc_plan_t *plan,
                                   const kc_view_t *v, kc_work_t *work, kc_out_t *out)
{
    bool is_solved = kc_fit_solved(l->status);
    if (is_solved && !misses(cursor, l, v, est->coef, work)) { return kc_outcome(KC_OC_STAY); }
    kc_outcome_t evaluated = evaluate(l, est, plan, v, out);
    if (evaluated.id != KC_OC_DONE) { return evaluated; }
    if (!is_solved) {
        kc_event(&out->events, KC_EVT_CAL_EST, -1, (double)l->status, 0.0);
    } else if (est->rank == est->n_free || est->hold_none || l->trusted) {
        memcpy(l->coef, est->coef, sizeof l->coef);
    }
    next_part(cursor);
    return kc_outcome(KC_OC_DONE);
}

static kc_outcome_t learn_objective(kc_update_t *cursor, kc_learned_t *l, kc_arena_calibration_t *arena,
                                    const kc_view_t *v, kc_work_t *work)
{
    if (!misses(cursor, l, v, l->coef, work) || !kc_work_take(work, gp_cost(l, &arena->gp))) {
        return kc_outcome(KC_OC_STAY);
    }
    objective(l, v);
    grow_gp(l, arena, v);
    next_part(cursor);
    return kc_outcome(KC_OC_DONE);
}

kc_outcome_t kc_update_learn(kc_update_t *cursor, kc_learned_t *l, kc_est_t *est, kc_plan_t *plan,
                             kc_arena_calibration_t *arena, const kc_view_t *v, kc_work_t *work,
                             kc_out_t *out)
{
    kc_outcome_t oc = kc_outcome(KC_OC_DONE);
    if (cursor->part == EVALUATE) { oc = learn_evaluate(cursor, l, est, plan, v, work, out); }
    if (oc.id == KC_OC_DONE && cursor->part == OBJECTIVE) { oc = learn_objective(cursor, l, arena, v, work); }
    if (oc.id != KC_OC_DONE || !l->gp_ok || !v->tables->kernel.choose) { return oc; }
    return kc_outcome(kc_gp_choose_step(&arena->gp, arena->cand_pt, work) ? KC_OC_DONE : KC_OC_STAY);
}

/* ---- REPORT ---- */

/* RMS of the predicted pose sigma over the search space, from at most KC_SPACE_SAMPLES candidates; the stated
 * noise is scaled up to what the residuals show. False: goes on in the next step. */
static bool predict(kc_update_t *cursor, kc_learned_t *l, const kc_view_t *v, kc_work_t *work)
{
    const uint64_t cost = kc_est_pose_cov_cost(v->est);
    uint32_t n = v->tables->space.n_cand, stride = kc_view_stride(v);
    double cov[36];
    for (; cursor->i < n; cursor->i += stride) {
        kc_ctx_t ctx;
        kc_eval_t eval;
        if (!kc_work_take(work, cost)) { return false; }
        kc_view_ctx(v, cursor->i, &ctx);
        kc_est_pose_cov(v->est, &ctx, &eval, cov);
        cursor->sum2.pos_m += cov[0] + cov[7] + cov[14];
        cursor->sum2.rot_rad += cov[21] + cov[28] + cov[35];
    }
    uint32_t count = cursor->i / stride;
    double scale = kc_max(1.0, v->est->noise_scale);
    l->pred = (kc_miss_t){scale * kc_sqrt(cursor->sum2.pos_m / (double)count),
                          scale * kc_sqrt(cursor->sum2.rot_rad / (double)count)};
    return true;
}

static void fill_progress(const kc_view_t *v, kc_progress_t *p)
{
    const kc_learned_t *l = v->learned;
    const kc_est_t *e = v->est;
    p->session = v->cal->session;
    p->pose = v->plan->n_meas;
    p->n_goal = v->plan->n_goal;
    p->candidate = v->cal->candidate;
    p->replicate = v->cal->replicate;
    p->servo_steps = *v->servo_steps;
    p->acquisition = v->cal->chosen_by;
    p->acquisition_value = v->cal->acq_value;
    p->res_pos_m = l->res.pos_m;
    p->res_rot_rad = l->res.rot_rad;
    p->f = l->f;
    p->gp_mean = l->gp_mean;
    p->gp_sigma = l->gp_sigma;
    p->pred_pos_m = l->pred.pos_m;
    p->pred_rot_rad = l->pred.rot_rad;
    p->rank = e->rank;
    p->n_free = e->n_free;
    p->dof = e->dof;
    p->chi2 = e->chi2;
    p->est_status = (int32_t)l->status;
    p->fit_pos_m = e->fit_pos_m;
    p->fit_rot_rad = e->fit_rot_rad;
    p->energy_j = v->cal->energy_j;
    memcpy(p->coef, l->coef, sizeof p->coef);
}

kc_outcome_t kc_update_report(kc_update_t *cursor, kc_learned_t *l, const kc_view_t *v, kc_work_t *work,
                              kc_out_t *out)
{
    const kc_config_t *c = &v->tables->config;
    if (kc_fit_solved(l->status) && !predict(cursor, l, v, work)) { return kc_outcome(KC_OC_STAY); }
    out->has_progress = 1u;
    fill_progress(v, &out->progress);
    kc_event(&out->events, KC_EVT_CAL_POSE, (int32_t)v->plan->n_meas, l->res.pos_m, l->res.rot_rad);
    if (kc_plan_enough(v->plan) && kc_fit_certain(c, v->est, l->status, l->pred)) {
        kc_event(&out->events, KC_EVT_CAL_CONVERGED, -1, l->pred.pos_m, c->stop_pos_m);
        l->converged = true;
    }
    return kc_outcome(KC_OC_DONE);
}
