/* OBSERVE, SERVO, SEARCH: frames, planar flip, visual servo, pan-tilt search along a spiral. */
#include <string.h>

#include "kc_app_priv.h"
#include "kc_libm.h"
#include "kc_vec.h"

#define SEARCH_SAFETY 2.0 /* factor of the last residual up to which the next pose may be off */

/* ---- frames ---- */

void kc_observe_begin(kc_app_t *app)
{
    app->observe.fails = 0u;
    app->observe.waiting = 0u;
    app->observe.got = 0u;
}

static void ask(kc_app_t *app, kc_out_t *out)
{
    out->has_frame_request = 1u;
    out->frame_seq = ++app->observe.frame_seq;
    app->observe.requested_us = app->now_us;
    app->observe.waiting = 1u;
}

static int once_more(kc_app_t *app, kc_out_t *out)
{
    if (app->observe.fails++ >= app->tables.active.config.frame_retries) { return 0; }
    ask(app, out);
    return 1;
}

kc_observe_result_t kc_observe_poll(kc_app_t *app, kc_out_t *out)
{
    kc_observe_t *k = &app->observe;
    if (k->got) {
        k->got = 0u;
        if (k->det.n_tags == 0u) { return KC_OBSERVE_NO_TAGS; }
        if (!k->unsure) { return KC_OBSERVE_DETECTED; }
        return once_more(app, out) ? KC_OBSERVE_WAIT : KC_OBSERVE_UNCERTAIN;
    }
    if (!k->waiting) {
        ask(app, out);
        return KC_OBSERVE_WAIT;
    }
    uint64_t took = app->now_us - k->requested_us;
    if (took <= app->tables.active.config.frame_timeout_us) { return KC_OBSERVE_WAIT; }
    kc_event(&out->events, KC_EVT_CAL_FRAME_TIMEOUT, -1, (double)took, 0.0);
    if (once_more(app, out)) { return KC_OBSERVE_WAIT; }
    k->waiting = 0u;
    return KC_OBSERVE_TIMEOUT;
}

void kc_observe_skip(kc_app_t *app, kc_out_t *out)
{
    kc_event(&out->events, KC_EVT_CAL_CAND_SKIPPED, app->cal.candidate, 0.0, 0.0);
    app->cal.usable[app->cal.candidate] = 0u;
    app->cal.n_rejected++;
    app->cal.up = KC_UP_SELECT;
    kc_app_enter(app, KC_ST_UPDATE);
}

/* ---- from a frame to an observation ---- */

/* Covariance from camera to base axes: both blocks turn with R. */
static void turn_cov(const double R[9], const double C[36], double out[36])
{
    for (uint32_t i = 0u; i < 6u; i++) {
        for (uint32_t j = 0u; j < 6u; j++) {
            const double *ri = &R[3u * (i % 3u)], *rj = &R[3u * (j % 3u)];
            const uint32_t bi = 3u * (i / 3u), bj = 3u * (j / 3u);
            double s = 0.0;
            for (uint32_t a = 0u; a < 3u; a++) {
                for (uint32_t b = 0u; b < 3u; b++) { s += ri[a] * C[6u * (bi + a) + bj + b] * rj[b]; }
            }
            out[6u * i + j] = s;
        }
    }
}

static void fill_ctx(const kc_app_t *app, const kc_detection_t *det, const kc_arm_state_t *arm,
                     const kc_pantilt_state_t *pantilt, kc_ctx_t *c)
{
    const kc_camera_t *cam = &app->tables.active.camera;
    memset(c, 0, sizeof *c);
    memcpy(c->q, arm->q, sizeof c->q);
    memcpy(c->dir, arm->dir, sizeof c->dir);
    memcpy(c->qdot, arm->dq, sizeof c->qdot);
    kc_v3_copy(arm->g_m_s2, c->g_m_s2);
    c->temp_c = arm->temp_c;
    c->t_s = (double)app->now_us * 1e-6;
    c->payload_kg = arm->payload_kg;
    c->range_m = det->range_m;
    c->incid_rad = det->incid_rad;
    c->u_norm = (det->u_px - cam->cx_px) / cam->fx_px;
    c->v_norm = (det->v_px - cam->cy_px) / cam->fy_px;
    c->pan_rad = pantilt->pan_rad;
    c->tilt_rad = pantilt->tilt_rad;
}

