/* States of the sequencer, and the one table that says which comes next. docs/STATES.md shows the same; a test
 * compares them. */
#ifndef KC_STATES_H
#define KC_STATES_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_events.h"

typedef enum {
    KC_ST_IDLE = 0,
    KC_ST_MOVE = 1, /* along a verified path to the candidate, or to a stop on it */
    KC_ST_AIM = 2, /* pan-tilt unit turns to the tool */
    KC_ST_SETTLE = 3, /* arm and pan-tilt unit come to rest */
    KC_ST_OBSERVE = 4, /* frame requested, servo decides */
    KC_ST_SERVO = 5, /* servo step under way */
    KC_ST_SEARCH = 6, /* tags not in view: frame requested at a search position */
    KC_ST_MEASURE = 7, /* several frames at rest, at the candidate or on the way to it */
    KC_ST_UPDATE = 8, /* estimate with the newest pose */
    KC_ST_REVIEW = 9, /* correction proposed, waits for the ground */
    KC_ST_ARMED = 10, /* first approval step received */
    KC_ST_SAFE = 11, /* aborted: arm held, waits for START or ROLLBACK */
    KC_ST_SEED = 12, /* no tags: the arm moves to the seed */
    KC_ST_RETREAT = 13, /* tags lost: the arm returns to where they were detected last */
    KC_ST_WITHDRAW = 14, /* approach: every joint moves back to one side */
    KC_ST_APPROACH = 15, /* approach: and comes from there */
    KC_ST_REST = 16, /* at rest again before measuring */
    KC_ST_TURN = 17, /* pan-tilt unit turns to the next search position */
    KC_ST_REFINE = 18, /* second start if the first estimate is not good */
    KC_ST_LEARN = 19, /* outliers, model mismatch, Gaussian process */
    KC_ST_REPORT = 20, /* predicted uncertainty, progress */
    KC_ST_SELECT = 21, /* next candidate, or finish */
    KC_ST_PROPOSE = 22, /* verdict and proposal */
    KC_ST_STORE = 23 /* a change is stored, read back, and made then */
} kc_state_t;

#define KC_ST_COUNT ((uint32_t)KC_ST_STORE + 1u)

/* What a state's work or a command came to. */
typedef enum {
    KC_OC_STAY = 0, /* the state goes on */
    KC_OC_DONE,
    KC_OC_SKIP, /* the candidate is skipped */
    KC_OC_ABORT, /* for a cause */
    /* of OBSERVE and SEARCH; SERVO also of MEASURE, on the way */
    KC_OC_SERVO,
    KC_OC_ONWARD, /* and of MEASURE, at a stop */
    KC_OC_MEASURE,
    KC_OC_APPROACH,
    KC_OC_SEED,
    KC_OC_RETREAT,
    KC_OC_SEARCH,
    /* of MEASURE */
    KC_OC_DISTURBED,
    /* of LEARN; of SELECT: the calibration begins again */
    KC_OC_AGAIN,
    /* of SELECT and PROPOSE */
    KC_OC_FINISH,
    KC_OC_REVIEW,
    /* of commands, time-outs and budgets */
    KC_OC_START,
    KC_OC_ARM,
    KC_OC_EXPIRE,
    KC_OC_STORE,
    /* of STORE, for a table or a rollback that began in SAFE */
    KC_OC_SAFE
} kc_outcome_id_t;

typedef struct {
    kc_outcome_id_t id;
    kc_cause_t cause; /* of ABORT */
} kc_outcome_t;

static inline kc_outcome_t kc_outcome(kc_outcome_id_t id) { return (kc_outcome_t){id, KC_CAUSE_COMMAND}; }
static inline kc_outcome_t kc_abort_for(kc_cause_t cause) { return (kc_outcome_t){KC_OC_ABORT, cause}; }

/* state x outcome -> next state, and when its work begins: in the same step, or one step later.
 * CALIBRATING stands for every state of a calibration, ANY for every state. */
