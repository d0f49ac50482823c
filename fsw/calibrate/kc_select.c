#include "kc_select.h"

#include "kc_move.h"

#define PREDICT_ITER_MAX 8u /* enough for an approximate solution */

void kc_select_start(kc_cal_t *cal, kc_plan_t *plan, const kc_view_t *view, const kc_start_t *ask,
                     kc_out_t *out)
{
    *cal = (kc_cal_t){
        .session = cal->session + 1u,
        .acq = ask->acq,
        .start_us = view->clock->now_us,
        .energy_us = view->clock->now_us,
        .candidate = -1,
    };
    kc_plan_start(plan, &view->tables->space, &view->tables->config, ask->n_goal);
    kc_event(&out->events, KC_EVT_CAL_START, (int32_t)cal->session, (double)ask->n_goal, (double)ask->acq);
}

/* ---- the acquisition ---- */

/* Parts of a choice. */
enum { FRESH = 0, JOINTS, INFORMATION, ACQUIRED, CHOSEN };

/* Joints expected at each candidate after the servo: with large errors they are far from the seeds, and the
 * information of a pose depends on them (tests/bench/samples.py --space). False: goes on in the next step. */
static bool predict_joints(kc_arena_calibration_t *arena, const kc_view_t *view, kc_work_t *work)
{
    const uint64_t cost = kc_move_joints_cost(view, KC_MOVE_EVALS(PREDICT_ITER_MAX));
    kc_choice_t *ch = &arena->choice;
    for (; ch->i < view->tables->space.n_cand; ch->i++) {
        double q[KC_JOINT_MAX] = {0};
        if (view->plan->usable[ch->i] == 0u) { continue; }
        if (!kc_work_take(work, cost)) { return false; }
        uint32_t n = kc_move_joints(view, ch->i, PREDICT_ITER_MAX, q);
        kc_work_return(work, cost - kc_move_joints_cost(view, n));
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
            arena->cand_q[ch->i * KC_JOINT_MAX + j] = (float)q[j];
        }
    }
    return true;
}

static void choose(kc_choice_t *ch, uint32_t cand)
{
    ch->cand = cand;
    ch->part = CHOSEN;
}

/* By UCB, or at random where the requested acquisition cannot be evaluated (GP lost, nothing solved yet).
 * KC_ERR_ARG: no candidate is left. */
static kc_status_t at_once(kc_cal_t *cal, kc_arena_calibration_t *arena, uint64_t *rng, const kc_view_t *view)
{
    const kc_active_t *a = view->tables;
    const uint8_t *usable = view->plan->usable;
    uint32_t cand = 0u;
    kc_status_t st = KC_ERR_ARG;
    cal->chosen_by = (int32_t)cal->acq;
    if (cal->acq == KC_ACQ_UCB && view->learned->gp_ok) {
        double beta = kc_acq_beta(a->space.n_cand, view->plan->n_meas + 1u, a->config.beta_scale);
        st = kc_acq_ucb(&arena->gp, usable, beta, &cand, &cal->acq_value);
    }
    if (st != KC_OK) {
        cal->chosen_by = (int32_t)KC_ACQ_RANDOM;
        cal->acq_value = 0.0;
        st = kc_acq_random(usable, a->space.n_cand, rng, &cand);
    }
    choose(&arena->choice, cand);
    return st;
}

static bool by_information(const kc_cal_t *cal, const kc_view_t *view)
{
    return (cal->acq == KC_ACQ_DOPT || cal->acq == KC_ACQ_VOPT) && view->plan->n_meas > 0u &&
           kc_fit_solved(view->learned->status);
}

/* The information criteria; where they cannot be evaluated, what at_once() gives. False: goes on in the next
 * step. */
static bool inform(kc_cal_t *cal, kc_arena_calibration_t *arena, const kc_view_t *view, kc_work_t *work)
{
    const kc_active_t *a = view->tables;
    kc_choice_t *ch = &arena->choice;
    if (ch->part == JOINTS) {
        const double *cov = view->est->obs[view->est->n_obs - 1u].cov; /* expected noise of the next one */
        if (!predict_joints(arena, view, work)) { return false; }
        kc_acq_info_begin(cal->acq, view->est, cov, a->config.vopt_len_m, &arena->acq);
        ch->part = INFORMATION;
    }
    if (ch->part == INFORMATION) {
        if (!kc_acq_info_step(view->est, arena->cand_q, a->space.n_cand, view->plan->usable, &arena->acq,
                              work)) {
            return false;
        }
        ch->part = ACQUIRED;
        if (arena->acq.status == KC_OK) {
            cal->chosen_by = (int32_t)cal->acq;
            cal->acq_value = arena->acq.value;
            choose(ch, arena->acq.best);
        }
    }
    return true;
}

