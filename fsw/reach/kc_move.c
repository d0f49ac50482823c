#include "kc_move.h"

#include <string.h>

#include "kc_guard.h"
#include "kc_ik.h"
#include "kc_input_fields.h"
#include "kc_libm.h"

#define IK_ITER_MAX 40u /* with the largest tables all of them are charged with less than KC_STEP_WORK */
#define IK_STEP_MAX 0.3
#define ECHO_TOL 1e-6       /* joint difference up to which the arm echoes its target */
#define RESEND_US 1000000u  /* a command that the arm does not echo is sent again after this */
/* Hold is repeated, for three seconds, while the arm goes on: a command may be lost, or overtaken by the move before it. */
#define HOLD_AGAIN_US 300000u
#define HOLDS_MAX 10u
/* Largest distance from a segment, in arrival tolerances: outside nodes nothing but the segments is
 * verified. */
#define SEGMENT_TOLS 2.0

/* ---- arm commands ---- */

static void command(kc_move_t *move, const kc_view_t *view, kc_out_t *out, bool hold)
{
    kc_arm_cmd_t *c = &out->arm_cmd;
    out->has_arm_cmd = 1u;
    c->seq = ++move->seq;
    c->n_joints = view->tables->arm.n_joints;
    c->hold = hold;
    c->speed_scale = hold ? 1.0 : view->tables->config.speed_scale;
    memcpy(c->q, hold ? view->telemetry->arm.q : move->q_target, sizeof c->q);
    move->sent_us = view->clock->now_us;
}

void kc_move_hold(kc_move_t *move, const kc_view_t *view, kc_out_t *out)
{
    move->checking = false;
    move->holds = HOLDS_MAX;
    move->held_us = view->clock->now_us;
    command(move, view, out, true);
}

static bool echoes(const kc_view_t *view, const double *q)
{
    double worst = 0.0;
    for (uint32_t j = 0u; j < view->tables->arm.n_joints; j++) {
        worst = kc_max(worst, kc_fabs(view->telemetry->arm.q_cmd[j] - q[j]));
    }
    return worst <= ECHO_TOL;
}

void kc_move_held(kc_move_t *move, const kc_view_t *view, kc_out_t *out)
{
    uint64_t passed_us = view->clock->now_us - move->held_us;
    if (move->holds == 0u || passed_us < (HOLDS_MAX + 1u - move->holds) * HOLD_AGAIN_US) { return; }
    move->holds--;
    bool ours = move->foreign || (move->start_us > 0u && echoes(view, move->q_target));
    if (!view->telemetry->arm.moving || !ours) { return; }
    if (move->holds == 0u) { kc_event(&out->events, KC_EVT_ARM_NOT_HELD, -1, (double)passed_us, 0.0); }
    command(move, view, out, true);
}

/* The guard's check, as far as it goes in this step; it records its reason to refuse, and the arm stays where it
 * is. Else the command is sent. */
static kc_outcome_t check(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out)
{
    static const kc_event_id_t event[] = {KC_EVT_NONE, KC_EVT_GRD_LIMIT, KC_EVT_GRD_PATH, KC_EVT_GRD_VOLUME,
                                          KC_EVT_GRD_SELF};
    const kc_active_t *a = view->tables;
    double bound[KC_JOINT_MAX];
    kc_ctx_t ctx;
    kc_move_bound(a, bound);
    kc_view_ctx(view, 0u, &ctx);
    kc_guard_request_t ask = {
        .arm = &a->arm,
        .terms = &a->terms,
        .coef = view->latest->coef,
        .space = &a->space,
        .ctx = &ctx,
        .q_from = move->q_from,
        .q_to = move->q_to,
        .from = move->from,
        .to = move->to,
        .bound = bound,
        .margin = a->config.servo.margin,
        .tol = a->config.arrive_tol,
    };
    if (!move->checking) {
        move->checking = true;
        kc_guard_begin(&ask, &move->check);
    }
    if (!kc_guard_step(&ask, &move->check, work)) { return kc_outcome(KC_OC_STAY); }
    move->checking = false;
    if (move->check.verdict != KC_GUARD_OK) {
        const kc_guard_reason_t *why = &move->check.why;
        kc_event(&out->events, event[move->check.verdict], why->index, why->got, why->want);
        return kc_outcome(KC_OC_SKIP);
    }
    memcpy(move->q_target, move->q_to, a->arm.n_joints * sizeof *move->q_to);
    memcpy(move->q_former, view->telemetry->arm.q_cmd, sizeof move->q_former);
    move->start_us = view->clock->now_us;
    move->near_us = 0u;
    move->holds = 0u;
    move->foreign = false;
    command(move, view, out, false);
    return kc_outcome(KC_OC_STAY);
}

