/* Parts of the estimator, one job a file; nobody outside fsw/estimate includes this.
 *
 * A "fit" works on the coefficients est->idx[0 .. n_idx-1]; all others keep their values in the vector
 * that is passed. Steps are in that order. R and its right-hand side z (column n_column) have the columns of
 * est->column[0 .. n_column-1]: of all that are requested, until kc_est_narrow() leaves those of the fit. */
#ifndef KC_EST_PRIV_H
#define KC_EST_PRIV_H

#include <stdbool.h>

#include "kc_estimate.h"

#define KC_EST_LD (KC_COEF_MAX + 1u)

/* What is computed observation by observation (inliers only), or iteration by iteration. */
typedef enum {
    KC_EST_PASS_NONE,    /* nothing: what the phase needs is there */
    KC_EST_PASS_FOLD,    /* job.sums, and R and z of the data, at job.at */
    KC_EST_PASS_CHAIN,   /* sums of est->chain; R of data and priors is there */
    KC_EST_PASS_OUTLIER, /* job.worst, job.p_worst, job.n_tested; R of data and priors is there */
    KC_EST_PASS_QP       /* the QP */
} kc_est_pass_t;

/* -- kc_est_linear.c: residuals, R and priors -- */

/* The coefficients in mask, in order; how many. */
uint32_t kc_est_list(const kc_est_t *est, uint64_t mask, uint32_t *list);
/* Whitened rows of observation i in a pass, at its coefficients, into est->blk, column after column: [J | r]. Returns
 * the number of rows; those that are missing are zero. raw: the residual in m and rad. */
uint32_t kc_est_block(kc_est_t *est, uint32_t i, double raw[6]);
/* Begin a pass at coef, which may not change before it is over; its work on observation i. */
void kc_est_pass_begin(kc_est_t *est, kc_est_pass_t pass, const double *coef);
void kc_est_fold(kc_est_t *est, uint32_t i);
/* Squares of what the priors say against coef. */
double kc_est_prior_cost(const kc_est_t *est, const double *coef);
/* R and z lose the columns that are not in idx. */
void kc_est_narrow(kc_est_t *est);
/* They get the priors at est->coef, once, after that. */
void kc_est_fold_prior(kc_est_t *est);
/* 1/sigma of the prior of coefficient c, and its mean; 0 if there is none. */
double kc_est_prior_precision(const kc_est_t *est, uint32_t c, double *centre);
/* Rows of the inliers. */
uint32_t kc_est_rows(const kc_est_t *est);

/* -- kc_ident.c -- */

/* Rank of the columns of R, which the data alone made. cond, perm, pivot stay in est for the
 * report; F (n_coef^2 values) gets the factored columns, ld n_column. */
uint32_t kc_est_rank(kc_est_t *est, double *F);
/* Decide by R of all `requested` which of them are estimated and which held: status, confounded, rank, idx,
 * weak. */
void kc_est_identify(kc_est_t *est, uint64_t requested);

/* -- kc_est_fit.c: the parts of a damped Gauss-Newton step on idx from est->coef -- */

typedef enum { KC_EST_STEP_TAKEN, KC_EST_STEP_LAST, KC_EST_STEP_AGAIN, KC_EST_STEP_NONE } kc_est_step_t;

/* Model of the cost by R and z; lambda, cost stay in est->job. */
void kc_est_model(kc_est_t *est);
/* Begin the QP with the damping of now; KC_EST_STEP_NONE if that is exhausted, else AGAIN. */
kc_est_step_t kc_est_try(kc_est_t *est);
/* est->trial = coef + step of the QP. */
void kc_est_trial(kc_est_t *est);
/* Take the step if the cost at est->trial does not rise (job.fresh: R and sums are then those of est->coef); AGAIN with
 * more damping. */
kc_est_step_t kc_est_compare(kc_est_t *est, double trial_cost);
/* Largest scaled projected gradient at est->coef by R and z; marks active bounds in status. */
double kc_est_kkt(kc_est_t *est, double cost);

/* -- kc_est_chain.c: errors of the camera chain, while outliers are looked for (METHOD.md 6.1) -- */

/* Add observation i to the sums, which begin with zeros; then the end, once. */
void kc_est_chain_add(kc_est_t *est, uint32_t i);
void kc_est_chain_end(kc_est_t *est);
/* What those errors take off the chi-square of the fit. */
double kc_est_chain_explains(const kc_est_t *est);
/* Of observation i: whitened residual w and the lower triangle S of its covariance after the fit of the coefficients
 * become those after a fit of the errors too. T = R^-T J' of it, column after column. */
void kc_est_chain_correct(const kc_est_t *est, uint32_t i, const double *T, double w[6], double S[36]);

/* -- kc_outlier.c -- */

/* Test inlier i: job.worst = the one whose deleted residual is least likely (n_obs: none), job.p_worst = its
 * probability, job.n_tested = inliers whose residual has a meaning. job.sums: of all. */
void kc_est_outlier_test(kc_est_t *est, uint32_t i);

/* -- kc_estimate.c -- */

bool kc_est_options_good(const kc_est_t *est);
uint64_t kc_est_requested(const kc_est_t *est);
/* Outputs as before the first fit; the coefficients `which` at their start. */
void kc_est_reset(kc_est_t *est, uint64_t requested);
void kc_est_to_start(kc_est_t *est, uint64_t which, uint64_t requested);
uint64_t kc_est_held(const kc_est_t *est);
/* RMS of the sums, 0 if nothing was summed. */
double kc_est_rms(double sum2, uint32_t n);
/* idx = the estimated coefficients that are not at a bound. */
void kc_est_take_inside(kc_est_t *est);
/* Their covariance by R. */
kc_status_t kc_est_covariance(kc_est_t *est);

#endif
