/* Inputs: accepted whole, or refused with an event and nothing changed. */
#include <stddef.h>
#include <string.h>

#include "kc_app_priv.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_vec.h"

#define FUTURE_US 50000u    /* clocks of two computers differ: how far a stamp may be ahead */
#define JOINT_SLACK 0.5     /* how far encoder readings may be beyond the limits [rad or m] */
#define SPEED_MAX 50.0      /* beyond any arm [rad/s or m/s]                                        */
#define UNIT_TOL 1e-6
#define RANGE_MAX_M 10.0    /* largest plausible distance of the tags */
#define PIXEL_MAX 1e5

typedef struct {
    int32_t first;
    uint32_t count;
    const char *name;
} field_t;

#define FIELD_(first, count, name) {(first), (count), name},
static const field_t s_field[] = {KC_INPUT_FIELD_LIST(FIELD_)};
#define FIELD_N (sizeof s_field / sizeof s_field[0])

const char *kc_input_field(int32_t index, uint32_t *element)
{
    *element = 0u;
    for (size_t i = 0u; i < FIELD_N; i++) {
        const field_t *f = &s_field[i];
        if (index < f->first || index >= f->first + (int32_t)f->count) { continue; }
        if (f->count > 1u) { *element = (uint32_t)(index - f->first) + 1u; }
        return f->name;
    }
    return "";
}

static int within(kc_out_t *out, int32_t field, double x, double lo, double hi)
{
    if (x >= lo && x <= hi) { return 1; } /* NaN fails too */
    kc_event(&out->events, KC_EVT_IN_RANGE, field, x, x < lo ? lo : hi);
    return 0;
}

static int all_within(kc_out_t *out, int32_t field, const double *x, uint32_t n, double lo, double hi)
{
    for (uint32_t i = 0u; i < n; i++) {
        if (!within(out, field + (int32_t)i, x[i], lo, hi)) { return 0; }
    }
    return 1;
}

static int fresh(const kc_app_t *app, kc_out_t *out, int32_t field, uint64_t t_us, uint64_t age_us)
{
    uint64_t oldest = app->clock_us > age_us ? app->clock_us - age_us : 0u;
    return within(out, field, (double)t_us, (double)oldest, (double)(app->clock_us + FUTURE_US));
}

/* Newer than the last accepted one. A sender that was started again counts from the beginning: when all
 * its numbers were stale for a while, its count is accepted. */
static int newer(const kc_app_t *app, kc_out_t *out, kc_input_t input, int32_t seq, int32_t last,
                 uint64_t ok_us)
{
    if (seq > last || app->now_us - ok_us > KC_RESYNC_US) { return 1; }
    kc_event(&out->events, KC_EVT_IN_STALE, (int32_t)input, (double)seq, (double)last);
    return 0;
}

/* ---- arm ---- */

static int arm_fields(const kc_app_t *app, kc_out_t *out, const kc_arm_state_t *s)
{
    const kc_arm_t *arm = &app->tables.active.arm;
    for (uint32_t j = 0u; j < s->n_joints; j++) {
        int32_t k = (int32_t)j;
        const kc_joint_t *jt = &arm->joint[j];
        if (!within(out, 110 + k, s->q[j], jt->q_min - JOINT_SLACK, jt->q_max + JOINT_SLACK) ||
            !within(out, 120 + k, s->dq[j], -SPEED_MAX, SPEED_MAX) ||
            !within(out, 130 + k, s->q_cmd[j], -100.0, 100.0) ||
            !within(out, 140 + k, s->dir[j], -1.0, 1.0)) {
            return 0;
        }
    }
    return within(out, 150, s->temp_c, -273.15, 500.0) && within(out, 151, s->payload_kg, 0.0, 1000.0) &&
           all_within(out, 152, s->g_m_s2, 3u, -30.0, 30.0);
}

static void take_fault(kc_app_t *app, kc_out_t *out, int32_t mask)
{
    if (mask != app->fault_reported && mask != 0) {
        kc_event(&out->events, KC_EVT_ARM_FAULT, -1, (double)mask, 0.0);
    }
    app->arm.fault_mask = mask;
    app->fault_reported = mask;
}

