#include "kc_sequence.h"

#include <string.h>

#include "kc_app_parts.h"
#include "kc_approach.h"
#include "kc_dispatch.h"
#include "kc_measure.h"
#include "kc_propose.h"
#include "kc_select.h"
#include "kc_signed.h"
#include "kc_update.h"

#define CHAIN_MAX 4u /* states that one step may pass through */

/* ---- what a state begins with ---- */

static kc_outcome_t withdraw(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    double q[KC_JOINT_MAX];
    memcpy(app->q_meas, app->move.q_target, sizeof app->q_meas);
    kc_approach_start(&app->view, &app->rng, app->q_meas, q);
    return kc_move_near(&app->move, &app->view, work, out, q);
}

static kc_outcome_t to_seed(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    double seed[KC_JOINT_MAX];
    kc_view_seed(&app->view, seed);
    return kc_move_near(&app->move, &app->view, work, out, seed);
}

static kc_outcome_t aim(kc_app_t *app, kc_out_t *out)
{
    kc_pantilt_aim(&app->pantilt, &app->view, out, app->input.telemetry.arm.q, app->observe.off_m);
    kc_observe_aimed(&app->observe, &app->pantilt);
    return kc_outcome(KC_OC_STAY);
}

/* The pan-tilt unit turns while the arm moves to where the next frame is taken. */
static void aim_ahead(kc_app_t *app, kc_out_t *out)
{
    double q[KC_JOINT_MAX];
    kc_move_next_view(&app->move, &app->view, q);
    kc_pantilt_aim(&app->pantilt, &app->view, out, q, app->observe.off_m);
}

/* From a stop. SELECT has sent the first command of a move itself. */
static kc_outcome_t onward(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    if (!app->observe.at_stop) { return kc_outcome(KC_OC_STAY); }
    kc_observe_at_stop(&app->observe, false);
    kc_outcome_t oc = kc_move_onward(&app->move, &app->view, work, out);
    if (oc.id != KC_OC_DONE) { return oc; }
    aim_ahead(app, out);
    return kc_outcome(KC_OC_STAY);
}

static kc_outcome_t begin(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    const kc_view_t *v = &app->view;
    switch (app->place.state) {
    case KC_ST_MOVE: return onward(app, work, out);
    case KC_ST_AIM: return aim(app, out);
    case KC_ST_SETTLE:
    case KC_ST_REST: kc_rest_begin(&app->rest); break;
    case KC_ST_OBSERVE:
    case KC_ST_SEARCH: kc_request_begin(&app->request); break;
    case KC_ST_SERVO: return kc_move_near(&app->move, v, work, out, app->observe.q_servo);
    case KC_ST_RETREAT: return kc_move_near(&app->move, v, work, out, app->observe.q_detected);
    case KC_ST_SEED: return to_seed(app, work, out);
    case KC_ST_WITHDRAW: return withdraw(app, work, out);
    case KC_ST_APPROACH: return kc_move_near(&app->move, v, work, out, app->q_meas);
    case KC_ST_TURN: return kc_observe_turn(&app->observe, &app->pantilt, v, out);
    case KC_ST_UPDATE:
    case KC_ST_REFINE:
    case KC_ST_LEARN:
    case KC_ST_REPORT: kc_update_begin(&app->update); break;
    case KC_ST_SELECT: kc_select_begin(&app->arena.calibration); break;
    case KC_ST_PROPOSE: kc_evaluation_begin(&app->evaluated, &app->arena.proposal, v); break;
    default: break;
    }
    return kc_outcome(KC_OC_STAY);
}

/* ---- what a state does in a step ---- */

/* The next candidate is chosen: the arm sets off, and the pan-tilt unit turns meanwhile. */
static kc_outcome_t select_next(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    const kc_view_t *v = &app->view;
    kc_arena_calibration_t *arena = &app->arena.calibration;
    kc_outcome_t oc = kc_select_run(&app->cal, &app->plan, arena, &app->rng, v, work, out);
    if (oc.id == KC_OC_AGAIN) {
        kc_plan_by_table(&app->plan, &v->tables->space, &v->tables->config);
        kc_update_start(&app->latest, &app->est, arena, v, app->est.opt.free_mask);
        kc_work_spend(work, kc_update_start_cost(v));
    }
    if (oc.id != KC_OC_DONE) { return oc; }
    kc_observe_begin(&app->observe);
    oc = kc_move_begin(&app->move, v, work, out);
    if (oc.id == KC_OC_DONE) { aim_ahead(app, out); }
    return oc;
}

