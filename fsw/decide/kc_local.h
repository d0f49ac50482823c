/* When the arm knows itself well enough to leave the park pose: the end of the local initial poses where they are
 * chosen by information (docs/SPACES.md, initial design).
 *
 * With the prior that the errors lie anywhere between their bounds, the least cost of an estimate (chi-square and
 * prior) is that of a chi-square distribution with as many degrees of freedom as rows. An arm outside, whose errors
 * are outside_factor times as large, makes the cost larger by the square of that, in the directions that the
 * observations determine. */
#ifndef KC_LOCAL_H
#define KC_LOCAL_H

#include <stdbool.h>

#include "kc_estimate.h"
#include "kc_tables.h"

/* Whether the observations cast doubt on the arm being inside its bounds, or on each other: the estimate failed, it
 * left an observation out, or its cost is less likely than doubt_p. *p (not NULL): how likely it is, 0 if it failed. */
bool kc_local_doubt(const kc_config_t *config, const kc_est_t *est, kc_status_t status, double *p);

/* Probability that an arm outside casts doubt: by rows of the observations, and the directions that they determine
 * (kc_acq_work_t.known). */
double kc_local_power(const kc_config_t *config, uint32_t rows, double known);
uint32_t kc_local_rows(const kc_est_t *est);
#define KC_LOCAL_DOUBT_COST 100000u /* bounds of their instructions */
#define KC_LOCAL_COST 2000000u

#endif