/* A fault counts although the stamp is not of this time: clocks that disagree must not hide it. */
static int arm_fresh(kc_app_t *app, kc_out_t *out, const kc_arm_state_t *s)
{
    if (fresh(app, out, 101, s->t_us, KC_SILENT_US)) { return 1; }
    if (s->fault_mask != 0) { take_fault(app, out, s->fault_mask); }
    return 0;
}

static int arm_ok(kc_app_t *app, kc_out_t *out, const kc_arm_state_t *s)
{
    const kc_arm_t *arm = &app->tables.active.arm;
    if (app->has_arm && !newer(app, out, KC_INPUT_ARM, s->seq, app->arm.seq, app->arm_ok_us)) { return 0; }
    if (!arm_fresh(app, out, s)) { return 0; }
    if (s->n_joints != arm->n_joints) {
        kc_event(&out->events, KC_EVT_IN_COUNT, KC_INPUT_ARM, (double)s->n_joints, (double)arm->n_joints);
        return 0;
    }
    return arm_fields(app, out, s);
}

static void take_arm(kc_app_t *app, const kc_arm_state_t *s, kc_out_t *out)
{
    if (app->tables.active.crc[KC_TBL_ARM] == 0u) { return; } /* nothing to check it against */
    if (!arm_ok(app, out, s)) { return; }
    app->arm = *s;
    app->has_arm = 1u;
    app->arm_ok_us = app->now_us;
    take_fault(app, out, s->fault_mask);
}

/* ---- pan-tilt unit ---- */

static void take_pantilt(kc_app_t *app, const kc_pantilt_state_t *s, kc_out_t *out)
{
    if (app->has_pantilt &&
        !newer(app, out, KC_INPUT_PANTILT, s->seq, app->pantilt.seq, app->pantilt_ok_us)) {
        return;
    }
    if (!fresh(app, out, 201, s->t_us, KC_SILENT_US) ||
        !within(out, 202, s->pan_rad, -2.0 * KC_PI, 2.0 * KC_PI) ||
        !within(out, 203, s->tilt_rad, -2.0 * KC_PI, 2.0 * KC_PI)) {
        return;
    }
    app->pantilt = *s;
    app->has_pantilt = 1u;
    app->pantilt_ok_us = app->now_us;
}

/* ---- detections ---- */

static int det_requested(const kc_app_t *app, kc_out_t *out, const kc_detection_t *d)
{
    if (app->observe.waiting && d->seq == app->observe.frame_seq) { return 1; }
    double want = app->observe.waiting ? (double)app->observe.frame_seq : 0.0;
    kc_event(&out->events, KC_EVT_DET_UNREQUESTED, -1, (double)d->seq, want);
    return 0;
}

static int not_ahead(const kc_app_t *app, kc_out_t *out, const kc_detection_t *d)
{
    if (d->t_us <= app->clock_us + FUTURE_US) { return 1; }
    kc_event(&out->events, KC_EVT_IN_RANGE, 301, (double)d->t_us, (double)app->clock_us);
    return 0;
}

/* Taken after its request, and not too long ago. */
static int det_age(const kc_app_t *app, kc_out_t *out, const kc_detection_t *d)
{
    uint64_t allowed = app->tables.active.config.frame_age_max_us;
    if (!not_ahead(app, out, d)) { return 0; }
    uint64_t since = app->now_us - app->observe.requested_us;
    double age = (double)app->clock_us - (double)d->t_us;
    double limit = (double)(since + FUTURE_US < allowed ? since + FUTURE_US : allowed);
    if (age > limit) {
        kc_event(&out->events, KC_EVT_DET_OLD, -1, age, limit);
        return 0;
    }
    return 1;
}

static int tag_known(const kc_camera_t *cam, int32_t id)
{
    for (uint32_t i = 0u; i < cam->n_tags; i++) {
        if (cam->tag[i].id == id) { return 1; }
    }
    return 0;
}

