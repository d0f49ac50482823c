/* MOVE, AIM, SETTLE. The arm only moves along verified segments, and within the servo bound around a
 * candidate's seed; the pan-tilt unit points where the corrected arm is expected. */
#include <string.h>

#include "kc_app_priv.h"
#include "kc_guard.h"
#include "kc_ik.h"
#include "kc_libm.h"

#define IK_ITER_MAX 60u
#define IK_STEP_MAX 0.3

/* ---- arm commands ---- */

static void command(kc_app_t *app, kc_out_t *out, uint8_t hold)
{
    kc_arm_cmd_t *c = &out->arm_cmd;
    out->has_arm_cmd = 1u;
    c->seq = ++app->arm_seq;
    c->n_joints = app->tables.active.arm.n_joints;
    c->hold = hold;
    c->speed_scale = hold ? 1.0 : app->tables.active.config.speed_scale;
    memcpy(c->q, hold ? app->arm.q : app->leg.q_target, sizeof c->q);
    app->leg.sent_us = app->now_us;
}

void kc_move_hold(kc_app_t *app, kc_out_t *out) { command(app, out, 1u); }

/* If the guard refuses the move: record its reason and skip the candidate; the arm stays where it is. */
static int refused(kc_app_t *app, kc_out_t *out, uint32_t from, uint32_t to, const double *q)
{
    static const kc_event_id_t event[] = {KC_EVT_NONE, KC_EVT_GRD_LIMIT, KC_EVT_GRD_PATH, KC_EVT_GRD_VOLUME,
                                          KC_EVT_GRD_SELF};
    const kc_active_t *a = &app->tables.active;
    double bound[KC_JOINT_MAX];
    kc_ctx_t ctx;
    kc_guard_reason_t why;
    kc_move_bound(app, bound);
    kc_update_ctx(app, 0u, &ctx);
    kc_guard_request_t ask = {
        .arm = &a->arm,
        .terms = &a->terms,
        .coef = app->cal.coef,
        .space = &a->space,
        .ctx = &ctx,
        .q_from = app->arm.q,
        .q_to = q,
        .from = from,
        .to = to,
        .bound = bound,
        .margin = a->config.servo.margin,
        .tol = a->config.arrive_tol,
    };
    kc_guard_verdict_t verdict = kc_guard_check(&ask, &why);
    if (verdict == KC_GUARD_OK) { return 0; }
    kc_event(&out->events, event[verdict], why.index, why.got, why.want);
    kc_observe_skip(app, out);
    return 1;
}

int kc_move_send(kc_app_t *app, kc_out_t *out, uint32_t from, uint32_t to, const double *q)
{
    if (refused(app, out, from, to, q)) { return 0; }
    memcpy(app->leg.q_target, q, app->tables.active.arm.n_joints * sizeof *q);
    app->leg.start_us = app->now_us;
    command(app, out, 0u);
    return 1;
}

int kc_move_near(kc_app_t *app, kc_out_t *out, const double *q)
{
    uint32_t node = KC_HUB_MAX + (uint32_t)app->cal.candidate;
    return kc_move_send(app, out, node, node, q);
}

static double joint_dist(const double *a, const double *b, uint32_t n)
{
    double worst = 0.0;
    for (uint32_t j = 0u; j < n; j++) { worst = kc_max(worst, kc_fabs(a[j] - b[j])); }
    return worst;
}

double kc_move_dist(const kc_app_t *app, const double *q)
{
    return joint_dist(app->arm.q, q, app->tables.active.arm.n_joints);
}

/* The controller echoes its target, so that an arm that has not begun a short move yet is not taken for
 * one that has finished it. */
static int echoed(const kc_app_t *app)
{
    return joint_dist(app->arm.q_cmd, app->leg.q_target, app->tables.active.arm.n_joints) <= KC_ECHO_TOL;
}

int kc_move_arrived(const kc_app_t *app)
{
    return echoed(app) && !app->arm.moving &&
           kc_move_dist(app, app->leg.q_target) <= app->tables.active.config.arrive_tol;
}

int kc_move_late(kc_app_t *app, kc_out_t *out)
{
    uint64_t took = app->now_us - app->leg.start_us;
    if (took > app->tables.active.config.move_timeout_us) {
        kc_event(&out->events, KC_EVT_CAL_MOVE_TIMEOUT, KC_INPUT_ARM, (double)took, 0.0);
        kc_app_abort(app, out, KC_CAUSE_ARM_LATE);
        return 1;
    }
    if (!echoed(app) && app->now_us - app->leg.sent_us >= KC_RESEND_US) { command(app, out, 0u); }
    return 0;
}

