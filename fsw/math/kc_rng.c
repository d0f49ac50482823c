#include "kc_rng.h"

/* Draws that kc_rng_below may reject; each is rejected with a chance below one half. */
#define KC_RNG_TRIES 128

uint64_t kc_rng_next(uint64_t *state)
{
    *state += 0x9E3779B97F4A7C15u;
    uint64_t z = *state;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

double kc_rng_uniform(uint64_t *state) { return (double)(kc_rng_next(state) >> 11) * 0x1p-53; }

uint32_t kc_rng_below(uint64_t *state, uint32_t n)
{
    if (n == 0u) { return 0u; }
    /* Keep only draws below the largest multiple of n, so that every answer is equally likely. */
    const uint64_t limit = 0x100000000u - 0x100000000u % n;
    uint64_t draw = 0u;
    for (int i = 0; i < KC_RNG_TRIES; i++) {
        draw = kc_rng_next(state) >> 32;
        if (draw < limit) { break; }
    }
    return (uint32_t)(draw % n);
}
