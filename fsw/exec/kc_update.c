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
    l->gp_ok = kc_gp_init(&work->gp, &a->kernel, 0u, work->cand_pt, a->space.n_cand) == KC_OK;
}

/* ---- objective f (eq. 6) ---- */

static kc_miss_t miss_of(const kc_view_t *v, const double *coef, uint32_t i)
{
    double r[6];
    kc_observation_residual(v->tables, coef, &v->est->obs[i], r, NULL);
    return (kc_miss_t){kc_v3_norm(r), kc_v3_norm(&r[3])};
}

/* Objective of all poses with the latest correction; the last one is the newest pose. */
static void objective(kc_learned_t *l, const kc_view_t *v)
{
    const kc_config_t *c = &v->tables->config;
    uint32_t n = v->plan->n_meas;
    for (uint32_t i = 0u; i < n; i++) {
        kc_miss_t miss = miss_of(v, l->coef, i);
        l->dp_m[i] = miss.pos_m;
        l->dr_rad[i] = miss.rot_rad;
    }
    kc_acq_objective(l->dp_m, l->dr_rad, n, c->a1, c->sp_floor_m, c->sq_floor_rad, l->y);
}

static kc_point_t newest_point(const kc_view_t *v)
{
    const kc_obs_t *obs = &v->est->obs[v->plan->n_meas - 1u];
    kc_point_t x;
    kc_v3_copy(obs->p_m, x.p_m);
    memcpy(x.q_wxyz, obs->q_wxyz, sizeof x.q_wxyz);
    return x;
}

/* ---- UPDATE, REFINE ---- */

static kc_status_t solve_from(kc_est_t *est, const double *start)
{
    memcpy(est->start, start, sizeof est->start);
    return kc_est_solve(est);
}

static bool predicts_better(const kc_learned_t *l, const kc_view_t *v, uint32_t newest)
{
    if (newest == 0u || !kc_fit_solved(l->status)) { return false; }
    return kc_fit_predicts_better(&v->tables->config, miss_of(v, v->est->coef, newest), l->res);
}

kc_outcome_t kc_update_solve(kc_learned_t *l, kc_est_t *est, const kc_gp_t *gp, const kc_view_t *v)
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
    l->trusted = predicts_better(l, v, newest); /* of the estimate before this pose */
    l->gp_mean = 0.0;
    if (l->gp_ok) { kc_gp_predict(gp, &x, &l->gp_mean, &var); }
    l->gp_sigma = kc_sqrt(kc_max(var, 0.0));
    l->status = solve_from(est, v->tables->kin.value);
    return kc_outcome(KC_OC_DONE);
}

static bool differ(const double *a, const double *b)
{
    bool any = false;
    for (uint32_t c = 0u; c < KC_COEF_MAX; c++) { any = any || a[c] < b[c] || a[c] > b[c]; }
    return any;
}

