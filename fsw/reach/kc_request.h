/* Frames: requested, awaited, requested again. Only kc_request.c changes a kc_request_t. */
#ifndef KC_REQUEST_H
#define KC_REQUEST_H

#include <stdbool.h>

#include "kc_channels.h"
#include "kc_view.h"

typedef enum {
    KC_FRAME_NONE = 0, /* nothing requested */
    KC_FRAME_AWAITED = 1,
    KC_FRAME_DETECTED = 2,
    KC_FRAME_NO_TAGS = 3,
    KC_FRAME_UNCERTAIN = 4, /* from polling: in spite of all retries */
    KC_FRAME_TIMEOUT = 5    /* from polling: none came */
} kc_frame_t;

typedef struct {
    kc_frame_t frame;
    bool moved;     /* arm or pan-tilt unit moved since the frame was requested */
    uint32_t fails; /* frames of no use since kc_request_begin */
    uint64_t asked_us;
    int32_t seq;        /* of the last request */
    kc_detection_t det; /* of the newest frame */
} kc_request_t;

/* Boot: requests count on from seq. */
void kc_request_boot(kc_request_t *request, int32_t seq);
/* Nothing requested, no fails. */
void kc_request_begin(kc_request_t *request);
/* Forget what was requested; fails stay counted. */
void kc_request_drop(kc_request_t *request);
/* The frame that was awaited is here. */
void kc_request_answer(kc_request_t *request, const kc_detection_t *det, bool certain);
/* Request a frame if none is; NONE while it is awaited, else what came. An uncertain or missing frame is
 * requested again, frame_retries times. */
kc_frame_t kc_request_poll(kc_request_t *request, const kc_view_t *view, kc_out_t *out);
/* Count a frame of no use: whether another one may be tried. */
bool kc_request_retry(kc_request_t *request, const kc_view_t *view);

#endif
