#include "kc_observe.h"

#include <string.h>

#include "kc_approach.h"
#include "kc_libm.h"
#include "kc_move.h"
#include "kc_observation.h"
#include "kc_path.h"
#include "kc_vec.h"

void kc_observe_begin(kc_observe_t *o) { memset(o, 0, sizeof *o); }

void kc_observe_aimed(kc_observe_t *o, const kc_pantilt_t *pantilt)
{
    o->middle_pan_rad = pantilt->pan_rad;
    o->middle_tilt_rad = pantilt->tilt_rad;
}

/* Measured tool pose in the base frame, camera-side corrections applied: model plus residual. */
static void take_detection(kc_observe_t *o, const kc_detection_t *det, const kc_view_t *v)
{
    const kc_telemetry_t *t = v->telemetry;
    kc_posture_t at = {&t->arm, &t->pantilt, (double)v->clock->now_us * 1e-6};
    kc_obs_t obs;
    double r[6], E[9];
    kc_observation(&v->tables->camera, det, &at, &obs);
    kc_observation_residual(v->tables, v->learned->coef, &obs, r, &o->predicted);
    kc_R_exp(&r[3], E);
    kc_m3_mul(E, o->predicted.R, o->measured.R);
    kc_v3_add_scaled(o->predicted.p_m, 1.0, r, o->measured.p_m);
    kc_v3_copy(r, o->off_m);
    memcpy(o->q_detected, t->arm.q, sizeof o->q_detected);
    o->tried.detected = true;
}

/* ---- OBSERVE ---- */

static kc_outcome_t measure(kc_request_t *r, const kc_view_t *v)
{
    kc_request_begin(r);
    return kc_outcome(kc_approach_wanted(v) ? KC_OC_APPROACH : KC_OC_MEASURE);
}

/* The servo cannot get nearer: the pose is measured where the arm is, since any pose with the tags in view
 * serves. */
static void report_beside(const kc_observe_t *o, const kc_view_t *v, kc_out_t *out, const kc_pose_t *goal)
{
    double d[3];
    kc_v3_sub(goal->p_m, o->measured.p_m, d);
    kc_event(&out->events, KC_EVT_CAL_SERVO_LIMIT, v->cal->candidate, (double)o->servo_steps, kc_v3_norm(d));
}

/* Next servo step, into q_servo; THERE or STUCK where the pose is measured. */
static kc_servo_result_t step(kc_observe_t *o, const kc_view_t *v, const kc_pose_t *goal)
{
    const kc_active_t *a = v->tables;
    double seed[KC_JOINT_MAX], bound[KC_JOINT_MAX];
    kc_eval_t eval;
    memset(o->q_servo, 0, sizeof o->q_servo);
    kc_move_bound(a, bound);
    kc_view_seed(v, seed);
    return kc_servo_step(&a->arm, &a->terms, v->learned->coef, &o->measured, goal, v->telemetry->arm.q, seed,
                         bound, &a->config.servo, o->q_servo, &eval, &o->servo);
}

static kc_outcome_t detected(kc_observe_t *o, kc_request_t *r, const kc_view_t *v, kc_out_t *out)
{
    kc_pose_t goal;
    take_detection(o, &r->det, v);
    if (kc_view_local(v)) { return measure(r, v); }
    kc_move_goal(&v->tables->space, (uint32_t)v->cal->candidate, &goal);
    kc_servo_result_t res = step(o, v, &goal);
    if (res == KC_SERVO_THERE) { return measure(r, v); }
    if (res == KC_SERVO_STUCK || o->tried.retreated || o->servo_steps >= v->tables->config.servo_steps_max) {
        report_beside(o, v, out, &goal);
        return measure(r, v);
    }
    o->servo_steps++;
    o->tried.searched = false;
    return kc_outcome(KC_OC_SERVO);
}

/* The arm goes elsewhere: there the pan-tilt unit may search again. */
static kc_outcome_t go(kc_observe_t *o, kc_outcome_id_t where)
{
    o->tried.searched = false;
    return kc_outcome(where);
}