#define KC_TRANSITION_LIST(X)                  \
    X(IDLE, START, SELECT, SAME_STEP)          \
    X(SAFE, START, SELECT, SAME_STEP)          \
    X(SELECT, DONE, MOVE, NEXT_STEP)           \
    X(SELECT, SKIP, SELECT, NEXT_STEP)         \
    X(SELECT, AGAIN, SELECT, NEXT_STEP)        \
    X(SELECT, FINISH, PROPOSE, SAME_STEP)      \
    X(MOVE, DONE, AIM, SAME_STEP)              \
    X(MOVE, SKIP, SELECT, SAME_STEP)           \
    X(AIM, DONE, SETTLE, SAME_STEP)            \
    X(SETTLE, DONE, OBSERVE, SAME_STEP)        \
    X(OBSERVE, SERVO, SERVO, NEXT_STEP)        \
    X(OBSERVE, MEASURE, MEASURE, SAME_STEP)    \
    X(OBSERVE, APPROACH, WITHDRAW, NEXT_STEP)  \
    X(OBSERVE, SEED, SEED, NEXT_STEP)          \
    X(OBSERVE, RETREAT, RETREAT, NEXT_STEP)    \
    X(OBSERVE, SEARCH, TURN, NEXT_STEP)        \
    X(OBSERVE, SKIP, SELECT, SAME_STEP)        \
    X(OBSERVE, ONWARD, MOVE, NEXT_STEP)        \
    X(SERVO, DONE, AIM, SAME_STEP)             \
    X(SERVO, SKIP, SELECT, SAME_STEP)          \
    X(SEED, DONE, AIM, SAME_STEP)              \
    X(SEED, SKIP, SELECT, NEXT_STEP)           \
    X(RETREAT, DONE, AIM, SAME_STEP)           \
    X(RETREAT, SKIP, SELECT, SAME_STEP)        \
    X(WITHDRAW, DONE, APPROACH, NEXT_STEP)     \
    X(WITHDRAW, SKIP, SELECT, NEXT_STEP)       \
    X(APPROACH, DONE, REST, NEXT_STEP)         \
    X(APPROACH, SKIP, SELECT, NEXT_STEP)       \
    X(REST, DONE, MEASURE, SAME_STEP)          \
    X(TURN, DONE, SEARCH, SAME_STEP)           \
    X(TURN, SKIP, SELECT, SAME_STEP)           \
    X(SEARCH, DONE, AIM, SAME_STEP)            \
    X(SEARCH, SEARCH, TURN, NEXT_STEP)         \
    X(MEASURE, DONE, UPDATE, NEXT_STEP)        \
    X(MEASURE, SERVO, SERVO, NEXT_STEP)        \
    X(MEASURE, ONWARD, MOVE, NEXT_STEP)        \
    X(MEASURE, DISTURBED, REST, NEXT_STEP)     \
    X(MEASURE, SKIP, SELECT, SAME_STEP)        \
    X(UPDATE, DONE, REFINE, NEXT_STEP)         \
    X(REFINE, DONE, LEARN, NEXT_STEP)          \
    X(LEARN, DONE, REPORT, NEXT_STEP)          \
    X(LEARN, AGAIN, UPDATE, NEXT_STEP)         \
    X(REPORT, DONE, SELECT, NEXT_STEP)         \
    X(CALIBRATING, FINISH, PROPOSE, SAME_STEP) \
    X(PROPOSE, DONE, IDLE, NEXT_STEP)          \
    X(PROPOSE, STORE, STORE, SAME_STEP)        \
    X(REVIEW, ARM, ARMED, NEXT_STEP)           \
    X(REVIEW, STORE, STORE, SAME_STEP)         \
    X(ARMED, STORE, STORE, SAME_STEP)          \
    X(ARMED, EXPIRE, REVIEW, NEXT_STEP)        \
    X(IDLE, STORE, STORE, SAME_STEP)           \
    X(SAFE, STORE, STORE, SAME_STEP)           \
    X(STORE, DONE, IDLE, NEXT_STEP)            \
    X(STORE, REVIEW, REVIEW, NEXT_STEP)        \
    X(STORE, SAFE, SAFE, NEXT_STEP)            \
    X(ANY, ABORT, SAFE, NEXT_STEP)

typedef struct {
    kc_state_t state;
    bool same_step;
} kc_next_t;

/* Whether a state belongs to a calibration: the arm may move. */
bool kc_states_calibrating(kc_state_t state);
/* Whether a state works on the newest pose, or on the proposal: budgets wait for it. */
bool kc_states_estimating(kc_state_t state);
/* Row of the table. An outcome that a state does not have leaves it: {state, false}. */
kc_next_t kc_states_next(kc_state_t state, kc_outcome_id_t outcome);

#endif
