/* Why a calibration stopped measuring and proposed: the one place that has the reasons, and their words. A calibration
 * that is aborted proposes nothing; its reason is a kc_cause_t. */
#ifndef KC_ENDED_H
#define KC_ENDED_H

#include <stdint.h>

/* X(number, NAME, "in words"): numbers are in the proposal and never change meaning. */
#define KC_ENDED_LIST(X)                                                                              \
    X(1, REQUIREMENT, "the required accuracy is reached at the required confidence")                  \
    X(2, NO_CHANGE,                                                                                   \
      "the arm agrees with its table, and noise would not have hidden an error as large as required") \
    X(3, POSES, "all requested poses are measured")                                                   \
    X(4, OBSERVATIONS, "no more observations can be held")                                            \
    X(5, TIME, "the time budget is used up")                                                          \
    X(6, ENERGY, "the energy budget is used up")                                                      \
    X(7, CANDIDATES, "no usable candidate is left")

#define KC_ENDED_ENUM_(number, name, text) KC_ENDED_##name = (number),
/* NOT: it goes on, or the software of that time did not say. */
typedef enum {
    KC_ENDED_NOT = 0,
    KC_ENDED_LIST(KC_ENDED_ENUM_) KC_ENDED_COUNT = KC_ENDED_CANDIDATES + 1
} kc_ended_t;

/* "" for a number that is none; never NULL. */
const char *kc_ended_text(int32_t ended);

#endif
