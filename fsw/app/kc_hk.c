#include "kc_hk.h"

#define PERIOD_US 1000000u

bool kc_hk_count(kc_hk_state_t *counts, uint64_t now_us, const kc_out_t *out)
{
    counts->n_meas += out->has_meas ? 1u : 0u;
    counts->n_events += out->events.n;
    counts->n_dropped += out->events.dropped;
    if (out->events.n > 0u) { counts->last_event_id = (int32_t)out->events.e[out->events.n - 1u].id; }
    if (now_us < counts->due_us) { return false; }
    counts->due_us = now_us + PERIOD_US;
    return true;
}

void kc_hk_fill(kc_hk_state_t *counts, kc_hk_t *hk)
{
    hk->seq = ++counts->seq;
    hk->n_meas = counts->n_meas;
    hk->n_events = counts->n_events;
    hk->n_events_dropped = counts->n_dropped;
    hk->last_event_id = counts->last_event_id;
}
