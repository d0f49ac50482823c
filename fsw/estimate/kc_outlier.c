#include <stddef.h>

#include "kc_chi2.h"
#include "kc_est_priv.h"
#include "kc_la.h"
#include "kc_libm.h"

/* A pose whose deletion leaves less than this part of a direction's variance is never an outlier: without
 * it, its prediction would be ten times less certain than its measurement, and the fit follows it anyway. */
#define LEVERAGE_LEFT 1e-2

/* Squared deleted residual d2 = w' (I - T'T)^-1 w of observation i, w whitened residual and T = R^-T J',
 * (I - T'T being the covariance of w after the fit), both less what errors of the camera chain explain. Returns rows, 0
 * for a pose without a test. */
static uint32_t deleted_residual(kc_est_t *est, uint32_t i, double *d2)
{
    const uint32_t n = est->n_idx;
    double S[36] = {0};
    double w[6];
    const uint32_t m = kc_est_block(est, i, w);
    for (uint32_t k = 0; k < 6u; k++) { w[k] = est->blk[6u * n + k]; }
    kc_la_solve_upper_t(est->R, n, KC_EST_LD, est->blk);
    for (uint32_t k = 0; k < m; k++) {
        for (uint32_t l = 0; l <= k; l++) {
            double s = (k == l) ? 1.0 : 0.0;
            for (uint32_t c = 0; c < n; c++) { s -= est->blk[6u * c + k] * est->blk[6u * c + l]; }
            S[k * 6u + l] = s;
        }
    }
    if (est->camera != NULL) { kc_est_chain_correct(est, i, est->blk, w, S); }
    if (kc_la_chol(S, m, 6u) != KC_OK) { return 0u; }
    for (uint32_t k = 0; k < m; k++) {
        if (S[k * 7u] * S[k * 7u] < LEVERAGE_LEFT) { return 0u; }
    }
    kc_la_solve_lower(S, m, 6u, w);
    *d2 = 0.0;
    for (uint32_t k = 0; k < m; k++) { *d2 += w[k] * w[k]; }
    return m;
}

/* Probability of d2 when the noise is that of the other poses, but not less than stated: a stated noise
 * that is too small, or an effect the model lacks, must not reject good poses. */
static double probability(double d2, uint32_t m, double chi2, uint32_t dof)
{
    const double others = (chi2 - d2) / (double)(dof - m);
    return kc_chi2_sf(d2 / kc_max(1.0, others), m);
}

void kc_est_outlier_test(kc_est_t *est, uint32_t i)
{
    kc_est_job_t *job = &est->job;
    const uint32_t rows = job->sums.rows;
    double d2;
    const uint32_t m = deleted_residual(est, i, &d2);
    if (m == 0u || rows <= est->n_idx + m) { return; }
    job->n_tested++;
    const double explained = est->camera != NULL ? kc_est_chain_explains(est) : 0.0;
    const double p = probability(d2, m, job->sums.chi2 - explained, rows - est->n_idx);
    if (job->worst == est->n_obs || p < job->p_worst) {
        job->worst = i;
        job->p_worst = p;
    }
}
