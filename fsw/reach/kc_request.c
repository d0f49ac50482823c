#include "kc_request.h"

void kc_request_boot(kc_request_t *request, int32_t seq) { request->seq = seq; }

void kc_request_begin(kc_request_t *request)
{
    request->fails = 0u;
    request->frame = KC_FRAME_NONE;
}

void kc_request_drop(kc_request_t *request) { request->frame = KC_FRAME_NONE; }

void kc_request_answer(kc_request_t *request, const kc_detection_t *det, bool certain)
{
    request->det = *det;
    request->frame = det->n_tags == 0u ? KC_FRAME_NO_TAGS : certain ? KC_FRAME_DETECTED : KC_FRAME_UNCERTAIN;
}

static void ask(kc_request_t *request, const kc_view_t *view, kc_out_t *out)
{
    out->has_frame_request = 1u;
    out->frame_request.seq = ++request->seq;
    request->asked_us = view->clock->now_us;
    request->frame = KC_FRAME_AWAITED;
    request->moved = false;
}

bool kc_request_retry(kc_request_t *request, const kc_view_t *view)
{
    return request->fails++ < view->tables->config.frame_retries;
}

/* Ask once more, or say why not. */
static kc_frame_t again(kc_request_t *request, const kc_view_t *view, kc_out_t *out, kc_frame_t why_not)
{
    if (!kc_request_retry(request, view)) {
        request->frame = KC_FRAME_NONE;
        return why_not;
    }
    ask(request, view, out);
    return KC_FRAME_NONE;
}

kc_frame_t kc_request_poll(kc_request_t *request, const kc_view_t *view, kc_out_t *out)
{
    kc_frame_t frame = request->frame;
    uint64_t took = view->clock->now_us - request->asked_us;
    if (!kc_view_at_rest(view)) { request->moved = true; }
    if (frame == KC_FRAME_NONE) {
        ask(request, view, out);
        return KC_FRAME_NONE;
    }
    if (frame == KC_FRAME_UNCERTAIN) { return again(request, view, out, frame); }
    if (frame != KC_FRAME_AWAITED) {
        request->frame = KC_FRAME_NONE;
        return frame;
    }
    if (took <= view->tables->config.frame_timeout_us) { return KC_FRAME_NONE; }
    kc_event(&out->events, KC_EVT_CAL_FRAME_TIMEOUT, -1, (double)took, 0.0);
    return again(request, view, out, KC_FRAME_TIMEOUT);
}
