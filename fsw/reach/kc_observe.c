#include "kc_observe.h"

#include <string.h>

#include "kc_approach.h"
#include "kc_libm.h"
#include "kc_move.h"
#include "kc_observation.h"
#include "kc_path.h"
#include "kc_vec.h"

void kc_observe_begin(kc_observe_t *observe) { memset(observe, 0, sizeof *observe); }

void kc_observe_aimed(kc_observe_t *observe, const kc_pantilt_t *pantilt)
{
    observe->middle_pan_rad = pantilt->pan_rad;
    observe->middle_tilt_rad = pantilt->tilt_rad;
}

/* Measured tool pose in the base frame, camera-side corrections applied: model plus residual. */
static void take_detection(kc_observe_t *observe, const kc_detection_t *det, const kc_view_t *view)
{
    const kc_telemetry_t *t = view->telemetry;
    kc_posture_t at = {&t->arm, &t->pantilt, (double)view->clock->now_us * 1e-6};
    kc_obs_t obs;
    kc_fixed_t fixed;
    double r[6], E[9];
    kc_observation(&view->tables->camera, det, &at, &obs);
    kc_model_fix(&view->tables->arm, &view->tables->terms, view->latest->coef, &fixed);
    kc_observation_residual(&fixed, &obs, r, &observe->predicted);
    kc_R_exp(&r[3], E);
    kc_m3_mul(E, observe->predicted.R, observe->measured.R);
    kc_v3_add_scaled(observe->predicted.p_m, 1.0, r, observe->measured.p_m);
    kc_v3_copy(r, observe->off_m);
    memcpy(observe->q_detected, t->arm.q, sizeof observe->q_detected);
    observe->tried.detected = true;
}

/* ---- OBSERVE ---- */

/* Whether two poses of the tool are so different that an observation of each is worth its time. */
static bool differ(const kc_config_t *config, const kc_pose_t *one, const kc_pose_t *two)
{
    double r[6];
    kc_pose_residual(one, two, r);
    return kc_v3_norm(r) >= config->extra_pos_m || kc_v3_norm(&r[3]) >= config->extra_rot_rad;
}

static kc_outcome_t measure(kc_observe_t *observe, kc_request_t *request, const kc_view_t *view)
{
    observe->taken_at = KC_AT_CANDIDATE;
    observe->same_place = observe->extra_held &&
                          !differ(&view->tables->config, &observe->measured, &observe->last_extra);
    kc_request_begin(request);
    return kc_outcome(kc_approach_wanted(view) ? KC_OC_APPROACH : KC_OC_MEASURE);
}

/* The servo cannot get nearer: the pose is measured where the arm is, since any pose with the tags in view
 * serves. */
static void report_beside(const kc_observe_t *observe, const kc_view_t *view, kc_out_t *out,
                          const kc_pose_t *goal)
{
    double d[3];
    kc_v3_sub(goal->p_m, observe->measured.p_m, d);
    kc_event(&out->events, KC_EVT_CAL_SERVO_LIMIT, view->cal->candidate, (double)observe->servo_steps,
             kc_v3_norm(d));
}

/* Next servo step, into q_servo; THERE or STUCK where the pose is measured. */
static kc_servo_result_t step(kc_observe_t *observe, const kc_view_t *view, const kc_pose_t *goal)
{
    const kc_active_t *a = view->tables;
    double seed[KC_JOINT_MAX], bound[KC_JOINT_MAX];
    kc_eval_t eval;
    memset(observe->q_servo, 0, sizeof observe->q_servo);
    kc_move_bound(a, bound);
    kc_view_seed(view, seed);
    return kc_servo_step(&a->arm, &a->terms, view->latest->coef, &observe->measured, goal,
                         view->telemetry->arm.q, seed, bound, &a->config.servo, observe->q_servo, &eval,
                         &observe->servo);
}

/* The arm rests with tags in view, and is about to go on to the goal. */
static bool wants_extra(const kc_observe_t *observe, const kc_view_t *view, const kc_pose_t *goal)
{
    const kc_config_t *c = &view->tables->config;
    bool more = observe->n_extra < c->extra_obs_max && kc_plan_has_room(view->plan);
    return more && differ(c, &observe->measured, goal) &&
           (observe->n_extra == 0u || differ(c, &observe->measured, &observe->last_extra));
}

static void begin_extra(kc_observe_t *observe, kc_request_t *request)
{
    observe->taken_at = observe->servo_steps == 0u ? KC_AT_ARRIVAL : KC_AT_SERVO_STEP;
    observe->last_extra = observe->measured;
    observe->n_extra++;
    observe->extra_held = false;
    kc_request_begin(request);
}

kc_outcome_t kc_observe_measured(const kc_observe_t *observe, kc_outcome_t measured)
{
    bool over = measured.id == KC_OC_DONE || measured.id == KC_OC_SKIP;
    if (!over || observe->taken_at == KC_AT_CANDIDATE) { return measured; }
    return kc_outcome(observe->taken_at == KC_AT_STOP ? KC_OC_ONWARD : KC_OC_SERVO);
}