/* ---- SELECT ---- */

static kc_outcome_t finish(const kc_view_t *view, kc_cause_t if_nothing)
{
    return kc_plan_enough(view->plan) ? kc_outcome(KC_OC_FINISH) : kc_abort_for(if_nothing);
}

void kc_select_begin(kc_arena_calibration_t *arena) { arena->choice = (kc_choice_t){0}; }

/* What needs no acquisition: an end, initial poses, replicates. */
static kc_outcome_t planned(kc_cal_t *cal, kc_plan_t *plan, kc_choice_t *ch, const kc_view_t *view,
                            kc_out_t *out)
{
    const kc_space_t *s = &view->tables->space;
    bool undetermined = view->est->rank < view->est->n_free;
    uint32_t cand = 0u;
    if (kc_plan_no_tags(plan, s, &view->tables->config)) {
        kc_event(&out->events, KC_EVT_CAL_TAGS_NOT_DETECTED, -1, (double)plan->n_local,
                 (double)plan->n_tried);
        return kc_abort_for(KC_CAUSE_TAGS_NOT_DETECTED);
    }
    if (view->learned->converged || kc_plan_complete(plan, s)) { return finish(view, KC_CAUSE_NO_CANDIDATE); }
    cal->acq_value = 0.0;
    cal->chosen_by = -1;
    ch->part = by_information(cal, view) ? JOINTS : ACQUIRED;
    if (kc_plan_next(plan, s, view->tables->config.replicate_every, undetermined, &cand)) {
        choose(ch, cand);
    }
    return kc_outcome(KC_OC_STAY);
}

kc_outcome_t kc_select_run(kc_cal_t *cal, kc_plan_t *plan, kc_arena_calibration_t *arena, uint64_t *rng,
                           const kc_view_t *view, kc_work_t *work, kc_out_t *out)
{
    kc_choice_t *ch = &arena->choice;
    if (ch->part == FRESH) {
        kc_outcome_t oc = planned(cal, plan, ch, view, out);
        if (oc.id != KC_OC_STAY) { return oc; }
    }
    if (!inform(cal, arena, view, work)) { return kc_outcome(KC_OC_STAY); }
    if (ch->part == ACQUIRED && at_once(cal, arena, rng, view) != KC_OK) {
        kc_event(&out->events, KC_EVT_CAL_NO_CANDIDATE, -1, 0.0, 0.0);
        return finish(view, KC_CAUSE_NO_CANDIDATE);
    }
    if (!kc_work_take(work, kc_move_begin_cost(view))) { return kc_outcome(KC_OC_STAY); }
    cal->candidate = (int32_t)ch->cand;
    cal->replicate = (int32_t)kc_plan_choose(plan, &view->tables->space, ch->cand);
    return kc_outcome(KC_OC_DONE);
}

void kc_select_skip(kc_plan_t *plan, const kc_view_t *view, kc_out_t *out)
{
    kc_event(&out->events, KC_EVT_CAL_CAND_SKIPPED, view->cal->candidate, 0.0, 0.0);
    kc_plan_skipped(plan, (uint32_t)view->cal->candidate);
}

/* ---- budgets ---- */

/* Energy used since the step before, by what moves now. */
static void count_energy(kc_cal_t *cal, const kc_view_t *view)
{
    const kc_config_t *c = &view->tables->config;
    double power_w = kc_view_at_rest(view) ? c->power_idle_w : c->power_move_w;
    cal->energy_j += power_w * (double)(view->clock->now_us - cal->energy_us) * 1e-6;
    cal->energy_us = view->clock->now_us;
}

kc_outcome_t kc_select_budget(kc_cal_t *cal, const kc_view_t *view, kc_out_t *out)
{
    const kc_config_t *c = &view->tables->config;
    kc_state_t state = view->place->state;
    uint64_t used_us = view->clock->now_us - cal->start_us;
    if (!kc_states_calibrating(state)) { return kc_outcome(KC_OC_STAY); }
    count_energy(cal, view);
    if (kc_states_estimating(state)) { return kc_outcome(KC_OC_STAY); } /* a measured pose is used */
    bool late = c->budget_us > 0u && used_us > c->budget_us;
    bool flat = c->energy_budget_j > 0.0 && cal->energy_j > c->energy_budget_j;
    if (late) { kc_event(&out->events, KC_EVT_CAL_BUDGET, -1, (double)used_us, (double)c->budget_us); }
    if (flat) { kc_event(&out->events, KC_EVT_CAL_ENERGY, -1, cal->energy_j, c->energy_budget_j); }
    if (late || flat) { return finish(view, KC_CAUSE_BUDGET); }
    return kc_outcome(KC_OC_STAY);
}
