#include "kc_rest.h"

#include "kc_input_fields.h"

void kc_rest_begin(kc_rest_t *rest) { rest->resting = false; }

kc_outcome_t kc_rest_run(kc_rest_t *rest, const kc_view_t *view, kc_out_t *out)
{
    const kc_config_t *c = &view->tables->config;
    bool still = kc_view_at_rest(view), pantilt = view->telemetry->pantilt.moving != 0u;
    uint64_t now_us = view->clock->now_us;
    if (still && !rest->resting) { rest->since_us = now_us; }
    rest->resting = still;
    if (still && now_us - rest->since_us >= c->settle_us) { return kc_outcome(KC_OC_DONE); }
    uint64_t took = kc_view_in_state_us(view);
    if (took <= c->settle_us + c->move_timeout_us) { return kc_outcome(KC_OC_STAY); }
    kc_event(&out->events, KC_EVT_CAL_MOVE_TIMEOUT, pantilt ? KC_INPUT_PANTILT : KC_INPUT_ARM, (double)took,
             0.0);
    return kc_abort_for(pantilt ? KC_CAUSE_PANTILT_LATE : KC_CAUSE_ARM_LATE);
}
