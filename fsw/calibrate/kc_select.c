#include "kc_select.h"

#include <stddef.h>

#include "kc_accuracy.h"
#include "kc_cost.h"
#include "kc_libm.h"
#include "kc_local.h"
#include "kc_move.h"
#include "kc_verdict.h"

#define PREDICT_ITER_MAX 8u /* enough for an approximate solution */

/* RMS and bound of independent errors of two sizes, three axes each. */
static double bound_of(double a, double b, double confidence)
{
    const double a2 = 3.0 * a * a, b2 = 3.0 * b * b;
    const double four = a2 * a2 + b2 * b2, dof = four > 0.0 ? 3.0 * (a2 + b2) * (a2 + b2) / four : 1.0;
    return kc_accuracy_bound(kc_sqrt(a2 + b2), dof, confidence);
}

/* What the stated errors of the camera chain leave of the tool however many poses are measured, before anything is
 * known of them: the place of the tags on the tool, and in the base frame that of the pan-tilt unit. Others come on top,
 * by where poses are measured: CAL_CHAIN_LIMIT says it with the proposal. */
static void warn_unreachable(const kc_active_t *tables, kc_out_t *out)
{
    const kc_config_t *c = &tables->config;
    const kc_camera_t *cam = &tables->camera;
    const bool lander = c->frame == (uint8_t)KC_RIGHT_IN_LANDER;
    const double left_m = bound_of(cam->plate_sigma_m, lander ? cam->mast_sigma_m : 0.0, c->stop_confidence);
    const double left_rad = bound_of(cam->plate_sigma_rad, lander ? cam->mast_sigma_rad : 0.0,
                                     c->stop_confidence);
    if (c->stop_pos_m > 0.0 && left_m > c->stop_pos_m) {
        kc_event(&out->events, KC_EVT_CAL_UNREACHABLE, 0, left_m, c->stop_pos_m);
    }
    if (c->stop_rot_rad > 0.0 && left_rad > c->stop_rot_rad) {
        kc_event(&out->events, KC_EVT_CAL_UNREACHABLE, 1, left_rad, c->stop_rot_rad);
    }
}

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
    warn_unreachable(view->tables, out);
}

/* ---- the acquisition ---- */

/* Parts of a choice. LOCAL: among local initial poses, while the arm has not left the park pose; by the bounds, which is
 * what shows soonest that a suspicion is wrong. The others are looked at only once it may leave. CLEARANCE: of the pose
 * that INFORMATION would leave for. SUSPECTED: among those that INFORMATION found safe by the bounds, by the prior of the
 * suspects: from the second pose away from the park pose on, since of the first one the clearance was checked. */
enum { FRESH = 0, LOCAL, JOINTS, INFORMATION, CLEARANCE, SUSPECTED, ACQUIRED, CHOSEN };

/* Joints expected at each candidate after the servo, and its cost: with large errors they are far from the seeds, and
 * the information of a pose depends on them (tests/bench/samples.py --space). False: goes on in the next step. */
