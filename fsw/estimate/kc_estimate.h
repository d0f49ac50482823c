/* Estimator of the correction coefficients: eq. 8-11 with masks, bounds, priors, covariance weights,
 * outlier rejection, damped steps, and a report of what the data cannot determine.
 *
 * Linear algebra is square-root information: each pose's whitened 6 x n block is folded
 * into an upper-triangular R by Householder reflections, so neither J nor J'J of all poses
 * is ever stored and the condition number is not squared before rank is decided.
 *
 * Which coefficients are estimated. Requested are those in free_mask that the table enables. Their
 * whitened columns, times coef.scale, go through QR with column pivoting, without any prior. A pivot is
 * scale over the sigma that the data alone would leave that coefficient if the better determined ones were
 * known. Those below rank_tol of the largest pivot, or below KC_EST_PIVOT_MIN (sigma larger than the
 * typical size), are HELD at start and the rest is estimated. This is decided at start and checked at the
 * solution: if the rank differs there, it is decided again and the fit repeated (at most KC_EST_PASSES
 * fits).
 *
 * Weak prior. While the rows are fewer than twice the coefficients estimated (the first poses of a
 * calibration), a coefficient without a prior of its own gets one about start with sigma =
 * KC_EST_WEAK_SIGMA x scale (hold_none: always). Noise is then not amplified in poorly determined directions;
 * later the prior is dropped and the estimate is that of the data alone. It enters cost and covariance, never
 * rank. */
#ifndef KC_ESTIMATE_H
#define KC_ESTIMATE_H

#include <stdbool.h>
#include <stdint.h>

#include "kc_camera.h"
#include "kc_limits.h"
#include "kc_model.h"
#include "kc_qp.h"
#include "kc_work.h"

#define KC_EST_PASSES 4u
#define KC_EST_WEAK_SIGMA 3.0
#define KC_EST_PIVOT_MIN 1.0

typedef enum {
    KC_COEF_ESTIMATED = 0,
    KC_COEF_MASKED = 1,   /* not requested */
    KC_COEF_HELD = 2,     /* dependent on others: held at its start value */
    KC_COEF_AT_LOWER = 3, /* estimated, the bound is active */
    KC_COEF_AT_UPPER = 4
} kc_coef_status_t;

typedef struct {
    uint64_t free_mask;   /* bit per coefficient to estimate; others keep start[] */
    uint32_t iter_max;    /* Gauss-Newton iterations of one fit, 1..100 */
    double tol_step;      /* converged when every step < tol_step * scale */
    double rank_tol;      /* a scaled pivot below rank_tol * largest is dependent */
    double outlier_p;     /* family-wise chance of rejecting a good pose, 0 = off */
    uint32_t outlier_max; /* at most this many are rejected */
    uint8_t use_prior;    /* add (coef / prior_sigma)^2 where prior_sigma > 0 */
} kc_est_opt_t;

/* Sums over the inliers at one vector of coefficients. */
typedef struct {
    double chi2;           /* whitened squared residuals */
    double pos2, rot2;     /* squared residuals [m^2], [rad^2] */
    uint32_t n_pos, n_rot; /* poses behind them */
    uint32_t rows;
} kc_est_sums_t;

/* Where a solution stands between two steps (kc_est_solve.c). */
typedef struct {
    uint8_t phase, pass;  /* kc_est_phase_t, kc_est_pass_t */
    bool fresh;           /* sums and R are those at coef, of the inliers of now */
    bool has_prior;       /* R has the priors */
    uint32_t i;           /* next observation of the pass */
    const double *at;     /* coefficients of the pass */
    uint64_t requested, kept;
    kc_status_t status;
    kc_est_sums_t sums;
    uint32_t n_fits, iter, tries, n_tested, worst, rank_all;
    double lambda, cost, largest, p_worst;
} kc_est_job_t;

/* What the poses say of the errors of the camera chain (kc_camera_chain), beside the coefficients of the fit: of
 * that, residuals are no outliers (kc_est_chain.c). */
typedef struct {
    double U[KC_CHAIN_COUNT / 6u][6u * KC_COEF_MAX]; /* J'H, then R^-T J'H; six errors side by side */
    double L[KC_CHAIN_COUNT * KC_CHAIN_COUNT]; /* H'H, then the Cholesky factor of I + H'H - U'U */
    double b[KC_CHAIN_COUNT]; /* H'r, then L^-1 of it */
    bool known; /* there is such a factor */
} kc_est_chain_t;

