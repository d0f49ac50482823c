/* What a candidate is expected to cost, for the acquisition `rate`. */
#ifndef KC_COST_H
#define KC_COST_H

#include "kc_view.h"

/* Seconds, or joules if CONFIG counts those (rate_cost), from where the last pose was measured until this one is: the
 * verified segments and the way from the seed to joints q at the largest speed of each joint, then as many servo
 * steps as the last pose took, and its frames. Moves of the pan-tilt unit fall into those of the arm. > 0. */
double kc_cost_candidate(const kc_view_t *view, uint32_t cand, const double *q);
#define KC_COST_WORK 10000u /* bound of its instructions */

#endif
