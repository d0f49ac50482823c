#include "kc_request.h"

void kc_request_boot(kc_request_t *r, int32_t seq) { r->seq = seq; }

void kc_request_begin(kc_request_t *r)
{
    r->fails = 0u;
    r->frame = KC_FRAME_NONE;
}

void kc_request_drop(kc_request_t *r) { r->frame = KC_FRAME_NONE; }

void kc_request_answer(kc_request_t *r, const kc_detection_t *det, bool certain)
{
    r->det = *det;
    r->frame = det->n_tags == 0u ? KC_FRAME_NO_TAGS : certain ? KC_FRAME_DETECTED : KC_FRAME_UNCERTAIN;
}

static void ask(kc_request_t *r, const kc_view_t *v, kc_out_t *out)
{
    out->has_frame_request = 1u;
    out->frame_request.seq = ++r->seq;
    r->asked_us = v->clock->now_us;
    r->frame = KC_FRAME_AWAITED;
}

bool kc_request_retry(kc_request_t *r, const kc_view_t *v)
{
    return r->fails++ < v->tables->config.frame_retries;
}

/* Ask once more, or say why not. */
static kc_frame_t again(kc_request_t *r, const kc_view_t *v, kc_out_t *out, kc_frame_t why_not)
{
    if (!kc_request_retry(r, v)) {
        r->frame = KC_FRAME_NONE;
        return why_not;
    }
    ask(r, v, out);
    return KC_FRAME_NONE;
}

kc_frame_t kc_request_poll(kc_request_t *r, const kc_view_t *v, kc_out_t *out)
{
    kc_frame_t frame = r->frame;
    uint64_t took = v->clock->now_us - r->asked_us;
    if (frame == KC_FRAME_NONE) {
        ask(r, v, out);
        return KC_FRAME_NONE;
    }
    if (frame == KC_FRAME_UNCERTAIN) { return again(r, v, out, frame); }
    if (frame != KC_FRAME_AWAITED) {
        r->frame = KC_FRAME_NONE;
        return frame;
    }
    if (took <= v->tables->config.frame_timeout_us) { return KC_FRAME_NONE; }
    kc_event(&out->events, KC_EVT_CAL_FRAME_TIMEOUT, -1, (double)took, 0.0);
    return again(r, v, out, KC_FRAME_TIMEOUT);
}
