#include "kc_input.h"

#include "kc_input_fields.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_observation.h"
#include "kc_vec.h"

#define RESYNC_US 5000000u  /* stale for longer than this: the sender's clock was set back */
#define JUMP_MAX 100u       /* how far a number may be ahead of the last one: 10 s at 10 Hz */
#define FUTURE_US 50000u    /* clocks of two computers differ: how far a stamp may be ahead */
#define JOINT_SLACK 0.5     /* how far encoder readings may be beyond the limits [rad or m] */
#define SPEED_MAX 50.0      /* beyond any arm [rad/s or m/s]                                        */
#define UNIT_TOL 1e-6
#define RANGE_MAX_M 10.0    /* largest plausible distance of the tags */
#define PIXEL_MAX 1e5

static bool within(kc_out_t *out, int32_t field, double x, double lo, double hi)
{
    if (x >= lo && x <= hi) { return true; } /* NaN fails too */
    kc_event(&out->events, KC_EVT_IN_RANGE, field, x, x < lo ? lo : hi);
    return false;
}

static bool all_within(kc_out_t *out, int32_t field, const double *x, uint32_t n, double lo, double hi)
{
    for (uint32_t i = 0u; i < n; i++) {
        if (!within(out, field + (int32_t)i, x[i], lo, hi)) { return false; }
    }
    return true;
}

static bool fresh(const kc_view_t *view, kc_out_t *out, int32_t field, uint64_t t_us, uint64_t age_us)
{
    uint64_t oldest = view->clock->clock_us > age_us ? view->clock->clock_us - age_us : 0u;
    return within(out, field, (double)t_us, (double)oldest, (double)(view->clock->clock_us + FUTURE_US));
}

/* What says when a message was made, and what its field of a number is called. */
typedef struct {
    kc_sensor_t input;
    int32_t seq;
    uint64_t t_us;
} made_t;

/* Newer than the last accepted one: the next by its number, a few lost ones between, or made later by its stamp. So
 * neither a wild number nor a sender that was started again and counts from the beginning locks out what comes
 * after it. When nothing was newer for a while, the clock of the sender was set back: what comes is taken. */
static bool newer(const kc_view_t *view, kc_out_t *out, made_t m, made_t last, uint64_t ok_us)
{
    uint32_t ahead = (uint32_t)m.seq - (uint32_t)last.seq; /* numbers wrap */
    bool next = ahead > 0u && ahead <= JUMP_MAX;
    bool later = m.t_us > last.t_us || view->clock->now_us - ok_us > RESYNC_US;
    kc_event_id_t id = later ? KC_EVT_IN_JUMP : KC_EVT_IN_STALE;
    if (!next) { kc_event(&out->events, id, (int32_t)m.input, (double)m.seq, (double)last.seq); }
    return next || later;
}

/* ---- arm ---- */

static bool arm_fields(const kc_view_t *view, kc_out_t *out, const kc_arm_state_t *state)
{
    const kc_arm_t *arm = &view->tables->arm;
    for (uint32_t j = 0u; j < state->n_joints; j++) {
        int32_t k = (int32_t)j;
        const kc_joint_t *jt = &arm->joint[j];
        if (!within(out, (int32_t)KC_FIELD_ARM_Q + k, state->q[j], jt->q_min - JOINT_SLACK,
                    jt->q_max + JOINT_SLACK) ||
            !within(out, (int32_t)KC_FIELD_ARM_DQ + k, state->dq[j], -SPEED_MAX, SPEED_MAX) ||
            !within(out, (int32_t)KC_FIELD_ARM_Q_CMD + k, state->q_cmd[j], -100.0, 100.0) ||
            !within(out, (int32_t)KC_FIELD_ARM_DIR + k, state->dir[j], -1.0, 1.0)) {
            return false;
        }
    }
    return within(out, KC_FIELD_ARM_TEMP, state->temp_c, -273.15, 500.0) &&
           within(out, KC_FIELD_ARM_PAYLOAD, state->payload_kg, 0.0, 1000.0) &&
           all_within(out, KC_FIELD_ARM_G, state->g_m_s2, 3u, -30.0, 30.0);
}

static void take_fault(kc_input_t *input, kc_out_t *out, int32_t mask)
{
    if (mask != input->fault_reported && mask != 0) {
        kc_event(&out->events, KC_EVT_ARM_FAULT, -1, (double)mask, 0.0);
    }
    input->telemetry.arm.fault_mask = mask;
    input->fault_reported = mask;
}

