#include "kc_states.h"

/* Groups of states, beside the states themselves. */
enum { KC_ST_CALIBRATING = KC_ST_COUNT, KC_ST_ANY };
enum { NEXT_STEP = 0, SAME_STEP = 1 };

typedef struct {
    uint8_t from, outcome, to, same_step;
} row_t;

#define ROW_(from, outcome, to, when) {KC_ST_##from, KC_OC_##outcome, KC_ST_##to, (when)},
static const row_t s_row[] = {KC_TRANSITION_LIST(ROW_)};
#define ROW_N (sizeof s_row / sizeof s_row[0])

bool kc_states_calibrating(kc_state_t state)
{
    return state != KC_ST_IDLE && state != KC_ST_REVIEW && state != KC_ST_ARMED && state != KC_ST_SAFE &&
           state != KC_ST_STORE;
}

bool kc_states_estimating(kc_state_t state)
{
    return state == KC_ST_UPDATE || state == KC_ST_REFINE || state == KC_ST_LEARN || state == KC_ST_REPORT ||
           state == KC_ST_PROPOSE;
}

static bool covers(uint8_t from, kc_state_t state)
{
    return from == (uint8_t)state || from == (uint8_t)KC_ST_ANY ||
           (from == (uint8_t)KC_ST_CALIBRATING && kc_states_calibrating(state));
}

kc_next_t kc_states_next(kc_state_t state, kc_outcome_id_t outcome)
{
    for (uint32_t i = 0u; i < ROW_N; i++) {
        if (s_row[i].outcome == (uint8_t)outcome && covers(s_row[i].from, state)) {
            return (kc_next_t){(kc_state_t)s_row[i].to, s_row[i].same_step == (uint8_t)SAME_STEP};
        }
    }
    return (kc_next_t){state, false};
}