kc_outcome_t kc_move_send(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out,
                          uint32_t from, uint32_t to, const double *q)
{
    move->checking = false;
    move->from = from;
    move->to = to;
    memcpy(move->q_from, view->telemetry->arm.q, sizeof move->q_from);
    memcpy(move->q_to, q, view->tables->arm.n_joints * sizeof *q);
    return check(move, view, work, out);
}

kc_outcome_t kc_move_near(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out,
                          const double *q)
{
    uint32_t node = KC_HUB_MAX + (uint32_t)view->cal->candidate;
    return kc_move_send(move, view, work, out, node, node, q);
}

/* Whether the arm is at its target; since when. */
static bool near(kc_move_t *move, const kc_view_t *view)
{
    bool there = kc_view_distance(view, move->q_target) <= view->tables->config.arrive_tol;
    if (!there) { move->near_us = 0u; }
    if (there && move->near_us == 0u) { move->near_us = view->telemetry->arm.t_us; }
    return there;
}

/* pass: it goes on from there, and need not be at rest, but must not run through: a command to go on would find it
 * beside its segment. Two messages at the target bound its speed. */
static kc_outcome_t wait(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out, bool pass)
{
    if (move->checking) { return check(move, view, work, out); }
    uint64_t took = view->clock->now_us - move->start_us;
    /* Its echo, so that an arm that has not begun a short move yet is not taken for one that has finished it. */
    bool heard = echoes(view, move->q_target), lost = !heard && echoes(view, move->q_former);
    bool there = near(move, view), stays = pass && view->telemetry->arm.t_us > move->near_us;
    if (heard && there && (stays || !view->telemetry->arm.moving)) { return kc_outcome(KC_OC_DONE); }
    if (took > view->tables->config.move_timeout_us) {
        kc_event(&out->events, KC_EVT_CAL_MOVE_TIMEOUT, KC_INPUT_ARM, (double)took, 0.0);
        return kc_abort_for(KC_CAUSE_ARM_LATE);
    }
    if (lost && view->clock->now_us - move->sent_us >= RESEND_US) { command(move, view, out, false); }
    return kc_outcome(KC_OC_STAY);
}

kc_outcome_t kc_move_wait(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out)
{
    return wait(move, view, work, out, false);
}

/* ---- where the arm is ---- */

void kc_move_bound(const kc_active_t *tables, double *bound)
{
    for (uint32_t j = 0u; j < tables->arm.n_joints; j++) {
        bound[j] = kc_min(tables->config.servo.bound, (double)tables->space.servo_bound[j]);
    }
}

void kc_move_box(const kc_active_t *tables, uint32_t cand, double *lo, double *hi)
{
    double seed[KC_JOINT_MAX], bound[KC_JOINT_MAX], margin = tables->config.servo.margin;
    kc_move_bound(tables, bound);
    kc_path_joints(&tables->space, KC_HUB_MAX + cand, seed);
    for (uint32_t j = 0u; j < tables->arm.n_joints; j++) {
        const kc_joint_t *jt = &tables->arm.joint[j];
        lo[j] = kc_max(seed[j] - bound[j], jt->q_min + margin);
        hi[j] = kc_min(seed[j] + bound[j], jt->q_max - margin);
    }
}

/* After an abort the arm may be between two nodes, on a verified segment: it may finish that segment. */
static bool on_segment(const kc_move_t *move, const kc_view_t *view)
{
    const kc_space_t *s = &view->tables->space;
    const double *q = view->telemetry->arm.q;
    double a[KC_JOINT_MAX], b[KC_JOINT_MAX], num = 0.0, den = 0.0;
    if (!kc_path_is_node(s, move->seg_from) || !kc_path_is_node(s, move->seg_to)) { return false; }
    kc_path_joints(s, move->seg_from, a);
    kc_path_joints(s, move->seg_to, b);
    for (uint32_t j = 0u; j < s->n_joints; j++) {
        num += (q[j] - a[j]) * (b[j] - a[j]);
        den += (b[j] - a[j]) * (b[j] - a[j]);
    }
    double t = den > 0.0 ? kc_clamp(num / den, 0.0, 1.0) : 0.0;
    for (uint32_t j = 0u; j < s->n_joints; j++) { a[j] += t * (b[j] - a[j]); }
    return kc_view_distance(view, a) <= SEGMENT_TOLS * view->tables->config.arrive_tol;
}

