/* Deterministic generator (splitmix64, Steele, Lea and Flood 2014): the whole state is one number,
 * so it can be stored, sent and repeated. Not for secrets. */
#ifndef KC_RNG_H
#define KC_RNG_H

#include <stdint.h>

uint64_t kc_rng_next(uint64_t *state);
/* Uniform in [0, 1), 53 bits. */
double kc_rng_uniform(uint64_t *state);
/* Uniform in 0 .. n-1 without bias; 0 if n = 0. */
uint32_t kc_rng_below(uint64_t *state, uint32_t n);

#endif