/* ---- where the arm is ---- */

/* Largest distance from a segment, in arrival tolerances: outside nodes nothing but the segments is
 * verified. */
#define SEGMENT_TOLS 2.0

void kc_move_bound(const kc_app_t *app, double *bound)
{
    const kc_active_t *a = &app->tables.active;
    for (uint32_t j = 0u; j < a->arm.n_joints; j++) {
        bound[j] = kc_min(a->config.servo.bound, (double)a->space.servo_bound[j]);
    }
}

void kc_move_box(const kc_app_t *app, uint32_t cand, double *lo, double *hi)
{
    const kc_active_t *a = &app->tables.active;
    double seed[KC_JOINT_MAX], bound[KC_JOINT_MAX];
    kc_move_bound(app, bound);
    kc_path_joints(&a->space, KC_HUB_MAX + cand, seed);
    for (uint32_t j = 0u; j < a->arm.n_joints; j++) {
        const kc_joint_t *jt = &a->arm.joint[j];
        lo[j] = kc_max(seed[j] - bound[j], jt->q_min + a->config.servo.margin);
        hi[j] = kc_min(seed[j] + bound[j], jt->q_max - a->config.servo.margin);
    }
}

/* After an abort the arm may be between two nodes, on a verified segment: it may finish that segment. */
static int on_segment(const kc_app_t *app)
{
    const kc_space_t *s = &app->tables.active.space;
    double a[KC_JOINT_MAX], b[KC_JOINT_MAX], num = 0.0, den = 0.0;
    if (!kc_path_is_node(s, app->leg.seg_from) || !kc_path_is_node(s, app->leg.seg_to)) { return 0; }
    kc_path_joints(s, app->leg.seg_from, a);
    kc_path_joints(s, app->leg.seg_to, b);
    for (uint32_t j = 0u; j < s->n_joints; j++) {
        num += (app->arm.q[j] - a[j]) * (b[j] - a[j]);
        den += (b[j] - a[j]) * (b[j] - a[j]);
    }
    double t = den > 0.0 ? kc_clamp(num / den, 0.0, 1.0) : 0.0;
    for (uint32_t j = 0u; j < s->n_joints; j++) { a[j] += t * (b[j] - a[j]); }
    return kc_move_dist(app, a) <= SEGMENT_TOLS * app->tables.active.config.arrive_tol;
}

uint32_t kc_move_node(const kc_app_t *app, double *dist)
{
    const kc_active_t *a = &app->tables.active;
    double box[KC_JOINT_MAX];
    kc_move_bound(app, box);
    for (uint32_t j = 0u; j < a->arm.n_joints; j++) { box[j] += a->config.arrive_tol; }
    uint32_t node = kc_path_nearest(&a->space, box, app->arm.q, dist);
    if (*dist <= 1.0) { return node; }
    if (on_segment(app)) { return app->leg.seg_to; }
    /* After a restart the current segment is forgotten, but the table still holds it. */
    return kc_path_on_segment(&a->space, app->arm.q, SEGMENT_TOLS * a->config.arrive_tol);
}

/* ---- MOVE ---- */

void kc_move_goal(const kc_app_t *app, uint32_t cand, kc_pose_t *T)
{
    const kc_cand_t *c = &app->tables.active.space.cand[cand];
    double q[4];
    for (uint32_t i = 0u; i < 3u; i++) { T->p_m[i] = (double)c->p_m[i]; }
    for (uint32_t i = 0u; i < 4u; i++) { q[i] = (double)c->q_wxyz[i]; }
    (void)kc_quat_normalize(q); /* validated */
    kc_quat_to_R(q, T->R);
}

void kc_move_joints(kc_app_t *app, uint32_t cand, uint32_t iter_max, double *q)
{
    const kc_active_t *a = &app->tables.active;
    const kc_servo_opt_t *s = &a->config.servo;
    kc_ik_opt_t opt = {iter_max, s->tol_pos_m, s->tol_rot_rad, s->margin, IK_STEP_MAX};
    double seed[KC_JOINT_MAX], bound[KC_JOINT_MAX];
    kc_pose_t goal;
    kc_move_bound(app, bound);
    kc_move_goal(app, cand, &goal);
    kc_path_joints(&a->space, KC_HUB_MAX + cand, seed);
    memcpy(q, seed, a->arm.n_joints * sizeof *q);
    if (kc_space_local(&a->space, cand)) { return; }
    (void)kc_ik_solve(&a->arm, &a->terms, app->cal.coef, &goal, &opt, q, &app->eval);
    for (uint32_t j = 0u; j < a->arm.n_joints; j++) {
        q[j] = kc_clamp(q[j], seed[j] - bound[j], seed[j] + bound[j]);
    }
}

