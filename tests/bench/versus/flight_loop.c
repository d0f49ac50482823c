/* Flight's functions in loops, through their C interface: what a call takes without that of Python.
 * Compiled and linked as flight is. Each gives processor seconds for so many rounds, and leaves the results
 * of the last one. */
#define _POSIX_C_SOURCE 200809L
#include <string.h>
#include <time.h>

#include "kc_acquire.h"
#include "kc_gp.h"
#include "kc_kernel.h"
#include "kc_model.h"

static double now_s(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Kernel of rotations, n x m. K: row-major, of the last round. */
double loop_kernel(const kc_kernel_t *kernel, const kc_point_t *a, uint32_t n, const kc_point_t *b,
                   uint32_t m, uint32_t rounds, double *K)
{
    const double begun = now_s();
    for (uint32_t r = 0u; r < rounds; r++) {
        for (uint32_t i = 0u; i < n; i++) {
            for (uint32_t j = 0u; j < m; j++) {
                K[i * m + j] = kc_kernel_rot(kernel, 0u, a[i].q_wxyz, b[j].q_wxyz);
            }
        }
    }
    return now_s() - begun;
}

/* A design step: the last of n measurements is new, and the next candidate is chosen. gp: with the n - 1
 * before it; it is left as it was. */
double loop_step(kc_gp_t *gp, kc_gp_t *scratch, const kc_point_t *x, double y, const kc_point_t *cand,
                 const uint8_t *usable, double beta, uint32_t rounds, uint32_t *chosen, double *value)
{
    double took = 0.0;
    for (uint32_t r = 0u; r < rounds; r++) {
        memcpy(scratch, gp, sizeof *gp);
        const double begun = now_s();
        (void)kc_gp_add(scratch, x, y, cand);
        (void)kc_acq_ucb(scratch, usable, beta, chosen, value);
        took += now_s() - begun;
    }
    return took;
}

/* The same from nothing: all n measurements are new. */
double loop_design(kc_gp_t *gp, const kc_kernel_t *kernel, const kc_point_t *x, const double *y, uint32_t n,
                   const kc_point_t *cand, uint32_t n_cand, const uint8_t *usable, double beta,
                   uint32_t rounds, uint32_t *chosen, double *value)
{
    const double begun = now_s();
    for (uint32_t r = 0u; r < rounds; r++) {
        (void)kc_gp_init(gp, kernel, 0u, cand, n_cand);
        for (uint32_t i = 0u; i < n; i++) { (void)kc_gp_add(gp, &x[i], y[i], cand); }
        (void)kc_acq_ucb(gp, usable, beta, chosen, value);
    }
    return now_s() - begun;
}

/* Pose and Jacobians of one joint vector after the other, loads too if they are wanted; coefficients as a fit holds
 * them, for all poses of a pass. */
double loop_model(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                  uint32_t count, uint32_t rounds, uint8_t with_loads, kc_loads_t *loads, kc_eval_t *ev)
{
    const double begun = now_s();
    kc_fixed_t fixed;
    kc_model_fix(arm, terms, coef, &fixed);
    for (uint32_t r = 0u; r < rounds; r++) {
        for (uint32_t i = 0u; i < count; i++) {
            if (with_loads != 0u) { kc_fixed_loads(&fixed, &ctx[i], loads); }
            kc_fixed_eval(&fixed, &ctx[i], loads, true, ev);
        }
    }
    return now_s() - begun;
}