kc_journal_t kc_sequence_record(const kc_app_t *app)
{
    const kc_active_t *a = &app->tables.active;
    const kc_journal_t *last = &app->journal.last;
    /* What was lost in memory is still in the store, and comes back from there. */
    bool kin_lost = a->crc[KC_TBL_KIN] == 0u && (app->scrub.lost & 1u << KC_TBL_KIN) != 0u;
    bool prev_lost = a->kin_prev_crc == 0u && (app->scrub.lost & 1u) != 0u;
    kc_journal_t now = {
        .state = (uint32_t)app->place.state,
        .session = app->cal.session,
        .pose = app->plan.n_meas,
        .boot_count = app->boot_count,
        .kin_crc = kin_lost ? last->kin_crc : a->crc[KC_TBL_KIN],
        .prev_crc = prev_lost ? last->prev_crc : a->kin_prev_crc,
        .proposal_crc = app->review.crc,
        .proposal_verdict = kc_review_verdict(&app->review),
        .candidate = app->cal.candidate,
        .seg_from = app->move.seg_from,
        .seg_to = app->move.seg_to,
        .t_us = app->clock.clock_us,
        .counters = app->cmd_log.counters,
    };
    return now;
}

static kc_change_parts_t change_parts(kc_app_t *app)
{
    return (kc_change_parts_t){
        .view = &app->view,
        .tables = &app->tables,
        .review = &app->review,
        .journal = &app->journal,
        .images = &app->arena.idle.images,
        .log = &app->cmd_log,
        .now = kc_sequence_record(app),
    };
}

static kc_outcome_t propose(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    bool accepted = false;
    kc_outcome_t oc = kc_propose_run(&app->evaluated, &app->arena.proposal, &app->review, &app->tables,
                                     &app->view, &accepted, work, out);
    kc_change_kind_t kind = accepted ? KC_CHANGE_ACCEPT : KC_CHANGE_PROPOSE;
    if (oc.id == KC_OC_STORE) { kc_change_begin(&app->change, kind, &app->view, NULL); }
    return oc;
}

static kc_outcome_t store(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    if (app->change.kind == KC_CHANGE_PUT_BACK) { kc_work_spend(work, KC_CHANGE_BACK_COST); }
    kc_change_parts_t parts = change_parts(app);
    kc_change_run(&app->change, &parts, out);
    return kc_outcome(KC_OC_STAY);
}

static kc_outcome_t move_on(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    kc_outcome_t oc = kc_move_run(&app->move, &app->view, work, out);
    if (oc.id == KC_OC_DONE) { kc_observe_at_stop(&app->observe, kc_move_stopped(&app->move)); }
    return oc;
}

static kc_outcome_t measure(kc_app_t *app, kc_out_t *out)
{
    kc_observe_t *o = &app->observe;
    kc_outcome_t oc = kc_measure_run(&app->frames, &app->request, &app->est, o->taken_at, &app->view, out);
    if (oc.id == KC_OC_DONE && o->taken_at != KC_AT_CANDIDATE) {
        kc_plan_extra(&app->plan, o->taken_at);
        o->extra_held = o->taken_at != KC_AT_STOP;
    }
    return kc_observe_measured(o, oc);
}

