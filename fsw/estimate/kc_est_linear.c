#include <stddef.h>

#include "kc_est_priv.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_vec.h"

uint32_t kc_est_list(const kc_est_t *est, uint64_t mask, uint32_t *list)
{
    uint32_t n = 0u;
    for (uint32_t c = 0; c < est->terms->n_coef; c++) {
        if (((mask >> c) & 1u) != 0u) { list[n++] = c; }
    }
    return n;
}

uint32_t kc_est_block(kc_est_t *est, uint32_t i, double raw[6])
{
    const kc_obs_t *o = &est->obs[i];
    const uint32_t n = est->n_column;
    kc_loads_t work;
    double W[36];
    const kc_loads_t *loads = kc_fixed_needed_loads(&est->fixed, &o->ctx, &work);
    const uint32_t m = kc_fixed_residual(&est->fixed, o, loads, raw, &est->eval);
    (void)kc_la_whiten(o->cov, m, W); /* kc_est_add has checked it */
    for (uint32_t j = 0; j < n; j++) {
        kc_la_whiten_apply(W, est->eval.J[est->column[j]], &est->blk[6u * j]);
    }
    kc_la_whiten_apply(W, raw, &est->blk[6u * n]);
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

void kc_est_pass_begin(kc_est_t *est, kc_est_pass_t pass, const double *coef)
{
    kc_est_job_t *job = &est->job;
    job->pass = (uint8_t)pass;
    job->i = 0u;
    job->at = coef;
    if (pass != KC_EST_PASS_NONE && pass != KC_EST_PASS_QP) {
        kc_model_fix(est->arm, est->terms, coef, &est->fixed);
    }
    if (pass != KC_EST_PASS_FOLD) { return; }
    job->sums = (kc_est_sums_t){0};
    job->has_prior = false;
    est->n_column = kc_est_list(est, job->requested, est->column);
    for (uint32_t i = 0; i < est->n_column; i++) {
        for (uint32_t j = i; j <= est->n_column; j++) { est->R[i * KC_EST_LD + j] = 0.0; }
    }
}

void kc_est_fold(kc_est_t *est, uint32_t i)
{
    kc_est_sums_t *s = &est->job.sums;
    double r[6];
    const uint32_t m = kc_est_block(est, i, r);
    const double *w = &est->blk[6u * est->n_column];
    s->chi2 += kc_v_dot(w, w, 6u);
    s->rows += m;
    s->n_pos++;
    s->pos2 += kc_v3_dot(r, r);
    if (m == 6u) {
        s->n_rot++;
        s->rot2 += kc_v3_dot(&r[3], &r[3]);
    }
    (void)kc_la_fold(est->R, est->n_column, KC_EST_LD, est->blk);
}

double kc_est_prior_cost(const kc_est_t *est, const double *coef)
{
    double sum = 0.0;
    for (uint32_t j = 0; j < est->n_idx; j++) {
        double centre;
        const double w = kc_est_prior_precision(est, est->idx[j], &centre) * (coef[est->idx[j]] - centre);
        sum += w * w;
    }
    return sum;
}

void kc_est_narrow(kc_est_t *est)
{
    uint32_t keep[KC_COEF_MAX], k = 0u;
    if (est->n_idx == est->n_column) { return; }
    for (uint32_t j = 0; j < est->n_column && k < est->n_idx; j++) {
        if (est->column[j] == est->idx[k]) { keep[k++] = j; }
    }
    kc_la_take_columns(est->R, est->n_column, KC_EST_LD, keep, est->n_idx);
    for (uint32_t j = 0; j < est->n_idx; j++) { est->column[j] = est->idx[j]; }
    est->n_column = est->n_idx;
}

/* Six coefficients at a time, one row each: [1/sigma at its place | (centre - coef)/sigma]. */
void kc_est_fold_prior(kc_est_t *est)
{
    const uint32_t n = est->n_idx;
    kc_est_narrow(est);
    for (uint32_t from = 0; from < n && !est->job.has_prior; from += 6u) {
        for (uint32_t k = 0; k < 6u * (n + 1u); k++) { est->blk[k] = 0.0; }
        for (uint32_t k = 0; k < 6u && from + k < n; k++) {
            const uint32_t j = from + k;
            double centre;
            const double w = kc_est_prior_precision(est, est->idx[j], &centre);
            est->blk[6u * j + k] = w;
            est->blk[6u * n + k] = w * (centre - est->coef[est->idx[j]]);
        }
        (void)kc_la_fold(est->R, n, KC_EST_LD, est->blk);
    }
    est->job.has_prior = true;
}