/* Caller owns it (static); about 160 KiB with work space. */
typedef struct {
    /* in */
    const kc_arm_t *arm;
    const kc_terms_t *terms;
    /* its stated errors explain residuals; q_wxyz is used then whatever has_rot says. NULL: it is exact */
    const kc_camera_t *camera;
    kc_est_opt_t opt;
    uint32_t n_obs;
    /* hold_none: every requested coefficient is estimated; the weak prior decides what the data do not
     * (the most likely arm within its bounds, for a few observations) */
    uint8_t hold_none;
    uint8_t by_bounds; /* the weak prior of hold_none is that of kc_est_bound_sigma, about start */
    /* a prior of every coefficient, about prior_mean, from earlier measurements: it counts as an observation of each,
     * also in chi2 and dof, and takes the place of any other; nothing is held then either (set hold_none too) */
    uint8_t by_prior;
    const double *prior_mean;
    double prior_sigma[KC_COEF_MAX];
    uint32_t without; /* observation that is rejected beforehand, from 1; 0: none */
    kc_obs_t obs[KC_MEAS_MAX];
    double start[KC_COEF_MAX]; /* estimated ones are clipped to their bounds */
    /* out */
    double coef[KC_COEF_MAX];
    double sigma[KC_COEF_MAX]; /* 1-sigma at noise scale 1; 0 if not estimated
                                                or at a bound */
    uint8_t status[KC_COEF_MAX]; /* kc_coef_status_t */
    uint64_t confounded[KC_COEF_MAX]; /* other coefficients that share a null direction
                                                with this one, held or not; 0 for a held one
                                                means that it has no effect at all */
    uint8_t outlier[KC_MEAS_MAX];
    uint32_t n_outliers, rank, n_free, dof, iters;
    double chi2; /* of the data, inliers (by_prior: and the prior) */
    double cost; /* of data and priors */
    double kkt; /* largest |projected gradient|, each over the norm
                                                of its whitened column and max(1, |residual|) */
    double cond; /* largest over least scaled pivot kept */
    double noise_scale; /* sqrt(chi2/dof), 1 if dof = 0 */
    double fit_pos_m, fit_rot_rad; /* RMS residual after the fit (inliers) */
    double before_pos_m, before_rot_rad; /* RMS residual at start (all) */
    union {
        double cov[KC_COEF_MAX * KC_COEF_MAX]; /* out: row-major, ld KC_COEF_MAX; zero rows and
                                                  columns where not estimated or at a bound */
        kc_qp_t qp; /* work: only while solving */
        kc_est_chain_t chain; /* work: only while outliers are looked for */
    };
    /* work */
    kc_est_job_t job;
    kc_fixed_t fixed; /* at job.at, in a pass over observations */
    kc_eval_t eval;
    uint8_t weak; /* the weak prior is in force */
    uint32_t n_idx, n_column; /* coefficients of the fit, and columns of R: place -> coefficient */
    uint32_t idx[KC_COEF_MAX], column[KC_COEF_MAX];
    uint32_t perm[KC_COEF_MAX];
    double R[KC_COEF_MAX * (KC_COEF_MAX + 1u)]; /* square-root information | right-hand side */
    double blk[6u * (KC_COEF_MAX + 1u)]; /* rows of one observation, column after column */
    double pivot[KC_COEF_MAX]; /* of the rank; in a fit, where none is decided: the undamped diagonal of H */
    double trial[KC_COEF_MAX];
} kc_est_t;

/* Append an observation. KC_ERR_FULL at KC_MEAS_MAX; KC_ERR_ARG if not finite, not unit norm
 * (1e-6), or the covariance is not positive definite; est unchanged then. */
kc_status_t kc_est_add(kc_est_t *est, const kc_obs_t *obs);

/* Sigma of a coefficient that lies anywhere between its bounds, with equal chance. */
double kc_est_bound_sigma(const kc_coef_t *coef);

/* Solve from start. KC_OK: converged. KC_ERR_ITER: best so far. KC_ERR_RANK: nothing free can be
 * determined, coef = start and status says why. KC_ERR_ARG (options out of range, bounds crossed,
 * nothing observed) / KC_ERR_NUM (not finite): outputs not valid. The cost never rises from one accepted
 * step to the next; loads are those of the coefficients at each step. Outliers: the pose with the
 * least likely deleted residual, scaled by the noise of the others where that exceeds 1, goes first,
 * then the fit is repeated. O(passes * iters * n_obs * n_coef^2). */
kc_status_t kc_est_solve(kc_est_t *est);

/* The same in parts: begin, then step, once a step of the process, until it answers true. Then est->job.status
 * is what kc_est_solve returns; outputs are valid only then. Nothing of the inputs may change between. */
void kc_est_begin(kc_est_t *est);
bool kc_est_step(kc_est_t *est, kc_work_t *work);

/* From the first observation, when the camera's drift is taken to begin, to observation i. */
double kc_est_since_s(const kc_est_t *est, uint32_t i);
/* kc_camera_chain of a camera at observation i. */
void kc_est_chain_motion(const kc_est_t *est, const kc_camera_t *camera, uint32_t i,
                         double H[KC_CHAIN_COUNT][6]);

/* Covariance (6x6, row-major) of the predicted tool pose at ctx with the solved estimate; fixed: of est->coef. */
uint64_t kc_est_pose_cov_cost(const kc_est_t *est); /* bound of its instructions */
void kc_est_pose_cov(const kc_est_t *est, const kc_fixed_t *fixed, const kc_ctx_t *ctx, kc_eval_t *work,
                     double cov[36]);

#endif
