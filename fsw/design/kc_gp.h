/* Gaussian process over poses, factor grown by one row a measurement (Cholesky append), with
 * mean and variance of every candidate kept up to date incrementally (GPML Alg. 2.1). */
#ifndef KC_GP_H
#define KC_GP_H

#include <stdint.h>

#include "kc_kernel.h"
#include "kc_limits.h"
#include "kc_work.h"

/* Where a choice of hyperparameters stands between two steps. */
typedef struct {
    uint32_t old, best, h; /* set in force before, best up to now, next one to try */
    uint32_t i;            /* next row of the candidate cache */
    double best_ml;
} kc_gp_choice_t;

/* Caller owns it; the candidate cache is single precision (relative 6e-8, only ranks
 * candidates), everything else double. */
typedef struct {
    const kc_kernel_t *kernel;
    uint32_t hyper;
    uint32_t n, n_cand;
    kc_point_t x[KC_MEAS_MAX];
    double y[KC_MEAS_MAX];
    double L[KC_MEAS_MAX * (KC_MEAS_MAX + 1u) / 2u]; /* packed rows of chol(K + s^2 I) */
    double z[KC_MEAS_MAX];             /* L^-1 y */
    double var[KC_CAND_MAX];           /* posterior variance of candidate */
    float v[KC_MEAS_MAX][KC_CAND_MAX]; /* rows of L^-1 K(X, candidates) */
    kc_gp_choice_t choice;
} kc_gp_t;

/* Empty GP over n_cand candidates. KC_ERR_ARG if n_cand > KC_CAND_MAX or hyper out of range. */
kc_status_t kc_gp_init(kc_gp_t *gp, const kc_kernel_t *kernel, uint32_t hyper, const kc_point_t *cand,
                       uint32_t n_cand);
/* Add a point (y may be changed later). KC_ERR_FULL, KC_ERR_NUM (factor breaks down), gp unchanged.
 * O(n^2 + n n_cand). */
kc_status_t kc_gp_add(kc_gp_t *gp, const kc_point_t *x, double y, const kc_point_t *cand);
/* Replace all y (the DH changed, so every f did): O(n^2). */
void kc_gp_set_y(kc_gp_t *gp, const double *y);
/* Mean of candidate c: O(n). */
double kc_gp_cand_mean(const kc_gp_t *gp, uint32_t c);
/* Posterior at any point, double precision: O(n^2). */
void kc_gp_predict(const kc_gp_t *gp, const kc_point_t *x, double *mean, double *var);
/* ln p(y | X), GPML eq. 2.30. */
double kc_gp_log_marginal(const kc_gp_t *gp);
/* Hyperparameter set with the greatest marginal likelihood; rebuilds the GP on it if it differs from
 * the current one. Returns its index. O(n_hyper n^3 + n^2 n_cand). */
uint32_t kc_gp_choose(kc_gp_t *gp, const kc_point_t *cand);
/* The same in parts: begin, then step, once a step of the process, until it answers true; in between nothing
 * else of the GP may be used. */
void kc_gp_choose_begin(kc_gp_t *gp);
bool kc_gp_choose_step(kc_gp_t *gp, const kc_point_t *cand, kc_work_t *work);
/* Bound of the instructions of kc_gp_add, kc_gp_init or kc_gp_predict. */
uint64_t kc_gp_cost(const kc_gp_t *gp);

#endif