uint32_t kc_move_node(const kc_move_t *move, const kc_view_t *view, double *dist)
{
    const kc_active_t *a = view->tables;
    const double *q = view->telemetry->arm.q;
    double box[KC_JOINT_MAX];
    kc_move_bound(a, box);
    for (uint32_t j = 0u; j < a->arm.n_joints; j++) { box[j] += a->config.arrive_tol; }
    uint32_t node = kc_path_nearest(&a->space, box, q, dist);
    if (*dist <= 1.0) { return node; }
    if (on_segment(move, view)) { return move->seg_to; }
    /* After a restart the current segment is forgotten, but the table still holds it. */
    return kc_path_on_segment(&a->space, q, SEGMENT_TOLS * a->config.arrive_tol);
}

/* ---- MOVE ---- */

void kc_move_goal(const kc_space_t *space, uint32_t cand, kc_pose_t *T)
{
    const kc_cand_t *c = &space->cand[cand];
    double q[4];
    for (uint32_t i = 0u; i < 3u; i++) { T->p_m[i] = (double)c->p_m[i]; }
    for (uint32_t i = 0u; i < 4u; i++) { q[i] = (double)c->q_wxyz[i]; }
    (void)kc_quat_normalize(q); /* validated */
    kc_quat_to_R(q, T->R);
}

uint64_t kc_move_joints_cost(const kc_view_t *view, uint32_t n)
{
    return n * (kc_model_cost(&view->tables->arm, &view->tables->terms, view->latest->coef, false) + 10000u);
}

uint64_t kc_move_begin_cost(const kc_view_t *view)
{
    return kc_move_joints_cost(view, KC_MOVE_EVALS(IK_ITER_MAX));
}

uint32_t kc_move_joints(const kc_view_t *view, uint32_t cand, uint32_t iter_max, double *q)
{
    const kc_active_t *a = view->tables;
    const kc_servo_opt_t *s = &a->config.servo;
    kc_ik_opt_t opt = {iter_max, s->tol_pos_m, s->tol_rot_rad, s->margin, IK_STEP_MAX};
    double seed[KC_JOINT_MAX], bound[KC_JOINT_MAX];
    kc_pose_t goal;
    kc_eval_t eval;
    uint32_t n = 0u;
    kc_move_bound(a, bound);
    kc_move_goal(&a->space, cand, &goal);
    kc_path_joints(&a->space, KC_HUB_MAX + cand, seed);
    memcpy(q, seed, a->arm.n_joints * sizeof *q);
    if (kc_space_local(&a->space, cand)) { return n; }
    (void)kc_ik_solve(&a->arm, &a->terms, view->latest->coef, &goal, &opt, q, &eval, &n);
    for (uint32_t j = 0u; j < a->arm.n_joints; j++) {
        q[j] = kc_clamp(q[j], seed[j] - bound[j], seed[j] + bound[j]);
    }
    return n;
}

/* Stops made on the segment to the current candidate: those that CONFIG allows of those that the table has. A replicate
 * repeats the pose, not the way. */
static uint32_t n_stops(const kc_view_t *view)
{
    uint32_t n = kc_space_n_stops(&view->tables->space, (uint32_t)view->cal->candidate);
    uint32_t most = view->cal->replicate == 0 ? view->tables->config.stops_max : 0u;
    return most < n ? most : n;
}

/* Which stop of the table is stop k of those that are made: evenly among them. */
static uint32_t nth_stop(const kc_view_t *view, uint32_t k)
{
    uint32_t n = kc_space_n_stops(&view->tables->space, (uint32_t)view->cal->candidate);
    return (2u * k + 1u) * n / (2u * n_stops(view));
}

/* Stops are on the segment from the hub; a path may lead to the candidate from another one. */
static bool more_stops(const kc_move_t *move, const kc_view_t *view)
{
    uint32_t from = move->n_path > 1u ? move->path[move->n_path - 2u] : move->node;
    bool over_hub = from == view->tables->space.cand[view->cal->candidate].hub;
    return over_hub && move->i_stop < n_stops(view) && kc_plan_has_room(view->plan);
}