static int det_tags(const kc_app_t *app, kc_out_t *out, const kc_detection_t *d)
{
    for (uint32_t i = 0u; i < d->n_tags; i++) {
        int twice = 0;
        for (uint32_t j = 0u; j < i; j++) { twice = twice || d->tag_id[j] == d->tag_id[i]; }
        if (twice || !tag_known(&app->tables.active.camera, d->tag_id[i])) {
            kc_event(&out->events, KC_EVT_DET_UNKNOWN_TAG, (int32_t)i, (double)d->tag_id[i], 0.0);
            return 0;
        }
    }
    return 1;
}

static int det_unit(kc_out_t *out, const double q[4])
{
    double n = kc_sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (kc_fabs(n - 1.0) <= UNIT_TOL) { return 1; } /* NaN fails too */
    kc_event(&out->events, KC_EVT_IN_NOT_UNIT, KC_INPUT_DETECTION, n, 1.0);
    return 0;
}

static int det_fields(kc_out_t *out, const kc_detection_t *d)
{
    double W[36];
    if (!all_within(out, 303, d->p_cam_tool_m, 3u, -RANGE_MAX_M, RANGE_MAX_M) ||
        !all_within(out, 306, d->p_alt_m, 3u, -RANGE_MAX_M, RANGE_MAX_M) ||
        !det_unit(out, d->q_cam_tool_wxyz) || !det_unit(out, d->q_alt_wxyz) ||
        !within(out, 309, d->rms_px, 0.0, PIXEL_MAX) || !within(out, 310, d->rms_alt_px, 0.0, PIXEL_MAX) ||
        !within(out, 311, d->range_m, 0.0, RANGE_MAX_M) || !within(out, 312, d->incid_rad, 0.0, KC_PI) ||
        !within(out, 313, d->u_px, -PIXEL_MAX, PIXEL_MAX) ||
        !within(out, 314, d->v_px, -PIXEL_MAX, PIXEL_MAX) ||
        !all_within(out, 320, d->corner_px, 8u * KC_TAG_MAX, -PIXEL_MAX, PIXEL_MAX) ||
        !all_within(out, 360, d->cov, 36u, -1e3, 1e3)) {
        return 0;
    }
    if (kc_la_whiten(d->cov, 6u, W) != KC_OK) { /* not positive definite */
        kc_event(&out->events, KC_EVT_IN_RANGE, 315, d->cov[0], 0.0);
        return 0;
    }
    return 1;
}

static double worst_sigma(const double cov[36], uint32_t first)
{
    double v = 0.0;
    for (uint32_t i = first; i < first + 3u; i++) { v = kc_max(v, cov[7u * i]); }
    return kc_sqrt(v);
}

/* Whether a well-formed detection is certain enough; if not, the frame is used up and another one is
 * requested. */
static int det_good(const kc_app_t *app, kc_out_t *out, const kc_detection_t *d)
{
    const kc_config_t *c = &app->tables.active.config;
    double got[3] = {worst_sigma(d->cov, 0u), worst_sigma(d->cov, 3u), d->rms_px};
    double want[3] = {c->sigma_pos_max_m, c->sigma_rot_max_rad, c->rms_max_px};
    for (int32_t i = 0; i < 3; i++) {
        if (got[i] > want[i]) {
            kc_event(&out->events, KC_EVT_DET_UNCERTAIN, i, got[i], want[i]);
            return 0;
        }
    }
    return 1;
}

static int det_steady(const kc_app_t *app, kc_out_t *out, const kc_detection_t *d)
{
    const kc_config_t *c = &app->tables.active.config;
    double pos_m = 0.0, rot_rad = 0.0;
    kc_measure_jump(app, d, &pos_m, &rot_rad);
    if (pos_m > c->jump_pos_m) {
        kc_event(&out->events, KC_EVT_DET_JUMP, 0, pos_m, c->jump_pos_m);
        return 0;
    }
    if (rot_rad > c->jump_rot_rad) {
        kc_event(&out->events, KC_EVT_DET_JUMP, 1, rot_rad, c->jump_rot_rad);
        return 0;
    }
    return 1;
}