static bool arm_ok(const kc_view_t *view, kc_out_t *out, const kc_arm_state_t *arm)
{
    const kc_telemetry_t *t = view->telemetry;
    const made_t made = {KC_INPUT_ARM, arm->seq, arm->t_us}, last = {KC_INPUT_ARM, t->arm.seq, t->arm.t_us};
    uint32_t n = view->tables->arm.n_joints;
    if (view->tables->crc[KC_TBL_ARM] == 0u) { return false; } /* nothing to check it against */
    if (t->has_arm && !newer(view, out, made, last, t->arm_ok_us)) { return false; }
    if (!fresh(view, out, KC_FIELD_ARM_T, arm->t_us, KC_SILENT_US)) { return false; }
    if (arm->n_joints != n) {
        kc_event(&out->events, KC_EVT_IN_COUNT, KC_INPUT_ARM, (double)arm->n_joints, (double)n);
        return false;
    }
    return arm_fields(view, out, arm);
}

/* Entries beyond the arm's joints are 0, whatever was sent: nothing has checked them, and they are published. */
static void clear_unused(kc_arm_state_t *arm)
{
    for (uint32_t j = arm->n_joints; j < KC_JOINT_MAX; j++) {
        arm->q[j] = arm->dq[j] = arm->q_cmd[j] = arm->dir[j] = 0.0;
    }
}

/* A fault counts whatever else is wrong with the message, and until a state without one is accepted. */
static void take_arm(kc_input_t *input, const kc_view_t *view, const kc_arm_state_t *arm, kc_out_t *out)
{
    int32_t fault = arm->fault_mask;
    if (!arm_ok(view, out, arm)) {
        take_fault(input, out, input->telemetry.arm.fault_mask | fault);
        return;
    }
    input->telemetry.arm = *arm;
    clear_unused(&input->telemetry.arm);
    input->telemetry.has_arm = true;
    input->telemetry.arm_ok_us = view->clock->now_us;
    take_fault(input, out, fault);
}

/* ---- pan-tilt unit ---- */

static bool pantilt_ok(const kc_view_t *view, kc_out_t *out, const kc_pantilt_state_t *pantilt)
{
    const kc_telemetry_t *t = view->telemetry;
    const made_t made = {KC_INPUT_PANTILT, pantilt->seq, pantilt->t_us},
                 last = {KC_INPUT_PANTILT, t->pantilt.seq, t->pantilt.t_us};
    if (t->has_pantilt && !newer(view, out, made, last, t->pantilt_ok_us)) { return false; }
    return fresh(view, out, KC_FIELD_PANTILT_T, pantilt->t_us, KC_SILENT_US) &&
           within(out, KC_FIELD_PANTILT_PAN, pantilt->pan_rad, -2.0 * KC_PI, 2.0 * KC_PI) &&
           within(out, KC_FIELD_PANTILT_TILT, pantilt->tilt_rad, -2.0 * KC_PI, 2.0 * KC_PI);
}

static void take_pantilt(kc_input_t *input, const kc_view_t *view, const kc_pantilt_state_t *pantilt,
                         kc_out_t *out)
{
    if (!pantilt_ok(view, out, pantilt)) { return; }
    input->telemetry.pantilt = *pantilt;
    input->telemetry.has_pantilt = true;
    input->telemetry.pantilt_ok_us = view->clock->now_us;
}

void kc_input_telemetry(kc_input_t *input, const kc_view_t *view, const kc_in_t *in, kc_out_t *out)
{
    if (in->has_arm) { take_arm(input, view, &in->arm, out); }
    if (in->has_pantilt) { take_pantilt(input, view, &in->pantilt, out); }
}

/* ---- detections ---- */

static bool det_requested(const kc_request_t *request, kc_out_t *out, const kc_detection_t *det)
{
    bool awaited = request->frame == KC_FRAME_AWAITED;
    if (awaited && det->seq == request->seq) { return true; }
    kc_event(&out->events, KC_EVT_DET_UNREQUESTED, -1, (double)det->seq,
             awaited ? (double)request->seq : 0.0);
    return false;
}

static bool not_ahead(const kc_view_t *view, kc_out_t *out, const kc_detection_t *det)
{
    if (det->t_us <= view->clock->clock_us + FUTURE_US) { return true; }
    kc_event(&out->events, KC_EVT_IN_RANGE, KC_FIELD_DET_T, (double)det->t_us, (double)view->clock->clock_us);
    return false;
}