static kc_outcome_t work_on(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    const kc_view_t *v = &app->view;
    kc_arena_calibration_t *arena = &app->arena.calibration;
    switch (app->place.state) {
    case KC_ST_MOVE: return move_on(app, work, out);
    case KC_ST_SERVO:
    case KC_ST_SEED:
    case KC_ST_RETREAT:
    case KC_ST_WITHDRAW:
    case KC_ST_APPROACH: return kc_move_wait(&app->move, v, work, out);
    case KC_ST_AIM:
    case KC_ST_TURN: return kc_pantilt_wait(&app->pantilt, v, out);
    case KC_ST_SETTLE:
    case KC_ST_REST: return kc_rest_run(&app->rest, v, out);
    case KC_ST_OBSERVE: return kc_observe_run(&app->observe, &app->request, v, out);
    case KC_ST_SEARCH: return kc_observe_search(&app->observe, &app->request, v, out);
    case KC_ST_MEASURE: return measure(app, out);
    case KC_ST_UPDATE: return kc_update_solve(&app->update, &app->latest, &app->est, &arena->gp, v, work);
    case KC_ST_REFINE: return kc_update_refine(&app->update, &app->latest, &app->est, v, work);
    case KC_ST_LEARN:
        return kc_update_learn(&app->update, &app->latest, &app->est, &app->plan, arena, v, work, out);
    case KC_ST_REPORT:
        return kc_update_report(&app->update, &app->latest, &app->evaluated, &arena->evaluation, v, work,
                                out);
    case KC_ST_SELECT: return select_next(app, work, out);
    case KC_ST_PROPOSE: return propose(app, work, out);
    case KC_ST_STORE: return store(app, work, out);
    case KC_ST_ARMED: return kc_review_armed(&app->review, v, out);
    default: return kc_outcome(KC_OC_STAY); /* IDLE, REVIEW and SAFE wait for commands */
    }
}

/* ---- from state to state ---- */

/* Hold the arm, record the cause. A correction that waits for review is dropped. */
static void stop(kc_app_t *app, kc_work_t *work, kc_out_t *out, kc_cause_t cause)
{
    kc_change_parts_t parts = change_parts(app);
    int32_t pose = kc_states_calibrating(app->place.state) ? (int32_t)app->plan.n_meas : -1;
    kc_event(&out->events, KC_EVT_CAL_ABORTED, pose, (double)cause, 0.0);
    if (app->change.kind == KC_CHANGE_PUT_BACK) { kc_work_spend(work, KC_CHANGE_BACK_COST); }
    kc_change_cancel(&app->change, &parts, out);
    kc_move_hold(&app->move, &app->view, out);
    kc_review_drop(&app->review, out);
    kc_request_drop(&app->request);
}

/* The servo had to come back: the pose is measured where an extra observation was made just before. Both would share
 * what is wrong there, so the pose takes the place of the other. */
static void replace_extra(kc_app_t *app)
{
    if (!app->observe.same_place) { return; }
    app->observe.same_place = false;
    app->observe.extra_held = false;
    kc_plan_drop_extra(&app->plan);
    app->est.n_obs--;
}

/* Observations on the way to a pose that will not be measured: the estimate does not have them, and what is stated about
 * it is computed from those that it has. */
static void drop_unfinished(kc_app_t *app)
{
    const kc_plan_t *plan = &app->plan;
    /* without a pose there is nothing to propose */
    const uint32_t used = plan->obs_of[plan->n_meas - 1u] + 1u;
    while (plan->n_obs > used) {
        kc_plan_drop_extra(&app->plan);
        app->est.n_obs--;
    }
}

/* The frame in which OBSERVE found the tags is the first one of what is measured there, unless something moved while it
 * was taken. */
static void keep_frame(kc_app_t *app)
{
    const kc_telemetry_t *t = app->view.telemetry;
    if (app->request.moved) { return; }
    kc_frames_add(&app->frames, &app->request.det, &t->arm, &t->pantilt);
}

/* Frames are of one place and one measurement. */
static void leave(kc_app_t *app, kc_outcome_t oc, kc_work_t *work, kc_out_t *out)
{
    if (app->place.state == KC_ST_MEASURE) { kc_frames_clear(&app->frames); }
    if (app->place.state == KC_ST_OBSERVE && oc.id == KC_OC_MEASURE) { keep_frame(app); }
    if (app->place.state == KC_ST_MEASURE && oc.id == KC_OC_DONE) {
        kc_plan_measured(&app->plan, &app->view.tables->space, (uint32_t)app->cal.candidate);
    }
    if (app->place.state == KC_ST_OBSERVE) { replace_extra(app); }
    if (oc.id == KC_OC_DISTURBED) { kc_request_drop(&app->request); }
    if (oc.id == KC_OC_SKIP) { kc_select_skip(&app->plan, &app->view, out); }
    if (oc.id == KC_OC_FINISH) { drop_unfinished(app); }
    if (oc.id == KC_OC_ABORT) { stop(app, work, out, oc.cause); }
}

