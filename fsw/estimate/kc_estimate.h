/* What is wrong with the arm: eq. 8-11 with masks, bounds, priors, covariance weights,
 * outlier rejection, line search, and a report of what the data cannot tell.
 *
 * Linear algebra is square-root information: each pose's whitened 6 x n block is folded
 * into an upper-triangular R by Householder reflections, so neither J nor J'J of all poses
 * is ever stored and the condition number is not squared before rank is judged. */
#ifndef KC_ESTIMATE_H
#define KC_ESTIMATE_H

#include <stdint.h>

#include "kc_limits.h"
#include "kc_model.h"
#include "kc_qp.h"

typedef enum {
    KC_COEF_ESTIMATED = 0,
    KC_COEF_MASKED = 1,   /* not asked for                                         */
    KC_COEF_HELD = 2,     /* dependent on others: held at its start value          */
    KC_COEF_AT_LOWER = 3, /* estimated, the bound is active                        */
    KC_COEF_AT_UPPER = 4
} kc_coef_status_t;

typedef struct {
    uint64_t free_mask;      /* bit per coefficient to estimate; others keep start[]  */
    uint32_t iter_max;       /* Gauss-Newton iterations, 1..100                       */
    double tol_step;         /* converged when every step < tol_step * scale          */
    double rank_tol;         /* a scaled pivot below rank_tol * largest is dependent  */
    double outlier_p;        /* family-wise chance of rejecting a good pose, 0 = off  */
    uint32_t outlier_max;    /* at most this many are rejected                        */
    uint8_t use_prior;       /* add (coef / prior_sigma)^2 where prior_sigma > 0      */
} kc_est_opt_t;

/* Caller owns it (static); about 140 KiB with work space. */
typedef struct {
    /* in */
    const kc_arm_t *arm;
    const kc_terms_t *terms;
    kc_est_opt_t opt;
    uint32_t n_obs;
    kc_obs_t obs[KC_MEAS_MAX];
    double start[KC_COEF_MAX];
    /* out */
    double coef[KC_COEF_MAX];
    double sigma[KC_COEF_MAX];               /* 1-sigma at noise scale 1; 0 if not estimated */
    double cov[KC_COEF_MAX * KC_COEF_MAX];   /* row-major, ld KC_COEF_MAX; zero rows and
                                                columns where not estimated                  */
    uint8_t status[KC_COEF_MAX];             /* kc_coef_status_t                             */
    uint64_t entangled[KC_COEF_MAX];         /* coefficients that share a null direction     */
    uint8_t outlier[KC_MEAS_MAX];
    uint32_t n_outliers, rank, n_free, dof, iters;
    double chi2, cost, kkt, cond;
    double noise_scale;                      /* sqrt(chi2/dof), 1 if dof = 0                 */
    double fit_pos_m, fit_rot_rad;           /* RMS residual after the fit (inliers)         */
    double before_pos_m, before_rot_rad;     /* RMS residual at start                        */
    /* work */
    kc_qp_t qp;
    kc_eval_t eval;
    double Rw[KC_COEF_MAX * (KC_COEF_MAX + 1u)];
    double Rs[KC_COEF_MAX * (KC_COEF_MAX + 1u)];
} kc_est_t;

/* Append an observation. KC_ERR_FULL at KC_MEAS_MAX; KC_ERR_ARG if not finite, not unit norm
 * (1e-6), or the covariance is not positive definite; est unchanged then. */
kc_status_t kc_est_add(kc_est_t *est, const kc_obs_t *obs);

/* Solve from start. KC_OK: converged. KC_ERR_ITER: best so far. KC_ERR_RANK: nothing free can be
 * determined, coef = start. KC_ERR_ARG / KC_ERR_NUM: outputs not valid. The cost never rises from
 * one accepted step to the next. O(iters * n_obs * n_coef^2). */
kc_status_t kc_est_solve(kc_est_t *est);

/* Covariance (6x6, row-major) of the predicted tool pose at ctx with the solved estimate. */
void kc_est_pose_cov(const kc_est_t *est, const kc_ctx_t *ctx, kc_eval_t *work, double cov[36]);

/* chi^2 upper tail probability, dof >= 1 (regularised incomplete gamma). */
double kc_chi2_sf(double chi2, uint32_t dof);

#endif
