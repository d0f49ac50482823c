#include "kc_hk.h"

#define PERIOD_US 1000000u

bool kc_hk_count(kc_hk_state_t *s, uint64_t now_us, const kc_out_t *out)
{
    s->n_meas += out->has_meas ? 1u : 0u;
    s->n_events += out->events.n;
    s->n_dropped += out->events.dropped;
    if (out->events.n > 0u) { s->last_event_id = (int32_t)out->events.e[out->events.n - 1u].id; }
    if (now_us < s->due_us) { return false; }
    s->due_us = now_us + PERIOD_US;
    return true;
}

void kc_hk_fill(kc_hk_state_t *s, kc_hk_t *hk)
{
    hk->seq = ++s->seq;
    hk->n_meas = s->n_meas;
    hk->n_events = s->n_events;
    hk->n_events_dropped = s->n_dropped;
    hk->last_event_id = s->last_event_id;
}
