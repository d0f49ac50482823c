/* MEASURE: several frames at rest become one observation, at a candidate or on the way to it. */
#ifndef KC_MEASURE_H
#define KC_MEASURE_H

#include "kc_channels.h"
#include "kc_frames.h"
#include "kc_request.h"
#include "kc_view.h"

/* DONE: the measurement is in *out and in the estimator; DISTURBED: arm or pan-tilt unit moved, the frames are
 * dropped; SKIP: too many frames of no use, or the estimator refuses. */
kc_outcome_t kc_measure_run(kc_frames_t *frames, kc_request_t *request, kc_est_t *est, kc_taken_at_t taken_at,
                            const kc_view_t *view, kc_out_t *out);

#endif
