#include "kc_measure.h"

#include <string.h>

#include "kc_observation.h"

static void fill(const kc_frames_t *frames, kc_taken_at_t taken_at, const kc_view_t *view, kc_meas_t *meas)
{
    kc_pantilt_state_t pantilt = view->telemetry->pantilt;
    meas->pose = view->plan->n_meas + 1u;
    meas->observation = view->plan->n_obs + 1u;
    meas->taken_at = (int32_t)taken_at;
    meas->candidate = view->cal->candidate;
    meas->replicate = view->cal->replicate;
    meas->n_joints = view->tables->arm.n_joints;
    meas->arm = view->telemetry->arm;
    kc_frames_mean(frames, &view->tables->config, &meas->det, &meas->arm, &pantilt);
    meas->pan_rad = pantilt.pan_rad;
    meas->tilt_rad = pantilt.tilt_rad;
    meas->n_frames = frames->n;
    meas->t_us = view->clock->clock_us;
    meas->session = view->cal->session;
    memcpy(meas->crc, view->tables->crc, sizeof meas->crc);
    kc_posture_t at = {&meas->arm, &pantilt, (double)view->clock->now_us * 1e-6};
    kc_observation(&view->tables->camera, &meas->det, &at, &meas->obs);
}

/* All frames are in. */
static kc_outcome_t finish(const kc_frames_t *frames, kc_est_t *est, kc_taken_at_t taken_at,
                           const kc_view_t *view, kc_out_t *out)
{
    fill(frames, taken_at, view, &out->meas);
    if (kc_est_add(est, &out->meas.obs) != KC_OK) { return kc_outcome(KC_OC_SKIP); }
    out->has_meas = 1u;
    return kc_outcome(KC_OC_DONE); /* the estimator gets a step of its own */
}

static kc_outcome_t retry(kc_request_t *request, const kc_view_t *view, kc_outcome_id_t if_so)
{
    return kc_outcome(kc_request_retry(request, view) ? if_so : KC_OC_SKIP);
}

kc_outcome_t kc_measure_run(kc_frames_t *frames, kc_request_t *request, kc_est_t *est, kc_taken_at_t taken_at,
                            const kc_view_t *view, kc_out_t *out)
{
    const kc_telemetry_t *t = view->telemetry;
    if (!kc_view_at_rest(view)) {
        return retry(request, view, KC_OC_DISTURBED);
    } /* frames are of one place */
    if (frames->n >= view->tables->config.frames_per_meas) {
        return finish(frames, est, taken_at, view, out);
    }
    switch (kc_request_poll(request, view, out)) {
    case KC_FRAME_DETECTED:
        kc_frames_add(frames, &request->det, &t->arm, &t->pantilt);
        if (frames->n >= view->tables->config.frames_per_meas) {
            return finish(frames, est, taken_at, view, out);
        }
        (void)kc_request_poll(request, view, out); /* request the next frame at once */
        return kc_outcome(KC_OC_STAY);
    case KC_FRAME_NO_TAGS: return retry(request, view, KC_OC_STAY);
    case KC_FRAME_UNCERTAIN: return kc_outcome(KC_OC_SKIP);
    case KC_FRAME_TIMEOUT: return kc_abort_for(KC_CAUSE_CAMERA);
    default: return kc_outcome(KC_OC_STAY);
    }
}
