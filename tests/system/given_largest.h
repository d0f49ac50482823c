/* The small world with everything at its limits (kc_limits.h): joints, coefficients, terms, candidates, hubs,
 * bodies, volumes, hyperparameters. */
#ifndef GIVEN_LARGEST_H
#define GIVEN_LARGEST_H

#include <stdint.h>

#include "kc_model.h"

/* The tables, instead of those of given_world(); acq: kc_acq_t. */
void given_largest(uint8_t acq);
/* After START: n poses (of candidates 1 .. n, one in five an outlier) are measured already. */
void given_poses(uint32_t n);
/* What would be measured at candidate i. */
void given_observation(uint32_t i, kc_obs_t *o);

#endif
