/* Acquisition, the choice of the next pose: GP-UCB (eq. 7), random, and information criteria. */
#ifndef KC_ACQUIRE_H
#define KC_ACQUIRE_H

#include <stdint.h>

#include "kc_estimate.h"
#include "kc_gp.h"

typedef enum {
    KC_ACQ_UCB = 0,
    KC_ACQ_RANDOM = 1,
    KC_ACQ_DOPT = 2,
    KC_ACQ_VOPT = 3,
    KC_ACQ_RATE = 4, /* information for its cost: dopt or vopt, per second or joule */
    KC_ACQ_COUNT = 5
} kc_acq_t;

/* beta_k = 2 log(|X| k^2 pi^2 / (6 * 0.1)) * scale  (Srinivas et al. 2009, Theorem 1). */
double kc_acq_beta(uint32_t n_cand, uint32_t k, double scale);

/* f of eq. 6 for every measurement from position distance dp_m[i] and rotation distance dr_rad[i];
 * s_p, s_q are the largest so far, but not below the floors. y[i] <= 0. */
void kc_acq_objective(const double *dp_m, const double *dr_rad, uint32_t n, double a1, double sp_floor_m,
                      double sq_floor_rad, double *y);

/* Next candidate by GP-UCB among those with usable[c] != 0. KC_ERR_ARG if none is usable.
 * *value: mu + sqrt(beta) sigma. Ties: lowest index. O(n n_cand). */
kc_status_t kc_acq_ucb(const kc_gp_t *gp, const uint8_t *usable, double beta, uint32_t *c, double *value);
/* Uniform among the usable; *rng advances (deterministic generator). */
kc_status_t kc_acq_random(const uint8_t *usable, uint32_t n_cand, uint64_t *rng, uint32_t *c);

/* Information criteria: candidate's joints q (n_joints each, row-major n_cand x KC_JOINT_MAX, float; those
 * expected at the measurement), measurement covariance cov (6x6).
 * dopt: largest gain of log det of the information, *value = the gain [nat].
 * vopt: least mean predicted pose variance over all candidates (position [m^2] / len_m^2 + rotation
 * [rad^2], len_m > 0), *value = that mean after the measurement.
 * The information is J' W J of the observations in est (but its outliers) at est->coef, the solution of the
 * last solve or, before the first, what the caller put there, plus a prior on every requested coefficient:
 * its own if priors are in use, else KC_ACQ_SIGMA x scale, so that no variance is infinite.
 * Everything a context holds besides joints is taken from the last observation; before the first: gravity of
 * the arm table and zeros.
 * KC_ERR_ARG: nothing usable, no coefficient requested, wrong kind, or cov not positive definite; KC_ERR_NUM:
 * not finite. O((n_obs + n_cand) n_coef^2). */
#define KC_ACQ_SIGMA 1.0

/* What a choice by information is asked for. */
typedef struct {
    kc_acq_t kind; /* dopt or vopt: the measure of information */
    const double *cov; /* 6x6: of the next measurement */
    double len_m;
    /* prior of a coefficient that has none of its own: even between its bounds; else KC_ACQ_SIGMA x scale */
    bool by_bounds;
    bool by_prior; /* that of the estimator (kc_est_t.by_prior) instead */
    double
        safe_m; /* a candidate where the tool's position is less certain than this (1 sigma) is taken only if
                      all are: then the most certain one. 0: they are all alike */
    uint8_t
        *only_safe; /* not NULL: usable, out of which candidates are taken that are not as certain as that */
    const float
        *cost; /* of each candidate, > 0: the gain is taken per unit of it (vopt: that of the logarithm of
                          the variance); NULL: the gain alone */
} kc_acq_ask_t;

typedef struct {
    double M[KC_COEF_MAX * KC_COEF_MAX]; /* covariance, in units of scale */
    double S[KC_COEF_MAX * KC_COEF_MAX]; /* information; then M (sum J'J) M (vopt) */
    double J[KC_COEF_MAX][6]; /* Jacobian of one pose, in those units */
    double prior[KC_COEF_MAX]; /* precision of the prior, in those units */
    uint32_t idx[KC_COEF_MAX], n;
    kc_fixed_t fixed; /* of the estimate */
    kc_eval_t eval;
    /* where the choice stands between two steps (kc_acquire.c) */
    uint8_t phase; /* 0: over */
    uint32_t i; /* next observation or candidate */
    kc_acq_t kind;
    double W[36]; /* whitens a measurement */
    double L[9]; /* and back: the factor of its position's covariance */
    double len_m, total;
    bool by_bounds, by_prior;
    double safe_m2;
    uint8_t *only_safe;
    const float *cost;
    /* its result */
    kc_status_t status;
    uint32_t best;
    double value;
    bool safe; /* the best one is certain enough */
    double sigma2_m2; /* variance of the tool's position there, before it is measured */
    double
        known; /* directions of the coefficients that the observations determine better than the prior, each
                     counted by how much better: 0 ... n */
} kc_acq_work_t;
kc_status_t kc_acq_info(kc_acq_t kind, const kc_est_t *est, const float *q, uint32_t n_cand,
                        const uint8_t *usable, const double cov[36], double len_m, kc_acq_work_t *work,
                        uint32_t *c, double *value);

/* The same in parts: begin, then step, once a step of the process, until it answers true; then work->status,
 * best and value are what kc_acq_info gives. est, q, n_cand and usable may not change between. */
void kc_acq_begin(const kc_acq_ask_t *ask, const kc_est_t *est, kc_acq_work_t *work);
void kc_acq_info_begin(kc_acq_t kind, const kc_est_t *est, const double cov[36], double len_m,
                       kc_acq_work_t *work);
bool kc_acq_info_step(const kc_est_t *est, const float *q, uint32_t n_cand, const uint8_t *usable,
                      kc_acq_work_t *work, kc_work_t *budget);

#endif
