/* Parts of the estimator, one job a file; nobody outside fsw/estimate includes this.
 *
 * A "fit" works on the coefficients est->idx[0 .. n_idx-1]; all others keep their values in the vector
 * that is passed. R, its right-hand side z (column n_idx) and steps are in that order. */
#ifndef KC_EST_PRIV_H
#define KC_EST_PRIV_H

#include "kc_estimate.h"

#define KC_EST_LD (KC_COEF_MAX + 1u)

/* Sums over the inliers at one vector of coefficients. */
typedef struct {
    double chi2;           /* whitened squared residuals */
    double prior;          /* squared prior terms */
    double pos2, rot2;     /* squared residuals [m^2], [rad^2] */
    uint32_t n_pos, n_rot; /* poses behind them */
    uint32_t rows;
} kc_est_sums_t;

/* -- kc_est_linear.c: residuals, R and priors -- */

/* Whitened rows of observation i at coef into est->blk, (n_idx + 1) wide: [J | r]. Returns the number
 * of rows; raw (if not NULL) gets the residual in m and rad. */
uint32_t kc_est_block(kc_est_t *est, const double *coef, uint32_t i, double raw[6]);
/* Residual sums at coef, priors as kc_est_prior_precision says. */
void kc_est_sums(kc_est_t *est, const double *coef, kc_est_sums_t *s);
/* R and z of the data at coef. */
void kc_est_fold_data(kc_est_t *est, const double *coef);
/* R and z of data and priors at est->coef. */
void kc_est_linearise(kc_est_t *est);
/* 1/sigma of the prior of coefficient c, and its mean; 0 if there is none. */
double kc_est_prior_precision(const kc_est_t *est, uint32_t c, double *centre);
/* Rows of the inliers. */
uint32_t kc_est_rows(const kc_est_t *est);

/* -- kc_ident.c -- */

/* Rank of the coefficients in mask, at coef, by the data alone; idx = those, in order. cond, perm, pivot
 * stay in est for the report; F (n_coef^2 values) gets the factored columns, ld n_idx. */
uint32_t kc_est_rank(kc_est_t *est, uint64_t mask, const double *coef, double *F);
/* Decide at coef which of `requested` are estimated and which held: status, confounded, rank, idx, weak. */
void kc_est_identify(kc_est_t *est, uint64_t requested, const double *coef);
/* Whether that decision still stands at est->coef: neither more nor fewer could be estimated. idx stays. */
int kc_est_still_identified(kc_est_t *est, uint64_t requested);

/* -- kc_est_fit.c -- */

/* Damped Gauss-Newton on idx from est->coef. KC_OK, KC_ERR_ITER or KC_ERR_NUM. */
kc_status_t kc_est_fit(kc_est_t *est);
/* Largest scaled projected gradient at est->coef; marks active bounds in status. */
double kc_est_kkt(kc_est_t *est, double cost);

/* -- kc_outlier.c -- */

/* The inlier whose deleted residual is least likely; *p its probability times the number of inliers
 * whose residual has a meaning. Returns n_obs if there is none. */
uint32_t kc_est_worst(kc_est_t *est, double chi2, double *p);

#endif