static bool predict_joints(kc_arena_calibration_t *arena, const kc_view_t *view, kc_work_t *work)
{
    const uint64_t one = kc_move_joints_cost(view, 1u),
                   cost = one * KC_MOVE_EVALS(PREDICT_ITER_MAX) + KC_COST_WORK;
    kc_choice_t *ch = &arena->choice;
    for (; ch->i < view->tables->space.n_cand; ch->i++) {
        double q[KC_JOINT_MAX] = {0};
        if (ch->eligible[ch->i] == 0u) { continue; }
        if (!kc_work_take(work, cost)) { return false; }
        uint32_t n = kc_move_joints(view, ch->i, PREDICT_ITER_MAX, q);
        kc_work_return(work, cost - n * one - KC_COST_WORK);
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) {
            arena->cand_q[ch->i * KC_JOINT_MAX + j] = (float)q[j];
        }
        ch->cost[ch->i] = (float)kc_cost_candidate(view, ch->i, q);
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
    if (cal->acq == KC_ACQ_UCB && view->latest->gp_ok) {
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

/* Whether poses are chosen by information from the first one on that the arm leaves the park pose for. */
static bool informed(const kc_cal_t *cal)
{
    return cal->acq == KC_ACQ_DOPT || cal->acq == KC_ACQ_VOPT || cal->acq == KC_ACQ_RATE;
}

static bool by_information(const kc_cal_t *cal, const kc_view_t *view)
{
    return informed(cal) && view->plan->n_meas > 0u && kc_fit_solved(view->latest->status);
}

/* What is asked of the information criteria: by the acquisition, or (local) among local initial poses. By the bounds,
 * which alone say what is safe; by the prior of the suspects (suspected) only among what is. */
static void ask(const kc_cal_t *cal, kc_arena_calibration_t *arena, const kc_view_t *view, bool local,
                bool suspected)
{
    const kc_config_t *c = &view->tables->config;
    bool rate = cal->acq == KC_ACQ_RATE && !local, designed = view->plan->by_information;
    double safe_m = local ? c->local_safe_m : c->leave_safe_m;
    kc_acq_t kind = rate ? (kc_acq_t)c->rate_measure : cal->acq;
    const kc_acq_ask_t asked = {
        .kind = local || !informed(cal) ? KC_ACQ_DOPT : kind,
        .cov = view->est->obs[view->est->n_obs - 1u].cov, /* expected noise of the next one */
        .len_m = c->vopt_len_m,
        .by_bounds = designed || rate,
        .by_prior = suspected,
        .safe_m = designed && !suspected ? safe_m : 0.0,
        .only_safe = view->est->by_prior != 0u && !local && !suspected ? arena->choice.eligible : NULL,
        .cost = rate ? arena->choice.cost : NULL,
    };
    kc_acq_begin(&asked, view->est, &arena->acq);
}

/* Whether what is eligible now, and safe by the bounds, is to be compared by what the monitor suspects. */
static bool by_suspects(const kc_cal_t *cal, kc_arena_calibration_t *arena, const kc_view_t *view)
{
    if (view->est->by_prior == 0u || arena->acq.status != KC_OK || !arena->acq.safe) { return false; }
    ask(cal, arena, view, false, true);
    arena->choice.part = SUSPECTED;
    return true;
}

/* Where poses are chosen by information: the best of those eligible. */
static void acquired(kc_cal_t *cal, kc_arena_calibration_t *arena)
{
    arena->choice.part = ACQUIRED;
    if (arena->acq.status != KC_OK) { return; }
    cal->chosen_by = (int32_t)cal->acq;
    cal->acq_value = arena->acq.value;
    choose(&arena->choice, arena->acq.best);
}

/* The arm does not leave the park pose yet: the local initial pose of the largest gain, if it is predicted safe, else that
 * of the table. */
static void stay(kc_cal_t *cal, kc_plan_t *plan, kc_choice_t *ch, const kc_view_t *view)
{
    uint32_t cand = ch->local;
    if (ch->local_safe) {
        cal->acq_value = ch->local_gain;
        kc_plan_begin(plan, &view->tables->space, cand);
    } else {
        (void)kc_plan_next(plan, &view->tables->space, 0u, false, &cand); /* one is left */
    }
    choose(ch, cand);
}

static double power_of(const kc_arena_calibration_t *arena, const kc_view_t *view)
{
    return kc_local_power(&view->tables->config, kc_local_rows(view->est), arena->acq.known);
}

/* The local initial poses are compared: others follow only if an arm outside its bounds would have been noticed by now. */
static void consider_others(kc_cal_t *cal, kc_plan_t *plan, kc_arena_calibration_t *arena,
                            const kc_view_t *view)
{
    const kc_acq_work_t *acq = &arena->acq;
    kc_choice_t *ch = &arena->choice;
    ch->local = acq->best;
    ch->local_gain = acq->value;
    ch->local_safe = acq->status == KC_OK && acq->safe;
    if (power_of(arena, view) < view->tables->config.power_min) {
        stay(cal, plan, ch, view);
        return;
    }
    kc_plan_after_local(plan, &view->tables->space, !informed(cal), ch->eligible);
    ch->part = JOINTS;
}

/* Whether there is a pose to leave the park pose for that is predicted safe. */
static void consider_leaving(kc_cal_t *cal, kc_plan_t *plan, kc_arena_calibration_t *arena,
                             const kc_view_t *view)
{
    kc_choice_t *ch = &arena->choice;
    if (arena->acq.status != KC_OK || !arena->acq.safe) {
        stay(cal, plan, ch, view);
        return;
    }
    ch->clear.k = 0u;
    ch->part = CLEARANCE;
}

/* The arm leaves the park pose for the best of the poses that are predicted safe, if it stands clear there. */
static void leave(kc_cal_t *cal, kc_plan_t *plan, kc_arena_calibration_t *arena, const kc_view_t *view,
                  kc_out_t *out)
{
    const kc_acq_work_t *acq = &arena->acq;
    if (!kc_clear_enough(acq, &arena->choice.clear)) {
        stay(cal, plan, &arena->choice, view);
        return;
    }
    kc_event(&out->events, KC_EVT_CAL_LEAVES_PARK, (int32_t)plan->n_local, power_of(arena, view),
             kc_sqrt(acq->sigma2_m2));
    kc_plan_leave(plan, &view->tables->space, !informed(cal));
    kc_plan_begin(plan, &view->tables->space, acq->best);
    if (!informed(cal)) {
        choose(&arena->choice, acq->best);
        return;
    }
    acquired(cal, arena);
}

/* A part of the choice by information is over. */
static void go_on(kc_cal_t *cal, kc_plan_t *plan, kc_arena_calibration_t *arena, const kc_view_t *view,
                  kc_out_t *out)
{
    kc_choice_t *ch = &arena->choice;
    if (ch->part == LOCAL) {
        consider_others(cal, plan, arena, view);
    } else if (ch->part == JOINTS) {
        ask(cal, arena, view, false, false);
        ch->part = INFORMATION;
    } else if (ch->part == INFORMATION && ch->initial) {
        consider_leaving(cal, plan, arena, view);
    } else if (ch->part == CLEARANCE) {
        leave(cal, plan, arena, view, out);
    } else {
        bool once_more = ch->part == INFORMATION && by_suspects(cal, arena, view);
        if (!once_more) { acquired(cal, arena); }
    }
}

static bool part_done(kc_arena_calibration_t *arena, const kc_view_t *view, kc_work_t *work)
{
    kc_choice_t *ch = &arena->choice;
    if (ch->part == JOINTS) { return predict_joints(arena, view, work); }
    if (ch->part == CLEARANCE) {
        const float *q = &arena->cand_q[arena->acq.best * KC_JOINT_MAX];
        return kc_clear_step(view, q, &arena->acq, &ch->clear, work);
    }
    return kc_acq_info_step(view->est, arena->cand_q, view->tables->space.n_cand, ch->eligible, &arena->acq,
                            work);
}

/* The information criteria; where they cannot be evaluated, what at_once() gives. False: goes on in the next
 * step. */
static bool inform(kc_cal_t *cal, kc_plan_t *plan, kc_arena_calibration_t *arena, const kc_view_t *view,
                   kc_work_t *work, kc_out_t *out)
{
    kc_choice_t *ch = &arena->choice;
    while (ch->part <= SUSPECTED) {
        const uint64_t more = ch->initial && ch->part != JOINTS ? (uint64_t)KC_LOCAL_COST + KC_CLEAR_COST
                                                                : 0u;
        if (!part_done(arena, view, work) || !kc_work_take(work, more)) { return false; }
        go_on(cal, plan, arena, view, out);
    }
    return true;
}

/* ---- SELECT ---- */

static kc_outcome_t finish(kc_cal_t *cal, const kc_view_t *view, kc_ended_t ended, kc_cause_t if_nothing)
{
    if (!kc_plan_enough(view->plan)) { return kc_abort_for(if_nothing); }
    cal->ended = ended;
    return kc_outcome(KC_OC_FINISH);
}

/* Why no pose is to come, or NOT. */
static kc_ended_t at_its_end(const kc_view_t *view)
{
    if (view->latest->ended != KC_ENDED_NOT) { return view->latest->ended; }
    if (!kc_plan_complete(view->plan, &view->tables->space)) { return KC_ENDED_NOT; }
    return view->plan->n_meas < view->plan->n_own + view->plan->n_local ? KC_ENDED_OBSERVATIONS
                                                                        : KC_ENDED_POSES;
}

/* Whether another pose is to tell a bad detection at the newest one from an arm that has changed since the others. */
static bool once_more(kc_plan_t *plan, const kc_view_t *view, kc_ended_t ended, kc_out_t *out)
{
    if (ended != KC_ENDED_POSES || !kc_verdict_newest_rejected(view->est) || !kc_plan_more(plan)) {
        return false;
    }
    kc_event(&out->events, KC_EVT_CAL_NEWEST_REJECTED, (int32_t)plan->n_meas, 0.0, 0.0);
    return true;
}

void kc_select_begin(kc_arena_calibration_t *arena) { arena->choice = (kc_choice_t){0}; }

/* Observations that an arm inside its bounds hardly gives. */
static bool doubtful(const kc_view_t *view, kc_out_t *out)
{
    const kc_config_t *c = &view->tables->config;
    double p = 0.0;
    bool doubt = kc_local_doubt(c, view->est, view->latest->status, &p);
    if (doubt) { kc_event(&out->events, KC_EVT_CAL_DOUBT, (int32_t)view->plan->n_meas, p, c->doubt_p); }
    return doubt;
}

/* What needs no acquisition: an end, initial poses, replicates. */
static kc_outcome_t planned(kc_cal_t *cal, kc_plan_t *plan, kc_arena_calibration_t *arena,
                            const kc_view_t *view, kc_out_t *out)
{
    kc_choice_t *ch = &arena->choice;
    const kc_space_t *s = &view->tables->space;
    bool undetermined = view->est->rank < view->est->n_free;
    uint32_t cand = 0u;
    if (kc_plan_no_tags(plan, s, &view->tables->config)) {
        kc_event(&out->events, KC_EVT_CAL_TAGS_NOT_DETECTED, -1, (double)plan->n_local,
                 (double)plan->n_tried);
        return kc_abort_for(KC_CAUSE_TAGS_NOT_DETECTED);
    }
    kc_ended_t ended = at_its_end(view);
    if (ended != KC_ENDED_NOT && !once_more(plan, view, ended, out)) {
        return finish(cal, view, ended, KC_CAUSE_NO_CANDIDATE);
    }
    cal->acq_value = 0.0;
    cal->chosen_by = -1;
    ch->initial = kc_plan_local(plan, s, ch->eligible);
    if (ch->initial && doubtful(view, out)) { return kc_outcome(KC_OC_AGAIN); }
    if (ch->initial) {
        ask(cal, arena, view, true, false);
        ch->part = LOCAL;
        return kc_outcome(KC_OC_STAY);
    }
    kc_plan_after_local(plan, s, false, ch->eligible);
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
        kc_work_spend(work, KC_LOCAL_DOUBT_COST);
        kc_outcome_t oc = planned(cal, plan, arena, view, out);
        if (oc.id != KC_OC_STAY) { return oc; }
    }
    if (!inform(cal, plan, arena, view, work, out)) { return kc_outcome(KC_OC_STAY); }
    if (ch->part == ACQUIRED && at_once(cal, arena, rng, view) != KC_OK) {
        kc_event(&out->events, KC_EVT_CAL_NO_CANDIDATE, -1, 0.0, 0.0);
        return finish(cal, view, KC_ENDED_CANDIDATES, KC_CAUSE_NO_CANDIDATE);
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
    if (late || flat) { return finish(cal, view, late ? KC_ENDED_TIME : KC_ENDED_ENERGY, KC_CAUSE_BUDGET); }
    return kc_outcome(KC_OC_STAY);
}