/* Taken after its request, and not too long ago. */
static bool det_age(const kc_view_t *view, const kc_request_t *request, kc_out_t *out,
                    const kc_detection_t *det)
{
    uint64_t allowed = view->tables->config.frame_age_max_us;
    if (!not_ahead(view, out, det)) { return false; }
    uint64_t since = view->clock->now_us - request->asked_us;
    double age = (double)view->clock->clock_us - (double)det->t_us;
    double limit = (double)(since + FUTURE_US < allowed ? since + FUTURE_US : allowed);
    if (age > limit) {
        kc_event(&out->events, KC_EVT_DET_OLD, -1, age, limit);
        return false;
    }
    return true;
}

static bool tag_known(const kc_camera_t *cam, int32_t id)
{
    for (uint32_t i = 0u; i < cam->n_tags; i++) {
        if (cam->tag[i].id == id) { return true; }
    }
    return false;
}

static bool det_tags(const kc_view_t *view, kc_out_t *out, const kc_detection_t *det)
{
    for (uint32_t i = 0u; i < det->n_tags; i++) {
        bool twice = false;
        for (uint32_t j = 0u; j < i; j++) { twice = twice || det->tag_id[j] == det->tag_id[i]; }
        if (twice || !tag_known(&view->tables->camera, det->tag_id[i])) {
            kc_event(&out->events, KC_EVT_DET_UNKNOWN_TAG, (int32_t)i, (double)det->tag_id[i], 0.0);
            return false;
        }
    }
    return true;
}

static bool det_unit(kc_out_t *out, const double q[4])
{
    double n = kc_sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (kc_fabs(n - 1.0) <= UNIT_TOL) { return true; } /* NaN fails too */
    kc_event(&out->events, KC_EVT_IN_NOT_UNIT, KC_INPUT_DETECTION, n, 0.0);
    return false;
}

static bool det_fields(kc_out_t *out, const kc_detection_t *det)
{
    double W[36];
    if (!all_within(out, KC_FIELD_DET_P, det->p_cam_tool_m, 3u, -RANGE_MAX_M, RANGE_MAX_M) ||
        !all_within(out, KC_FIELD_DET_P_ALT, det->p_alt_m, 3u, -RANGE_MAX_M, RANGE_MAX_M) ||
        !det_unit(out, det->q_cam_tool_wxyz) || !det_unit(out, det->q_alt_wxyz) ||
        !within(out, KC_FIELD_DET_RMS, det->rms_px, 0.0, PIXEL_MAX) ||
        !within(out, KC_FIELD_DET_RMS_ALT, det->rms_alt_px, 0.0, PIXEL_MAX) ||
        !within(out, KC_FIELD_DET_RANGE, det->range_m, 0.0, RANGE_MAX_M) ||
        !within(out, KC_FIELD_DET_INCID, det->incid_rad, 0.0, KC_PI) ||
        !within(out, KC_FIELD_DET_U, det->u_px, -PIXEL_MAX, PIXEL_MAX) ||
        !within(out, KC_FIELD_DET_V, det->v_px, -PIXEL_MAX, PIXEL_MAX) ||
        !all_within(out, KC_FIELD_DET_CORNER, det->corner_px, 8u * KC_TAG_MAX, -PIXEL_MAX, PIXEL_MAX) ||
        !all_within(out, KC_FIELD_DET_COV, det->cov, 36u, -1e3, 1e3)) {
        return false;
    }
    if (kc_la_whiten(det->cov, 6u, W) != KC_OK) { /* not positive definite */
        kc_event(&out->events, KC_EVT_IN_RANGE, KC_FIELD_DET_COV_SHAPE, det->cov[0], 0.0);
        return false;
    }
    return true;
}

static double worst_sigma(const double cov[36], uint32_t first)
{
    double v = 0.0;
    for (uint32_t i = first; i < first + 3u; i++) { v = kc_max(v, cov[7u * i]); }
    return kc_sqrt(v);
}

/* Whether a well-formed detection is certain enough; if not, the frame is used up and another one is
 * requested. */
