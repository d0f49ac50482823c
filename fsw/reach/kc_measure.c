#include "kc_measure.h"

#include <string.h>

#include "kc_observation.h"

static void fill(const kc_frames_t *f, const kc_view_t *v, kc_meas_t *m)
{
    kc_pantilt_state_t pantilt = v->telemetry->pantilt;
    m->pose = v->plan->n_meas + 1u;
    m->candidate = v->cal->candidate;
    m->replicate = v->cal->replicate;
    m->n_joints = v->tables->arm.n_joints;
    m->arm = v->telemetry->arm;
    kc_frames_mean(f, &v->tables->config, &m->det, &m->arm, &pantilt);
    m->pan_rad = pantilt.pan_rad;
    m->tilt_rad = pantilt.tilt_rad;
    m->n_frames = f->n;
    m->t_us = v->clock->clock_us;
    m->session = v->cal->session;
    memcpy(m->crc, v->tables->crc, sizeof m->crc);
    kc_posture_t at = {&m->arm, &pantilt, (double)v->clock->now_us * 1e-6};
    kc_observation(&v->tables->camera, &m->det, &at, &m->obs);
}

/* All frames are in. */
static kc_outcome_t finish(const kc_frames_t *f, kc_est_t *est, const kc_view_t *v, kc_out_t *out)
{
    fill(f, v, &out->meas);
    if (kc_est_add(est, &out->meas.obs) != KC_OK) { return kc_outcome(KC_OC_SKIP); }
    out->has_meas = 1u;
    return kc_outcome(KC_OC_DONE); /* the estimator gets a step of its own */
}

static kc_outcome_t retry(kc_request_t *r, const kc_view_t *v, kc_outcome_id_t if_so)
{
    return kc_outcome(kc_request_retry(r, v) ? if_so : KC_OC_SKIP);
}

kc_outcome_t kc_measure_run(kc_frames_t *f, kc_request_t *r, kc_est_t *est, const kc_view_t *v, kc_out_t *out)
{
    const kc_telemetry_t *t = v->telemetry;
    if (!kc_view_at_rest(v)) { return retry(r, v, KC_OC_DISTURBED); } /* frames are of one place */
    switch (kc_request_poll(r, v, out)) {
    case KC_FRAME_DETECTED:
        kc_frames_add(f, &r->det, &t->arm, &t->pantilt);
        if (f->n >= v->tables->config.frames_per_meas) { return finish(f, est, v, out); }
        (void)kc_request_poll(r, v, out); /* request the next frame at once */
        return kc_outcome(KC_OC_STAY);
    case KC_FRAME_NO_TAGS: return retry(r, v, KC_OC_STAY);
    case KC_FRAME_UNCERTAIN: return kc_outcome(KC_OC_SKIP);
    case KC_FRAME_TIMEOUT: return kc_abort_for(KC_CAUSE_CAMERA);
    default: return kc_outcome(KC_OC_STAY);
    }
}