static int send_leg(kc_app_t *app, kc_out_t *out)
{
    kc_leg_t *l = &app->leg;
    double q[KC_JOINT_MAX];
    if (l->i_path < l->n_path) {
        l->seg_from = (uint16_t)l->node;
        l->seg_to = l->path[l->i_path];
        app->journal_due = 1u;
        kc_path_joints(&app->tables.active.space, l->path[l->i_path], q);
        return kc_move_send(app, out, l->seg_from, l->seg_to, q);
    }
    return kc_move_near(app, out, l->q_final);
}

/* Turn the pan-tilt unit to where the corrected arm is expected at q, with the offset measured at this
 * candidate. */
static void expect(kc_app_t *app, const double *q, double p[3])
{
    const kc_active_t *a = &app->tables.active;
    kc_ctx_t ctx;
    kc_loads_t loads;
    kc_update_ctx(app, 0u, &ctx);
    memcpy(ctx.q, q, a->arm.n_joints * sizeof *q);
    kc_model_loads(&a->arm, &a->terms, app->cal.coef, &ctx, &loads);
    kc_model_eval(&a->arm, &a->terms, app->cal.coef, &ctx, &loads, 0, &app->eval);
    for (uint32_t i = 0u; i < 3u; i++) { p[i] = app->eval.T.p_m[i] + app->observe.off_m[i]; }
}

/* A replicate is approached again over its hub, so that it also repeats the effects of the move. */
static kc_status_t plan(const kc_app_t *app, uint32_t node, uint32_t cand, uint16_t *path, uint32_t *n)
{
    const kc_space_t *s = &app->tables.active.space;
    if (app->cal.replicate == 0) { return kc_path_plan(s, node, KC_HUB_MAX + cand, path, n); }
    kc_status_t st = kc_path_plan(s, node, s->cand[cand].hub, path, n);
    if (st == KC_OK) { path[(*n)++] = (uint16_t)(KC_HUB_MAX + cand); }
    return st;
}

kc_status_t kc_move_begin(kc_app_t *app, kc_out_t *out, uint32_t cand)
{
    const kc_active_t *a = &app->tables.active;
    kc_leg_t *l = &app->leg;
    double dist = 0.0, p[3], pan = 0.0, tilt = 0.0, seed[KC_JOINT_MAX];
    uint32_t node = kc_move_node(app, &dist), n = 0u;
    if (node == KC_NODE_NONE) {
        kc_event(&out->events, KC_EVT_CAL_NO_PATH, (int32_t)cand, dist, 1.0);
        return KC_ERR_STATE;
    }
    kc_path_joints(&a->space, node, seed);
    uint32_t first = kc_move_dist(app, seed) > a->config.arrive_tol ? 1u : 0u; /* segments begin at seeds */
    kc_status_t st = plan(app, node, cand, &l->path[first], &n);
    if (st != KC_OK) {
        kc_event(&out->events, KC_EVT_CAL_NO_PATH, (int32_t)cand, dist, 1.0);
        return st;
    }
    l->path[0] = first ? (uint16_t)node : l->path[0];
    l->node = node;
    l->n_path = n + first;
    l->i_path = 0u;
    memset(app->observe.off_m, 0, sizeof app->observe.off_m);
    l->approach = 0u;
    app->observe.detected_here = 0u;
    app->observe.retreat = 0u;
    app->observe.at_seed = 0u;
    kc_servo_forget(&app->observe.servo);
    kc_move_joints(app, cand, IK_ITER_MAX, l->q_final);
    kc_app_enter(app, KC_ST_MOVE);
    if (!send_leg(app, out)) { return KC_OK; } /* skipped already; the next step chooses another one */
    expect(app, l->q_final, p); /* the pan-tilt unit may turn meanwhile */
    (void)kc_camera_aim(&a->camera, p, &pan, &tilt);
    kc_move_pantilt(app, out, pan, tilt);
    return KC_OK;
}

