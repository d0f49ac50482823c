#include "kc_answer.h"

kc_answer_t kc_answer_ok(kc_outcome_id_t outcome)
{
    return (kc_answer_t){KC_OK, KC_EVT_NONE, kc_outcome(outcome)};
}

kc_answer_t kc_answer_refuse(kc_events_t *ev, kc_event_id_t id, int32_t index, double got, double want,
                             kc_status_t status)
{
    kc_event(ev, id, index, got, want);
    return (kc_answer_t){status, id, kc_outcome(KC_OC_STAY)};
}

kc_answer_t kc_answer_by(kc_status_t status, const kc_events_t *ev, uint32_t mark, kc_outcome_id_t outcome)
{
    if (status == KC_OK) { return kc_answer_ok(outcome); }
    uint32_t first = mark < ev->n ? mark : ev->n - 1u; /* the same event was there already, or no room */
    kc_event_id_t why = ev->n > 0u ? (kc_event_id_t)ev->e[first].id : KC_EVT_NONE;
    return (kc_answer_t){status, why, kc_outcome(KC_OC_STAY)};
}