kc_outcome_t kc_update_refine(kc_learned_t *l, kc_est_t *est, const kc_view_t *v)
{
    const double *start = v->tables->kin.value;
    kc_fit_quality_t first = kc_fit_quality(est, l->status);
    if (!kc_fit_needs_second_start(&v->tables->config, &first) || !differ(l->coef, start)) {
        return kc_outcome(KC_OC_DONE);
    }
    l->status = solve_from(est, l->coef);
    kc_fit_quality_t second = kc_fit_quality(est, l->status);
    if (!kc_fit_second_is_better(&first, &second)) { l->status = solve_from(est, start); }
    return kc_outcome(KC_OC_DONE);
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

/* *worst: the newest pose that is a mismatch, with its residual. */
static bool mismatch(const kc_view_t *v, uint32_t *worst, kc_miss_t *worst_miss)
{
    kc_miss_t miss[KC_MEAS_MAX];
    uint32_t n = v->plan->n_meas;
    for (uint32_t i = 0u; i < n; i++) { miss[i] = miss_of(v, v->est->coef, i); }
    bool found = kc_fit_mismatch(&v->tables->config, v->est, miss, n, v->plan->n_local, worst);
    *worst_miss = miss[*worst];
    return found;
}

/* Whether the estimate is that of the arm that was verified. Among local initial poses, one bad detection is
 * searched for first; its pose is the next to be measured. */
static kc_outcome_t evaluate(kc_learned_t *l, kc_est_t *est, kc_plan_t *plan, const kc_view_t *v,
                             kc_out_t *out)
{
    uint32_t worst = 0u, without = est->without;
    kc_miss_t miss = {0.0, 0.0};
    bool solved = kc_fit_solved(l->status);
    bool fits = !solved || !mismatch(v, &worst, &miss);
    kc_leave_out_answer_t answer = fits ? KC_LEAVE_OUT_DONE : KC_LEAVE_OUT_NONE;
    if (plan->n_meas == plan->n_local) {
        double cost = solved ? est->cost : KC_INF;
        answer = kc_leave_out_next(&l->leave_out, &v->tables->config, plan, est->obs, fits, cost,
                                   &est->without);
    }
    if (answer == KC_LEAVE_OUT_AGAIN) { return kc_outcome(KC_OC_AGAIN); }
    report_outliers(l, v, out);
    if (answer == KC_LEAVE_OUT_NONE) {
        kc_event(&out->events, KC_EVT_CAL_MODEL_MISMATCH, (int32_t)worst + 1, miss.pos_m, miss.rot_rad);
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
    if (v->tables->kernel.choose) { (void)kc_gp_choose(&work->gp, work->cand_pt); }
}

kc_outcome_t kc_update_learn(kc_learned_t *l, kc_est_t *est, kc_plan_t *plan, kc_arena_calibration_t *work,
                             const kc_view_t *v, kc_out_t *out)
{
    kc_outcome_t evaluated = evaluate(l, est, plan, v, out);
    if (evaluated.id != KC_OC_DONE) { return evaluated; }
    if (!kc_fit_solved(l->status)) {
        kc_event(&out->events, KC_EVT_CAL_EST, -1, (double)l->status, 0.0);
    } else if (est->rank == est->n_free || est->hold_none || l->trusted) {
        memcpy(l->coef, est->coef, sizeof l->coef);
    }
    objective(l, v);
    grow_gp(l, work, v);
    return kc_outcome(KC_OC_DONE);
}

/* ---- REPORT ---- */

/* RMS of the predicted pose sigma over the search space, from at most KC_SPACE_SAMPLES candidates; the stated
 * noise is scaled up to what the residuals show. */
static kc_miss_t predict(const kc_view_t *v)
{
    uint32_t n = v->tables->space.n_cand;
    uint32_t stride = (n + KC_SPACE_SAMPLES - 1u) / KC_SPACE_SAMPLES, count = 0u;
    double pos = 0.0, rot = 0.0, cov[36];
    for (uint32_t c = 0u; c < n; c += stride, count++) {
        kc_ctx_t ctx;
        kc_eval_t eval;
        kc_view_ctx(v, c, &ctx);
        kc_est_pose_cov(v->est, &ctx, &eval, cov);
        pos += cov[0] + cov[7] + cov[14];
        rot += cov[21] + cov[28] + cov[35];
    }
    double scale = kc_max(1.0, v->est->noise_scale);
    return (kc_miss_t){scale * kc_sqrt(pos / (double)count), scale * kc_sqrt(rot / (double)count)};
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

kc_outcome_t kc_update_report(kc_learned_t *l, const kc_view_t *v, kc_out_t *out)
{
    const kc_config_t *c = &v->tables->config;
    if (kc_fit_solved(l->status)) { l->pred = predict(v); }
    out->has_progress = 1u;
    fill_progress(v, &out->progress);
    kc_event(&out->events, KC_EVT_CAL_POSE, (int32_t)v->plan->n_meas, l->res.pos_m, l->res.rot_rad);
    if (kc_plan_enough(v->plan) && kc_fit_certain(c, v->est, l->status, l->pred)) {
        kc_event(&out->events, KC_EVT_CAL_CONVERGED, -1, l->pred.pos_m, c->stop_pos_m);
        l->converged = true;
    }
    return kc_outcome(KC_OC_DONE);
}
