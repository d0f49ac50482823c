/* Kernel on S3 x R3 (METHOD.md 3): spectral table for the rotation part, Gaussian in position.
 *
 *   k(x, x') = sigma_s^2 k_S3(t) exp(-|p - p'|^2 / (2 beta^2)),  k_S3(t) = sum_n w_n U_n(cos t)
 * with w_n = c_n spectrum_n / C_inf from the ground, summed by Clenshaw's recurrence. */
#ifndef KC_KERNEL_H
#define KC_KERNEL_H

#include <stdint.h>

#include "kc_limits.h"
#include "kc_status.h"

typedef enum {
    KC_KERNEL_SO3 = 0,  /* even n, t = acos|<q,q'>|: heat or Matern kernel of SO(3) */
    KC_KERNEL_PAPER = 1 /* all n, t = d_S3(q,q') of eq. 1, as printed */
} kc_kernel_arg_t;

/* One choice of hyperparameters with its spectral table. */
typedef struct {
    double sigma_s; /* signal standard deviation */
    double beta_m;  /* position length scale [m] */
    double kappa;   /* rotation length scale, for people; w holds it */
    double nu;      /* Matern smoothness, 0 = heat */
    uint32_t n_w;   /* coefficients w_0 .. w_{n_w-1}, degree n = index */
    double w[KC_SPECTRUM_MAX];
    double trunc_err; /* stated bound of what was cut off, relative to k(0) */
} kc_hyper_t;

typedef struct {
    uint8_t arg;      /* kc_kernel_arg_t */
    uint32_t n_hyper; /* >= 1; the first one is used unless chosen on board */
    double sigma_eps; /* noise of f, added as sigma_eps^2 I */
    uint8_t choose;   /* 1: choose the set by marginal likelihood */
    kc_hyper_t hyper[KC_HYPER_MAX];
} kc_kernel_t;

/* A point of S3 x R3. */
typedef struct {
    double q_wxyz[4];
    double p_m[3];
} kc_point_t;

double kc_kernel_rot(const kc_kernel_t *k, uint32_t hyper, const double q1[4], const double q2[4]);
double kc_kernel_eval(const kc_kernel_t *k, uint32_t hyper, const kc_point_t *x1, const kc_point_t *x2);
/* out[i] <- k(x, at[i]), i < n: the same bits, with fewer instructions. */
void kc_kernel_row(const kc_kernel_t *k, uint32_t hyper, const kc_point_t *x, const kc_point_t *at,
                   uint32_t n, double *out);
/* Bound of the instructions of kc_kernel_eval, and of an element of a row; a row takes multiples of four. */
uint64_t kc_kernel_cost(const kc_kernel_t *k);
kc_status_t kc_kernel_validate(const kc_kernel_t *k, int32_t *index, double *got);

#endif
