/* SETTLE and REST: arm and pan-tilt unit come to rest. */
#ifndef KC_REST_H
#define KC_REST_H

#include <stdbool.h>

#include "kc_channels.h"
#include "kc_view.h"

typedef struct {
    bool resting;
    uint64_t since_us; /* elapsed time, while resting */
} kc_rest_t;

void kc_rest_begin(kc_rest_t *rest);
/* DONE after settle_us at rest. */
kc_outcome_t kc_rest_run(kc_rest_t *rest, const kc_view_t *view, kc_out_t *out);

#endif