void kc_observe_obs(const kc_app_t *app, const double p_cam_m[3], const double q_cam[4],
                    const kc_detection_t *det, const kc_arm_state_t *arm, const kc_pantilt_state_t *pantilt,
                    kc_obs_t *obs)
{
    kc_pose_t T_cam, T;
    memset(obs, 0, sizeof *obs);
    kc_camera_pose(&app->tables.active.camera, pantilt->pan_rad, pantilt->tilt_rad, &T_cam);
    kc_v3_copy(p_cam_m, T.p_m);
    kc_quat_to_R(q_cam, T.R);
    kc_pose_mul(&T_cam, &T, &T);
    kc_v3_copy(T.p_m, obs->p_m);
    kc_R_to_quat(T.R, obs->q_wxyz);
    turn_cov(T_cam.R, det->cov, obs->cov);
    kc_v3_copy(T_cam.p_m, obs->p_cam_m);
    kc_R_to_quat(T_cam.R, obs->q_cam_wxyz);
    obs->has_rot = 1u;
    obs->has_cam = 1u;
    fill_ctx(app, det, arm, pantilt, &obs->ctx);
    kc_v3_copy(p_cam_m, obs->ctx.p_cam_tool_m);
}

/* Residual of a frame with coefficients coef; leaves the model's pose in app->eval.T. */
static void residual(kc_app_t *app, const double *coef, const double p[3], const double q[4],
                     const kc_detection_t *det, double r[6])
{
    const kc_active_t *a = &app->tables.active;
    kc_obs_t obs;
    kc_loads_t loads;
    kc_observe_obs(app, p, q, det, &app->arm, &app->pantilt, &obs);
    kc_model_loads(&a->arm, &a->terms, coef, &obs.ctx, &loads);
    (void)kc_model_residual(&a->arm, &a->terms, coef, &obs, &loads, r, &app->eval);
}

static void swap_solutions(kc_detection_t *d)
{
    kc_detection_t s = *d;
    memcpy(d->p_cam_tool_m, s.p_alt_m, sizeof d->p_cam_tool_m);
    memcpy(d->q_cam_tool_wxyz, s.q_alt_wxyz, sizeof d->q_cam_tool_wxyz);
    memcpy(d->p_alt_m, s.p_cam_tool_m, sizeof d->p_alt_m);
    memcpy(d->q_alt_wxyz, s.q_cam_tool_wxyz, sizeof d->q_alt_wxyz);
    d->rms_px = s.rms_alt_px;
    d->rms_alt_px = s.rms_px;
}

/* The second solution is taken if its reprojection is about as good, and if it is nearer in angle to the
 * prediction of the corrected model than the first one, and near enough for that prediction to be trusted. */
void kc_observe_unflip(kc_app_t *app, const double *coef, kc_detection_t *d)
{
    double r1[6], r2[6];
    if (d->n_tags == 0u || d->rms_alt_px > KC_FLIP_RMS_FACTOR * d->rms_px) { return; }
    residual(app, coef, d->p_cam_tool_m, d->q_cam_tool_wxyz, d, r1);
    residual(app, coef, d->p_alt_m, d->q_alt_wxyz, d, r2);
    double a2 = kc_v3_norm(&r2[3]);
    if (a2 < kc_v3_norm(&r1[3]) && a2 <= KC_FLIP_TRUST_RAD) { swap_solutions(d); }
}

/* Measured tool pose in the base frame, camera-side corrections applied: model plus residual. */
static void take_detection(kc_app_t *app)
{
    kc_observe_t *k = &app->observe;
    double r[6], E[9];
    residual(app, app->cal.coef, k->det.p_cam_tool_m, k->det.q_cam_tool_wxyz, &k->det, r);
    k->predicted = app->eval.T;
    kc_R_exp(&r[3], E);
    kc_m3_mul(E, k->predicted.R, k->measured.R);
    kc_v3_add_scaled(k->predicted.p_m, 1.0, r, k->measured.p_m);
    kc_v3_copy(r, k->off_m);
    memcpy(k->q_detected, app->arm.q, sizeof k->q_detected);
    k->detected_here = 1u;
}

/* ---- OBSERVE and SERVO ---- */

static int measure(kc_app_t *app, kc_out_t *out)
{
    if (kc_approach_begin(app, out)) { return 0; }
    kc_measure_begin(app);
    kc_app_enter(app, KC_ST_MEASURE);
    return 1;
}

/* The servo cannot get nearer: the pose is measured where the arm is, since any pose with the tags in view
 * serves. */
