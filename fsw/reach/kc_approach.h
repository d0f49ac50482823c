/* The approach: last motion before a measurement. Backlash, friction and wind-up displace a joint by an
 * amount that depends on the side from which it came, and a servo always comes from the side of its error.
 * If CONFIG enables it, every joint moves back by approach_rad to a side chosen at random (WITHDRAW) and comes
 * from there (APPROACH), so that both sides occur and the effect can be identified later. */
#ifndef KC_APPROACH_H
#define KC_APPROACH_H

#include <stdbool.h>

#include "kc_view.h"

/* Whether CONFIG enables it here: never at local initial poses. */
bool kc_approach_wanted(const kc_view_t *view);
/* Joints from which the arm comes to q_meas again, inside limits and servo bound; *rng advances. */
void kc_approach_start(const kc_view_t *view, uint64_t *rng, const double *q_meas, double *q);

#endif