static bool has_stop(const kc_move_t *move, const kc_view_t *view)
{
    return move->seg_to == KC_HUB_MAX + (uint32_t)view->cal->candidate && more_stops(move, view);
}

/* To the next way point, or the next stop on the segment there; after the last one to the joints at the candidate. */
static kc_outcome_t send_leg(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out)
{
    const kc_space_t *s = &view->tables->space;
    uint32_t cand = (uint32_t)view->cal->candidate;
    double q[KC_JOINT_MAX];
    move->to_stop = false;
    if (move->i_path >= move->n_path) { return kc_move_near(move, view, work, out, move->q_final); }
    move->seg_from = (uint16_t)move->node;
    move->seg_to = move->path[move->i_path];
    kc_path_joints(s, move->seg_to, q);
    if (has_stop(move, view)) {
        kc_space_stop(s, cand, nth_stop(view, move->i_stop++), q);
        move->to_stop = true;
    }
    return kc_move_send(move, view, work, out, move->seg_from, move->seg_to, q);
}

/* A replicate is approached again over its hub, so that it also repeats the effects of the move. */
static kc_status_t plan(const kc_view_t *view, uint32_t node, uint16_t *path, uint32_t *n)
{
    const kc_space_t *s = &view->tables->space;
    uint32_t cand = (uint32_t)view->cal->candidate;
    if (view->cal->replicate == 0) { return kc_path_plan(s, node, KC_HUB_MAX + cand, path, n); }
    kc_status_t st = kc_path_plan(s, node, s->cand[cand].hub, path, n);
    if (st == KC_OK) { path[(*n)++] = (uint16_t)(KC_HUB_MAX + cand); }
    return st;
}

kc_outcome_t kc_move_begin(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out)
{
    const kc_active_t *a = view->tables;
    double dist = 0.0, seed[KC_JOINT_MAX];
    uint32_t node = kc_move_node(move, view, &dist), n = 0u;
    if (node == KC_NODE_NONE) {
        kc_event(&out->events, KC_EVT_CAL_NO_PATH, view->cal->candidate, dist, 1.0);
        return kc_abort_for(KC_CAUSE_NO_PATH);
    }
    kc_path_joints(&a->space, node, seed);
    uint32_t first = kc_view_distance(view, seed) > a->config.arrive_tol ? 1u
                                                                         : 0u; /* segments begin at seeds */
    if (plan(view, node, &move->path[first], &n) != KC_OK) {
        kc_event(&out->events, KC_EVT_CAL_NO_PATH, view->cal->candidate, dist, 1.0);
        return kc_outcome(KC_OC_SKIP);
    }
    move->path[0] = first ? (uint16_t)node : move->path[0];
    move->node = node;
    move->n_path = n + first;
    move->i_path = 0u;
    move->i_stop = 0u;
    (void)kc_move_joints(view, (uint32_t)view->cal->candidate, IK_ITER_MAX, move->q_final);
    return kc_outcome(send_leg(move, view, work, out).id == KC_OC_STAY ? KC_OC_DONE : KC_OC_SKIP);
}

kc_outcome_t kc_move_run(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out)
{
    const bool pass = !move->to_stop && move->i_path < move->n_path; /* a way point */
    kc_outcome_t arrived = wait(move, view, work, out, pass);
    if (arrived.id != KC_OC_DONE || !pass) { return arrived; }
    move->node = move->path[move->i_path++];
    return send_leg(move, view, work, out);
}

void kc_move_next_view(const kc_move_t *move, const kc_view_t *view, double *q)
{
    memcpy(q, move->to_stop ? move->q_to : move->q_final, sizeof move->q_to);
    if (move->to_stop || !more_stops(move, view)) { return; }
    kc_space_stop(&view->tables->space, (uint32_t)view->cal->candidate, nth_stop(view, move->i_stop), q);
}

bool kc_move_stopped(const kc_move_t *move) { return move->to_stop; }

kc_outcome_t kc_move_onward(kc_move_t *move, const kc_view_t *view, kc_work_t *work, kc_out_t *out)
{
    return kc_outcome(send_leg(move, view, work, out).id == KC_OC_STAY ? KC_OC_DONE : KC_OC_SKIP);
}