static kc_outcome_t detected(kc_observe_t *observe, kc_request_t *request, const kc_view_t *view,
                             kc_out_t *out)
{
    kc_pose_t goal;
    take_detection(observe, &request->det, view);
    if (kc_view_local(view)) { return measure(observe, request, view); }
    kc_move_goal(&view->tables->space, (uint32_t)view->cal->candidate, &goal);
    kc_servo_result_t res = step(observe, view, &goal);
    if (res == KC_SERVO_THERE) { return measure(observe, request, view); }
    if (res == KC_SERVO_STUCK || observe->tried.retreated ||
        observe->servo_steps >= view->tables->config.servo_steps_max) {
        report_beside(observe, view, out, &goal);
        return measure(observe, request, view);
    }
    bool also = wants_extra(observe, view, &goal);
    if (also) { begin_extra(observe, request); }
    observe->servo_steps++;
    observe->tried.searched = false;
    return kc_outcome(also ? KC_OC_MEASURE : KC_OC_SERVO);
}

/* The arm goes elsewhere: there the pan-tilt unit may search again. */
static kc_outcome_t go(kc_observe_t *observe, kc_outcome_id_t where)
{
    observe->tried.searched = false;
    return kc_outcome(where);
}

static kc_outcome_t lost(const kc_observe_t *observe, const kc_view_t *view, kc_out_t *out)
{
    kc_event(&out->events, KC_EVT_CAL_TAGS_LOST, view->cal->candidate, (double)observe->i_search, 0.0);
    return kc_outcome(KC_OC_SKIP);
}

static kc_outcome_t no_tags(kc_observe_t *observe, const kc_view_t *view, kc_out_t *out)
{
    double seed[KC_JOINT_MAX];
    kc_view_seed(view, seed);
    bool at_seed = kc_view_distance(view, seed) <= view->tables->config.servo.step_max;
    kc_no_tags_t then = kc_reach_no_tags(&observe->tried, at_seed);
    observe->tried.seed = observe->tried.seed || !observe->tried.detected;
    observe->i_search = 0u;
    switch (then) {
    case KC_NO_TAGS_SEED: return go(observe, KC_OC_SEED);
    case KC_NO_TAGS_RETREAT: observe->tried.retreated = true; return go(observe, KC_OC_RETREAT);
    case KC_NO_TAGS_SEARCH: observe->tried.searched = true; return kc_outcome(KC_OC_SEARCH);
    default: return lost(observe, view, out);
    }
}

void kc_observe_at_stop(kc_observe_t *observe, bool at_stop) { observe->at_stop = at_stop; }

/* At a stop nothing is searched for and the arm does not leave the segment. */
static kc_outcome_t measure_stop(kc_observe_t *observe, kc_request_t *request)
{
    observe->taken_at = KC_AT_STOP;
    kc_request_begin(request);
    return kc_outcome(KC_OC_MEASURE);
}

kc_outcome_t kc_observe_run(kc_observe_t *observe, kc_request_t *request, const kc_view_t *view,
                            kc_out_t *out)
{
    const bool at_stop = observe->at_stop;
    switch (kc_request_poll(request, view, out)) {
    case KC_FRAME_DETECTED:
        return at_stop ? measure_stop(observe, request) : detected(observe, request, view, out);
    case KC_FRAME_NO_TAGS: return at_stop ? kc_outcome(KC_OC_ONWARD) : no_tags(observe, view, out);
    case KC_FRAME_UNCERTAIN: return kc_outcome(at_stop ? KC_OC_ONWARD : KC_OC_SKIP);
    case KC_FRAME_TIMEOUT: return kc_abort_for(KC_CAUSE_CAMERA);
    default: return kc_outcome(KC_OC_STAY);
    }
}

/* ---- SEARCH ---- */

kc_outcome_t kc_observe_search(kc_observe_t *observe, kc_request_t *request, const kc_view_t *view,
                               kc_out_t *out)
{
    switch (kc_request_poll(request, view, out)) {
    case KC_FRAME_DETECTED: /* observe again with the tool in the middle of the image */
        take_detection(observe, &request->det, view);
        return kc_outcome(KC_OC_DONE);
    case KC_FRAME_NO_TAGS:
    case KC_FRAME_UNCERTAIN: return kc_outcome(KC_OC_SEARCH);
    case KC_FRAME_TIMEOUT: return kc_abort_for(KC_CAUSE_CAMERA);
    default: return kc_outcome(KC_OC_STAY);
    }
}

static bool inside(const kc_camera_t *camera, double pan, double tilt)
{
    return pan >= camera->pan_min_rad && pan <= camera->pan_max_rad && tilt >= camera->tilt_min_rad &&
           tilt <= camera->tilt_max_rad;
}

/* Search positions at this candidate. */
static uint32_t places(const kc_view_t *view)
{
    uint32_t n = view->plan->n_meas;
    double range_m = n > 0u ? view->est->obs[view->est->n_obs - 1u].ctx.range_m : 0.0;
    return kc_reach_search_limit(&view->tables->camera, &view->tables->config, n, view->latest->res.pos_m,
                                 range_m);
}

kc_outcome_t kc_observe_turn(kc_observe_t *observe, kc_pantilt_t *pantilt, const kc_view_t *view,
                             kc_out_t *out)
{
    const double step_rad = view->tables->config.search_step_rad;
    while (observe->i_search < places(view)) {
        double x = 0.0, y = 0.0;
        kc_reach_spiral(++observe->i_search, &x, &y);
        double pan = observe->middle_pan_rad + x * step_rad;
        double tilt = observe->middle_tilt_rad + y * step_rad;
        if (!inside(&view->tables->camera, pan, tilt)) { continue; }
        kc_pantilt_turn(pantilt, view, out, pan, tilt);
        return kc_outcome(KC_OC_STAY);
    }
    return lost(observe, view, out);
}