/* An observation outside calibrations: new, recent, and as certain as one of a calibration. */
static void take_observation(kc_app_t *app, const kc_detection_t *d, kc_out_t *out)
{
    double age = (double)app->clock_us - (double)d->t_us;
    double limit = (double)app->tables.active.config.frame_age_max_us;
    uint64_t taken_us = kc_app_elapsed(app, d->t_us);
    if (!not_ahead(app, out, d)) { return; }
    if (age > limit) {
        kc_event(&out->events, KC_EVT_DET_OLD, -1, age, limit);
    } else if (taken_us <= app->monitoring.t_us) {
        kc_event(&out->events, KC_EVT_IN_STALE, KC_INPUT_DETECTION, (double)taken_us,
                 (double)app->monitoring.t_us);
    } else if (!within(out, 302, (double)d->n_tags, 0.0, (double)KC_TAG_MAX)) {
        return;
    } else if (d->n_tags == 0u) {
        kc_event(&out->events, KC_EVT_DET_NONE, -1, (double)d->seq, 0.0);
    } else if (det_tags(app, out, d) && det_fields(out, d) && det_good(app, out, d)) {
        kc_monitoring_observe(app, out, d);
    }
}

static void take_det(kc_app_t *app, const kc_detection_t *d, kc_out_t *out)
{
    if (kc_monitoring_wants(app)) {
        take_observation(app, d, out);
        return;
    }
    if (!det_requested(app, out, d) || !det_age(app, out, d)) { return; }
    if (!within(out, 302, (double)d->n_tags, 0.0, (double)KC_TAG_MAX)) { return; }
    if (d->n_tags == 0u) {
        kc_event(&out->events, KC_EVT_DET_NONE, -1, (double)d->seq, 0.0);
    } else if (!det_tags(app, out, d) || !det_fields(out, d)) {
        return;
    }
    app->observe.det = *d;
    kc_observe_unflip(app, app->cal.coef, &app->observe.det);
    app->observe.got = 1u;
    app->observe.waiting = 0u;
    app->observe.unsure = d->n_tags > 0u &&
                          (!det_good(app, out, d) || !det_steady(app, out, &app->observe.det));
    app->n_rejected += app->observe.unsure;
}

/* ---- all inputs ---- */

void kc_input_take(kc_app_t *app, const kc_in_t *in, kc_out_t *out)
{
    app->n_rx_errors = in->n_rx_errors;
    if (in->has_store_result && in->store_status != 0) {
        kc_event(&out->events, KC_EVT_STORE_FAIL, (int32_t)in->store_kind, (double)in->store_status, 0.0);
    }
    if (in->has_arm) { take_arm(app, &in->arm, out); }
    if (in->has_pantilt) { take_pantilt(app, &in->pantilt, out); }
    kc_monitoring_rest(app);
    for (uint32_t i = 0u; i < in->n_det && i < KC_DET_QUEUE_MAX; i++) { take_det(app, &in->det[i], out); }
}

static int silent(const kc_app_t *app, kc_out_t *out, kc_input_t input, uint64_t ok_us)
{
    if (app->now_us - ok_us <= KC_SILENT_US) { return 0; }
    kc_event(&out->events, KC_EVT_IN_SILENT, (int32_t)input, (double)(app->now_us - ok_us),
             (double)KC_SILENT_US);
    return 1;
}

void kc_input_check_silence(kc_app_t *app, kc_out_t *out)
{
    if (!kc_app_calibrating(app)) { return; }
    if (app->arm.fault_mask != 0) {
        kc_app_abort(app, out, KC_CAUSE_ARM_FAULT);
    } else if (silent(app, out, KC_INPUT_ARM, app->arm_ok_us) ||
               silent(app, out, KC_INPUT_PANTILT, app->pantilt_ok_us)) {
        kc_app_abort(app, out, KC_CAUSE_SILENT);
    }
}
