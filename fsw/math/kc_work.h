/* How much one step may still compute.
 *
 * What takes long is cut into units: one observation, one iteration, one candidate. Before a unit is begun it
 * is charged with a bound of its instructions, which the code that does it computes from the sizes at hand. A
 * unit that does not fit waits for the next step, unless nothing was computed in this one. So a step computes
 * at most `most`, or one unit; where it stands is kept between steps, and the order of operations, hence every
 * bit of a result, does not depend on `most`. tests/bench/wcet.c compares charges with what is executed. */
#ifndef KC_WORK_H
#define KC_WORK_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_limits.h"

typedef struct {
    uint64_t most, used; /* instructions */
} kc_work_t;

/* Of one step, and all at once. */
static inline kc_work_t kc_work_of_step(void) { return (kc_work_t){KC_STEP_WORK, 0u}; }
static inline kc_work_t kc_work_unlimited(void) { return (kc_work_t){UINT64_MAX, 0u}; }

/* Charge a unit: true if it may be done now, false if it waits. */
static inline bool kc_work_take(kc_work_t *w, uint64_t cost)
{
    if (w->used > 0u && w->used + cost > w->most) { return false; }
    w->used += cost;
    return true;
}

/* Give back what a unit that was charged did not use. */
static inline void kc_work_return(kc_work_t *w, uint64_t cost) { w->used -= cost; }

/* Charge what is not put off. */
static inline void kc_work_spend(kc_work_t *w, uint64_t cost) { w->used += cost; }

#endif