int kc_move_run(kc_app_t *app, kc_out_t *out)
{
    kc_leg_t *l = &app->leg;
    if (!kc_move_arrived(app)) {
        (void)kc_move_late(app, out);
        return 0;
    }
    if (l->i_path < l->n_path) {
        l->node = l->path[l->i_path++];
        return !send_leg(app, out);
    }
    app->observe.pantilt_sent = 0u;
    app->observe.searched = 0u;
    kc_app_enter(app, KC_ST_AIM);
    return 1;
}

/* ---- pan-tilt unit ---- */

void kc_move_pantilt(kc_app_t *app, kc_out_t *out, double pan_rad, double tilt_rad)
{
    const kc_camera_t *c = &app->tables.active.camera;
    kc_observe_t *k = &app->observe;
    k->pan_rad = kc_clamp(pan_rad, c->pan_min_rad, c->pan_max_rad);
    k->tilt_rad = kc_clamp(tilt_rad, c->tilt_min_rad, c->tilt_max_rad);
    k->pantilt_us = app->now_us;
    out->has_pantilt_cmd = 1u;
    out->pantilt_cmd = (kc_pantilt_cmd_t){++app->pantilt_seq, k->pan_rad, k->tilt_rad};
}

static double pantilt_error(const kc_app_t *app)
{
    return kc_max(kc_fabs(app->pantilt.pan_rad - app->observe.pan_rad),
                  kc_fabs(app->pantilt.tilt_rad - app->observe.tilt_rad));
}

int kc_move_pantilt_there(const kc_app_t *app)
{
    return !app->pantilt.moving && pantilt_error(app) <= KC_PANTILT_TOL_RAD;
}

int kc_move_aim(kc_app_t *app, kc_out_t *out)
{
    kc_observe_t *k = &app->observe;
    double p[3];
    if (!k->pantilt_sent) {
        double pan = 0.0, tilt = 0.0;
        expect(app, app->arm.q, p);
        (void)kc_camera_aim(&app->tables.active.camera, p, &pan,
                            &tilt); /* cut off by a limit: best there is */
        kc_move_pantilt(app, out, pan, tilt);
        k->base_pan_rad = k->pan_rad;
        k->base_tilt_rad = k->tilt_rad;
        k->pantilt_sent = 1u;
    }
    if (kc_move_pantilt_there(app)) {
        kc_move_settle(app, KC_ST_OBSERVE);
        return 1;
    }
    if (app->now_us - app->state_us > app->tables.active.config.move_timeout_us) {
        kc_event(&out->events, KC_EVT_CAL_MOVE_TIMEOUT, KC_INPUT_PANTILT,
                 (double)(app->now_us - app->state_us), pantilt_error(app));
        kc_app_abort(app, out, KC_CAUSE_PANTILT_LATE);
    } else if (!app->pantilt.moving && app->now_us - k->pantilt_us >= KC_RESEND_US) {
        kc_move_pantilt(app, out, k->pan_rad, k->tilt_rad); /* the command was lost */
    }
    return 0;
}

/* ---- SETTLE ---- */

void kc_move_settle(kc_app_t *app, kc_state_t after)
{
    app->observe.after = (uint8_t)after;
    app->leg.resting = 0u;
    kc_app_enter(app, KC_ST_SETTLE);
}

int kc_move_settled(kc_app_t *app, kc_out_t *out)
{
    kc_leg_t *l = &app->leg;
    const kc_config_t *c = &app->tables.active.config;
    if (app->arm.moving || app->pantilt.moving) {
        l->resting = 0u;
    } else if (!l->resting) {
        l->resting = 1u;
        l->rest_us = app->now_us;
    }
    if (l->resting && app->now_us - l->rest_us >= c->settle_us) {
        if (app->observe.after == (uint8_t)KC_ST_OBSERVE) { kc_observe_begin(app); }
        kc_app_enter(app, (kc_state_t)app->observe.after);
        return 1;
    }
    if (app->now_us - app->state_us > c->settle_us + c->move_timeout_us) {
        kc_event(&out->events, KC_EVT_CAL_MOVE_TIMEOUT, app->pantilt.moving ? KC_INPUT_PANTILT : KC_INPUT_ARM,
                 (double)(app->now_us - app->state_us), 0.0);
        kc_app_abort(app, out, app->pantilt.moving ? KC_CAUSE_PANTILT_LATE : KC_CAUSE_ARM_LATE);
    }
    return 0;
}
