/* Housekeeping: once a second, what the component is doing. */
#ifndef KC_HK_H
#define KC_HK_H

#include "kc_channels.h"

/* Counts, and when the next report is due. */
typedef struct {
    uint64_t due_us; /* elapsed time */
    int32_t seq;
    uint32_t n_meas, n_events, n_dropped;
    int32_t last_event_id;
} kc_hk_state_t;

/* Count what a step brought; whether a report is due. */
bool kc_hk_count(kc_hk_state_t *counts, uint64_t now_us, const kc_out_t *out);
/* Fill in the counts. */
void kc_hk_fill(kc_hk_state_t *counts, kc_hk_t *hk);

#endif