/* Go where the table says; a state may be left at once by what it begins with. True if the work of the new
 * state begins in this step. */
static bool follow(kc_app_t *app, kc_outcome_t oc, kc_work_t *work, kc_out_t *out)
{
    bool same_step = false;
    for (uint32_t i = 0u; oc.id != KC_OC_STAY && i < CHAIN_MAX; i++) {
        kc_next_t next = kc_states_next(app->place.state, oc.id);
        leave(app, oc, work, out);
        app->place = (kc_place_t){next.state, app->clock.now_us};
        same_step = next.same_step;
        oc = begin(app, work, out);
    }
    return same_step;
}

/* A budget is used up in the middle of a pose: that is lost. */
static void check_budget(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    kc_outcome_t oc = kc_select_budget(&app->cal, &app->view, out);
    if (oc.id != KC_OC_STAY && app->place.state != KC_ST_SELECT) {
        kc_move_hold(&app->move, &app->view, out);
        kc_request_drop(&app->request);
    }
    (void)follow(app, oc, work, out);
}

void kc_sequence_run(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    kc_move_held(&app->move, &app->view, out);
    (void)follow(app, kc_input_silence(&app->view, out), work, out);
    check_budget(app, work, out);
    for (uint32_t i = 0u; i < CHAIN_MAX && follow(app, work_on(app, work, out), work, out); i++) {}
}

void kc_sequence_scrub(kc_app_t *app, kc_work_t *work, kc_out_t *out)
{
    (void)follow(app, kc_scrub_run(&app->scrub, &app->tables, &app->est, &out->events), work, out);
}

/* ---- inputs ---- */

void kc_sequence_stored(kc_app_t *app, kc_work_t *work, const kc_in_t *in, kc_out_t *out)
{
    kc_change_parts_t parts = change_parts(app);
    if (app->place.state == KC_ST_STORE && in->has_store_result) {
        kc_work_spend(work, kc_tbl_cost(&app->tables));
    }
    (void)follow(app, kc_change_stored(&app->change, &parts, in, out), work, out);
}

void kc_sequence_detections(kc_app_t *app, kc_work_t *work, const kc_in_t *in, kc_out_t *out)
{
    const kc_view_t *v = &app->view;
    kc_monitoring_rest(&app->monitoring, v);
    for (uint32_t i = 0u; i < in->n_det && i < KC_DET_QUEUE_MAX; i++) {
        const kc_detection_t *d = &in->det[i];
        if (!kc_monitoring_wants(v)) {
            kc_input_detection(&app->input, &app->request, &app->frames, v, d, out);
        } else if (kc_input_observation(v, app->monitoring.t_us, d, out)) {
            kc_monitoring_observe(&app->monitoring, &app->arena.idle.monitor, v, d, work, out);
        }
    }
}

/* ABORT wins over what came with it, whatever the order in which they are carried out. */
static bool abort_came(const kc_in_t *in)
{
    bool came = false;
    for (uint32_t i = 0u; i < in->n_cmd && i < KC_CMD_QUEUE_MAX; i++) {
        came = came || in->cmd[i].opcode == (int32_t)KC_CMD_ABORT;
    }
    return came;
}

void kc_sequence_commands(kc_app_t *app, kc_work_t *work, const kc_in_t *in, kc_out_t *out)
{
    for (uint32_t i = 0u; i < in->n_chunk && i < KC_CHUNK_QUEUE_MAX; i++) {
        kc_work_spend(work, kc_auth_cost(KC_SIGNED_HEAD_MAX + KC_CHUNK_BYTES));
        kc_cmd_chunk(&app->cmd_log, &app->tables, &app->view, &in->chunk[i], out);
    }
    for (uint32_t i = 0u; i < in->n_cmd && i < KC_CMD_QUEUE_MAX; i++) {
        bool aborted = abort_came(in) || in->cmd[i].stopped != 0u;
        (void)follow(app, kc_dispatch(app, &in->cmd[i], aborted, work, out), work, out);
    }
}