static bool det_good(const kc_view_t *view, kc_out_t *out, const kc_detection_t *det)
{
    const kc_config_t *c = &view->tables->config;
    double got[3] = {worst_sigma(det->cov, 0u), worst_sigma(det->cov, 3u), det->rms_px};
    double want[3] = {c->sigma_pos_max_m, c->sigma_rot_max_rad, c->rms_max_px};
    for (int32_t i = 0; i < 3; i++) {
        if (got[i] > want[i]) {
            kc_event(&out->events, KC_EVT_DET_UNCERTAIN, i, got[i], want[i]);
            return false;
        }
    }
    return true;
}

static bool det_steady(const kc_view_t *view, const kc_frames_t *frames, kc_out_t *out,
                       const kc_detection_t *det)
{
    const kc_config_t *c = &view->tables->config;
    double pos_m = 0.0, rot_rad = 0.0;
    kc_frames_jump(frames, det, &pos_m, &rot_rad);
    if (pos_m > c->jump_pos_m) {
        kc_event(&out->events, KC_EVT_DET_JUMP, 0, pos_m, c->jump_pos_m);
        return false;
    }
    if (rot_rad > c->jump_rot_rad) {
        kc_event(&out->events, KC_EVT_DET_JUMP, 1, rot_rad, c->jump_rot_rad);
        return false;
    }
    return true;
}

/* Well formed, or refused with an event; a frame without tags is well formed. */
static bool det_ok(const kc_view_t *view, kc_out_t *out, const kc_detection_t *det)
{
    if (!within(out, KC_FIELD_DET_N_TAGS, (double)det->n_tags, 0.0, (double)KC_TAG_MAX)) { return false; }
    if (det->n_tags > 0u) { return det_tags(view, out, det) && det_fields(out, det); }
    kc_event(&out->events, KC_EVT_DET_NONE, -1, (double)det->seq, 0.0);
    return true;
}

bool kc_input_observation(const kc_view_t *view, uint64_t newest_us, const kc_detection_t *det, kc_out_t *out)
{
    double age = (double)view->clock->clock_us - (double)det->t_us;
    double limit = (double)view->tables->config.frame_age_max_us;
    uint64_t taken_us = kc_view_elapsed(view, det->t_us);
    if (!not_ahead(view, out, det)) { return false; }
    if (age > limit) {
        kc_event(&out->events, KC_EVT_DET_OLD, -1, age, limit);
        return false;
    }
    if (taken_us <= newest_us) {
        kc_event(&out->events, KC_EVT_IN_STALE, KC_INPUT_DETECTION, (double)taken_us, (double)newest_us);
        return false;
    }
    return det_ok(view, out, det) && det->n_tags > 0u && det_good(view, out, det);
}

void kc_input_detection(kc_input_t *input, kc_request_t *request, const kc_frames_t *frames,
                        const kc_view_t *view, const kc_detection_t *det, kc_out_t *out)
{
    const kc_telemetry_t *t = view->telemetry;
    kc_posture_t at = {&t->arm, &t->pantilt, (double)view->clock->now_us * 1e-6};
    kc_detection_t unflipped = *det;
    if (!det_requested(request, out, det) || !det_age(view, request, out, det) || !det_ok(view, out, det)) {
        return;
    }
    kc_observation_unflip(view->tables, view->latest->coef, &at, &unflipped);
    bool certain = det->n_tags == 0u ||
                   (det_good(view, out, det) && det_steady(view, frames, out, &unflipped));
    input->n_rejected += certain ? 0u : 1u;
    kc_request_answer(request, &unflipped, certain);
}

/* ---- silence ---- */

static bool silent(const kc_view_t *view, kc_out_t *out, kc_sensor_t input, uint64_t ok_us)
{
    uint64_t ago_us = view->clock->now_us - ok_us;
    if (ago_us <= KC_SILENT_US) { return false; }
    kc_event(&out->events, KC_EVT_IN_SILENT, (int32_t)input, (double)ago_us, (double)KC_SILENT_US);
    return true;
}

kc_outcome_t kc_input_silence(const kc_view_t *view, kc_out_t *out)
{
    const kc_telemetry_t *t = view->telemetry;
    if (!kc_states_calibrating(view->place->state)) { return kc_outcome(KC_OC_STAY); }
    if (t->arm.fault_mask != 0) { return kc_abort_for(KC_CAUSE_ARM_FAULT); }
    if (silent(view, out, KC_INPUT_ARM, t->arm_ok_us) ||
        silent(view, out, KC_INPUT_PANTILT, t->pantilt_ok_us)) {
        return kc_abort_for(KC_CAUSE_SILENT);
    }
    return kc_outcome(KC_OC_STAY);
}