static int measure_beside(kc_app_t *app, kc_out_t *out, const kc_pose_t *goal)
{
    double d[3];
    kc_v3_sub(goal->p_m, app->observe.measured.p_m, d);
    kc_event(&out->events, KC_EVT_CAL_SERVO_LIMIT, app->cal.candidate, (double)app->cal.servo_steps,
             kc_v3_norm(d));
    return measure(app, out);
}

static int servo(kc_app_t *app, kc_out_t *out)
{
    const kc_active_t *a = &app->tables.active;
    kc_pose_t goal;
    double q_cmd[KC_JOINT_MAX] = {0.0}, seed[KC_JOINT_MAX], bound[KC_JOINT_MAX];
    kc_move_bound(app, bound);
    kc_move_goal(app, (uint32_t)app->cal.candidate, &goal);
    kc_path_joints(&a->space, KC_HUB_MAX + (uint32_t)app->cal.candidate, seed);
    kc_servo_result_t res = kc_servo_step(&a->arm, &a->terms, app->cal.coef, &app->observe.measured, &goal,
                                          app->arm.q, seed, bound, &a->config.servo, q_cmd, &app->eval,
                                          &app->observe.servo);
    if (res == KC_SERVO_THERE) { return measure(app, out); }
    if (res == KC_SERVO_STUCK || app->observe.retreat || app->cal.servo_steps >= a->config.servo_steps_max) {
        return measure_beside(app, out, &goal);
    }
    app->cal.servo_steps++;
    if (!kc_move_near(app, out, q_cmd)) { return 1; }
    kc_app_enter(app, KC_ST_SERVO);
    return 0;
}

/* The servo lost the tags (turned away, or hidden): return to where they were detected last, and measure
 * there. */
static int retreat(kc_app_t *app, kc_out_t *out)
{
    app->observe.retreat = 1u;
    if (!kc_move_near(app, out, app->observe.q_detected)) { return 1; }
    kc_app_enter(app, KC_ST_SERVO);
    return 0;
}

static int lost(kc_app_t *app, kc_out_t *out)
{
    if (app->observe.detected_here && !app->observe.retreat) { return retreat(app, out); }
    kc_event(&out->events, KC_EVT_CAL_TAGS_LOST, app->cal.candidate, (double)app->observe.i_search, 0.0);
    kc_observe_skip(app, out);
    return 1;
}

static int next_search(kc_app_t *app, kc_out_t *out);

/* No tags at the joints that the correction predicts: the correction may still be wrong. On the nominal
 * arm the tags are in view at the seed, so it is tried before the pan-tilt unit searches. */
static int try_seed(kc_app_t *app, kc_out_t *out)
{
    double seed[KC_JOINT_MAX];
    if (app->observe.at_seed || app->observe.detected_here) { return 0; }
    app->observe.at_seed = 1u;
    kc_path_joints(&app->tables.active.space, KC_HUB_MAX + (uint32_t)app->cal.candidate, seed);
    if (kc_move_dist(app, seed) <= app->tables.active.config.servo.step_max) { return 0; }
    if (kc_move_near(app, out, seed)) { kc_app_enter(app, KC_ST_SERVO); }
    return 1;
}

static int begin_search(kc_app_t *app, kc_out_t *out)
{
    if (try_seed(app, out)) { return 0; }
    /* Detected once and lost again: not for want of a better pan-tilt direction. */
    if (app->observe.searched || app->observe.detected_here) {
        app->observe.i_search = 0u;
        return lost(app, out);
    }
    app->observe.searched = 1u;
    app->observe.i_search = 0u;
    kc_app_enter(app, KC_ST_SEARCH);
    return next_search(app, out);
}

int kc_observe_run(kc_app_t *app, kc_out_t *out)
{
    switch (kc_observe_poll(app, out)) {
    case KC_OBSERVE_DETECTED:
        take_detection(app);
        return kc_space_local(&app->tables.active.space, (uint32_t)app->cal.candidate) ? measure(app, out)
                                                                                       : servo(app, out);
    case KC_OBSERVE_NO_TAGS: return begin_search(app, out);
    case KC_OBSERVE_UNCERTAIN: kc_observe_skip(app, out); return 1;
    case KC_OBSERVE_TIMEOUT: kc_app_abort(app, out, KC_CAUSE_CAMERA); return 0;
    default: return 0;
    }
}

