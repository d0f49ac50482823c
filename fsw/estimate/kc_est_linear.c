#include <stddef.h>

#include "kc_est_priv.h"
#include "kc_la.h"
#include "kc_libm.h"

uint32_t kc_est_block(kc_est_t *est, const double *coef, uint32_t i, double raw[6])
{
    const kc_obs_t *o = &est->obs[i];
    const uint32_t n = est->n_idx;
    kc_loads_t loads;
    double W[36];
    double r[6];
    double col[6];
    kc_model_loads(est->arm, est->terms, coef, &o->ctx, &loads);
    const uint32_t m = kc_model_residual(est->arm, est->terms, coef, o, &loads, r, &est->eval);
    (void)kc_la_whiten(o->cov, m, W); /* kc_est_add has checked it */
    for (uint32_t j = 0; j < n; j++) {
        kc_la_whiten_apply(W, m, est->eval.J[est->idx[j]], col);
        for (uint32_t k = 0; k < m; k++) { est->blk[k * KC_EST_LD + j] = col[k]; }
    }
    kc_la_whiten_apply(W, m, r, col);
    for (uint32_t k = 0; k < m; k++) { est->blk[k * KC_EST_LD + n] = col[k]; }
    for (uint32_t k = 0; raw != NULL && k < 6u; k++) { raw[k] = r[k]; }
    return m;
}

uint32_t kc_est_rows(const kc_est_t *est)
{
    uint32_t rows = 0u;
    for (uint32_t i = 0; i < est->n_obs; i++) {
        if (est->outlier[i] == 0u) { rows += (est->obs[i].has_rot != 0u) ? 6u : 3u; }
    }
    return rows;
}

double kc_est_prior_precision(const kc_est_t *est, uint32_t c, double *centre)
{
    const kc_coef_t *k = &est->terms->coef[c];
    if (est->by_prior != 0u) {
        *centre = est->prior_mean[c];
        return 1.0 / est->prior_sigma[c];
    }
    *centre = 0.0;
    if (est->opt.use_prior != 0u && k->prior_sigma > 0.0) { return 1.0 / k->prior_sigma; }
    *centre = est->start[c];
    if (est->weak == 0u) { return 0.0; }
    const bool by_bounds = est->by_bounds != 0u && est->hold_none != 0u;
    return 1.0 / (by_bounds ? kc_est_bound_sigma(k) : KC_EST_WEAK_SIGMA * k->scale);
}

static double sum_squares(const double *v, uint32_t n)
{
    double s = 0.0;
    for (uint32_t i = 0; i < n; i++) { s += v[i] * v[i]; }
    return s;
}

void kc_est_pass_begin(kc_est_t *est, kc_est_pass_t pass, const double *coef)
{
    kc_est_job_t *job = &est->job;
    job->pass = (uint8_t)pass;
    job->i = 0u;
    job->at = coef;
    if (pass == KC_EST_PASS_SUMS) { job->sums = (kc_est_sums_t){0}; }
    if (pass != KC_EST_PASS_FOLD) { return; }
    for (uint32_t k = 0; k < est->n_idx * KC_EST_LD; k++) { est->R[k] = 0.0; }
}

void kc_est_sums_add(kc_est_t *est, uint32_t i)
{
    kc_est_sums_t *s = &est->job.sums;
    double r[6];
    const uint32_t m = kc_est_block(est, est->job.at, i, r);
    for (uint32_t k = 0; k < m; k++) {
        const double w = est->blk[k * KC_EST_LD + est->n_idx];
        s->chi2 += w * w;
    }
    s->rows += m;
    s->n_pos++;
    s->pos2 += sum_squares(r, 3u);
    if (m == 6u) {
        s->n_rot++;
        s->rot2 += sum_squares(&r[3], 3u);
    }
}

void kc_est_sums_end(kc_est_t *est)
{
    for (uint32_t j = 0; j < est->n_idx; j++) {
        const uint32_t c = est->idx[j];
        double centre;
        const double w = kc_est_prior_precision(est, c, &centre) * (est->job.at[c] - centre);
        est->job.sums.prior += w * w;
    }
}

void kc_est_fold(kc_est_t *est, uint32_t i)
{
    const uint32_t m = kc_est_block(est, est->job.at, i, NULL);
    (void)kc_la_fold(est->R, est->n_idx, KC_EST_LD, est->blk, m, KC_EST_LD);
}

/* One row a coefficient: [1/sigma at its place | (centre - coef)/sigma]. */
void kc_est_fold_prior(kc_est_t *est)
{
    const uint32_t n = est->n_idx;
    for (uint32_t j = 0; j < n; j++) {
        double centre;
        const double w = kc_est_prior_precision(est, est->idx[j], &centre);
        if (w <= 0.0) { continue; }
        for (uint32_t k = 0; k < n; k++) { est->blk[k] = 0.0; }
        est->blk[j] = w;
        est->blk[n] = w * (centre - est->coef[est->idx[j]]);
        (void)kc_la_fold(est->R, n, KC_EST_LD, est->blk, 1u, KC_EST_LD);
    }
}
