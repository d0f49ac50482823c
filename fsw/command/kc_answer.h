/* What a command came to: status and reason for its answer, and the outcome for the sequencer. */
#ifndef KC_ANSWER_H
#define KC_ANSWER_H

#include "kc_states.h"
#include "kc_status.h"

typedef struct {
    kc_status_t status;
    kc_event_id_t event; /* why it was refused */
    kc_outcome_t outcome;
} kc_answer_t;

/* Done; the outcome may be STAY. */
kc_answer_t kc_answer_ok(kc_outcome_id_t outcome);
/* Refused: the event is recorded, and is the reason. */
kc_answer_t kc_answer_refuse(kc_events_t *ev, kc_event_id_t id, int32_t index, double got, double want,
                             kc_status_t status);
/* Done, or refused by a function that recorded events itself: the first one since there were `mark`. */
kc_answer_t kc_answer_by(kc_status_t status, const kc_events_t *ev, uint32_t mark, kc_outcome_id_t outcome);

#endif