int kc_observe_servo(kc_app_t *app, kc_out_t *out)
{
    if (!kc_move_arrived(app)) {
        (void)kc_move_late(app, out);
        return 0;
    }
    if (kc_approach_arrived(app, out)) { return 0; }
    app->observe.pantilt_sent = 0u;
    app->observe.searched = 0u;
    kc_app_enter(app, KC_ST_AIM);
    return 1;
}

/* ---- SEARCH ---- */

/* Square spiral around the expected direction: position i >= 1, in units of the step. */
static void spiral(uint32_t i, double *x, double *y)
{
    int32_t cx = 0, cy = 0, dx = 0, dy = -1;
    for (uint32_t k = 0u; k < i; k++) { /* i <= config.search_steps <= 49 */
        if (cx == cy || (cx < 0 && cx == -cy) || (cx > 0 && cx == 1 - cy)) {
            int32_t t = dx;
            dx = -dy;
            dy = t;
        }
        cx += dx;
        cy += dy;
    }
    *x = (double)cx;
    *y = (double)cy;
}

static int inside(const kc_camera_t *c, double pan, double tilt)
{
    return pan >= c->pan_min_rad && pan <= c->pan_max_rad && tilt >= c->tilt_min_rad &&
           tilt <= c->tilt_max_rad;
}

/* Number of search positions: all of them before the first measurement; later as many as the last residual
 * makes necessary. Tags that should be in the middle of the image and are not detected there are hidden or
 * turned away, and no pan-tilt direction helps. */
static uint32_t search_limit(const kc_app_t *app)
{
    const kc_camera_t *cam = &app->tables.active.camera;
    const kc_config_t *c = &app->tables.active.config;
    if (app->cal.n_meas == 0u) { return c->search_steps; }
    double half = kc_atan2(0.5 * (double)cam->height_px, cam->fy_px);
    double off = SEARCH_SAFETY * kc_atan2(app->cal.res_pos_m, app->cal.range_m) - 0.5 * half;
    double rings = kc_floor(kc_max(0.0, off) / c->search_step_rad + 0.999);
    double cells = (2.0 * rings + 1.0) * (2.0 * rings + 1.0) - 1.0;
    return cells < (double)c->search_steps ? (uint32_t)cells : c->search_steps;
}

static int next_search(kc_app_t *app, kc_out_t *out)
{
    const kc_active_t *a = &app->tables.active;
    kc_observe_t *k = &app->observe;
    while (k->i_search < search_limit(app)) {
        double x = 0.0, y = 0.0;
        spiral(++k->i_search, &x, &y);
        double pan = k->base_pan_rad + x * a->config.search_step_rad;
        double tilt = k->base_tilt_rad + y * a->config.search_step_rad;
        if (!inside(&a->camera, pan, tilt)) { continue; }
        kc_move_pantilt(app, out, pan, tilt);
        k->turning = 1u;
        app->state_us = app->now_us;
        return 0;
    }
    return lost(app, out);
}

/* Pan-tilt unit turns to the next search position; 1 when it is at rest there. */
static int turned(kc_app_t *app, kc_out_t *out)
{
    uint64_t took = app->now_us - app->state_us;
    if (kc_move_pantilt_there(app)) { return 1; }
    if (took > app->tables.active.config.move_timeout_us) {
        kc_event(&out->events, KC_EVT_CAL_MOVE_TIMEOUT, KC_INPUT_PANTILT, (double)took, 0.0);
        kc_app_abort(app, out, KC_CAUSE_PANTILT_LATE);
    } else if (!app->pantilt.moving && app->now_us - app->observe.pantilt_us >= KC_RESEND_US) {
        kc_move_pantilt(app, out, app->observe.pan_rad, app->observe.tilt_rad);
    }
    return 0;
}

int kc_observe_search(kc_app_t *app, kc_out_t *out)
{
    if (app->observe.turning) {
        if (!turned(app, out)) { return 0; }
        app->observe.turning = 0u;
        kc_observe_begin(app);
    }
    switch (kc_observe_poll(app, out)) {
    case KC_OBSERVE_DETECTED: /* observe again with the tool in the middle of the image */
        take_detection(app);
        app->observe.pantilt_sent = 0u;
        kc_app_enter(app, KC_ST_AIM);
        return 1;
    case KC_OBSERVE_NO_TAGS:
    case KC_OBSERVE_UNCERTAIN: return next_search(app, out);
    case KC_OBSERVE_TIMEOUT: kc_app_abort(app, out, KC_CAUSE_CAMERA); return 0;
    default: return 0;
    }
}