static kc_outcome_t lost(const kc_observe_t *o, const kc_view_t *v, kc_out_t *out)
{
    kc_event(&out->events, KC_EVT_CAL_TAGS_LOST, v->cal->candidate, (double)o->i_search, 0.0);
    return kc_outcome(KC_OC_SKIP);
}

static kc_outcome_t no_tags(kc_observe_t *o, const kc_view_t *v, kc_out_t *out)
{
    double seed[KC_JOINT_MAX];
    kc_view_seed(v, seed);
    bool at_seed = kc_view_distance(v, seed) <= v->tables->config.servo.step_max;
    kc_no_tags_t then = kc_reach_no_tags(&o->tried, at_seed);
    o->tried.seed = o->tried.seed || !o->tried.detected;
    o->i_search = 0u;
    switch (then) {
    case KC_NO_TAGS_SEED: return go(o, KC_OC_SEED);
    case KC_NO_TAGS_RETREAT: o->tried.retreated = true; return go(o, KC_OC_RETREAT);
    case KC_NO_TAGS_SEARCH: o->tried.searched = true; return kc_outcome(KC_OC_SEARCH);
    default: return lost(o, v, out);
    }
}

kc_outcome_t kc_observe_run(kc_observe_t *o, kc_request_t *r, const kc_view_t *v, kc_out_t *out)
{
    switch (kc_request_poll(r, v, out)) {
    case KC_FRAME_DETECTED: return detected(o, r, v, out);
    case KC_FRAME_NO_TAGS: return no_tags(o, v, out);
    case KC_FRAME_UNCERTAIN: return kc_outcome(KC_OC_SKIP);
    case KC_FRAME_TIMEOUT: return kc_abort_for(KC_CAUSE_CAMERA);
    default: return kc_outcome(KC_OC_STAY);
    }
}

/* ---- SEARCH ---- */

kc_outcome_t kc_observe_search(kc_observe_t *o, kc_request_t *r, const kc_view_t *v, kc_out_t *out)
{
    switch (kc_request_poll(r, v, out)) {
    case KC_FRAME_DETECTED: /* observe again with the tool in the middle of the image */
        take_detection(o, &r->det, v);
        return kc_outcome(KC_OC_DONE);
    case KC_FRAME_NO_TAGS:
    case KC_FRAME_UNCERTAIN: return kc_outcome(KC_OC_SEARCH);
    case KC_FRAME_TIMEOUT: return kc_abort_for(KC_CAUSE_CAMERA);
    default: return kc_outcome(KC_OC_STAY);
    }
}

static bool inside(const kc_camera_t *c, double pan, double tilt)
{
    return pan >= c->pan_min_rad && pan <= c->pan_max_rad && tilt >= c->tilt_min_rad &&
           tilt <= c->tilt_max_rad;
}

/* Search positions at this candidate. */
static uint32_t places(const kc_view_t *v)
{
    uint32_t n = v->plan->n_meas;
    double range_m = n > 0u ? v->est->obs[n - 1u].ctx.range_m : 0.0;
    return kc_reach_search_limit(&v->tables->camera, &v->tables->config, n, v->learned->res.pos_m, range_m);
}

kc_outcome_t kc_observe_turn(kc_observe_t *o, kc_pantilt_t *p, const kc_view_t *v, kc_out_t *out)
{
    const double step_rad = v->tables->config.search_step_rad;
    while (o->i_search < places(v)) {
        double x = 0.0, y = 0.0;
        kc_reach_spiral(++o->i_search, &x, &y);
        double pan = o->middle_pan_rad + x * step_rad;
        double tilt = o->middle_tilt_rad + y * step_rad;
        if (!inside(&v->tables->camera, pan, tilt)) { continue; }
        kc_pantilt_turn(p, v, out, pan, tilt);
        return kc_outcome(KC_OC_STAY);
    }
    return lost(o, v, out);
}
