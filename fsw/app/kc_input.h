/* Inputs: accepted whole, or refused with an event and nothing changed. */
#ifndef KC_INPUT_H
#define KC_INPUT_H

#include <stdbool.h>

#include "kc_channels.h"
#include "kc_frames.h"
#include "kc_request.h"
#include "kc_view.h"

typedef struct {
    kc_telemetry_t telemetry;
    int32_t fault_reported;
    uint32_t n_rejected; /* detections that were too uncertain */
} kc_input_t;

void kc_input_telemetry(kc_input_t *input, const kc_view_t *view, const kc_in_t *in, kc_out_t *out);
/* A detection during a calibration: answers the request, with the pose first that the model predicts. frames:
 * those of the measurement, from which it must not differ much. */
void kc_input_detection(kc_input_t *input, kc_request_t *request, const kc_frames_t *frames,
                        const kc_view_t *view, const kc_detection_t *det, kc_out_t *out);
/* Whether a detection outside calibrations is of use: newer than the one at newest_us (elapsed time), recent,
 * and as certain as one of a calibration. */
bool kc_input_observation(const kc_view_t *view, uint64_t newest_us, const kc_detection_t *det,
                          kc_out_t *out);
/* During a calibration: ABORT on a fault of the arm, or on silence. */
kc_outcome_t kc_input_silence(const kc_view_t *view, kc_out_t *out);

#endif
