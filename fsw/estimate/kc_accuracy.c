#include "kc_accuracy.h"

#include <string.h>

#include "kc_chi2.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_vec.h"

static uint32_t at(uint32_t i, uint32_t j) { return i >= j ? i * (i + 1u) / 2u + j : j * (j + 1u) / 2u + i; }

void kc_accuracy_begin(kc_accuracy_t *a, const kc_est_t *est)
{
    memset(a, 0, sizeof *a);
    a->n_coef = est->terms->n_coef;
}

uint64_t kc_accuracy_add_cost(const kc_est_t *est)
{
    const uint64_t n = est->terms->n_coef + KC_CHAIN_COUNT;
    return 10000u + 30u * n * n;
}

void kc_accuracy_add(kc_accuracy_t *a, const kc_eval_t *eval, double (*chain)[KC_CHAIN_COUNT])
{
    const uint32_t n = a->n_coef + KC_CHAIN_COUNT;
    double move[KC_ACCURACY_MAX][6];
    memcpy(move, eval->J, a->n_coef * sizeof move[0]);
    for (uint32_t i = 0u; i < KC_CHAIN_COUNT; i++) {
        for (uint32_t c = 0u; c < 6u; c++) { move[a->n_coef + i][c] = chain[c][i]; }
    }
    kc_la_add_grams(&move[0][0], n, a->pos, a->rot);
    a->n_poses++;
}

double kc_accuracy_square(const kc_accuracy_t *a, const float *sums, uint32_t c)
{
    return (double)sums[at(c, c)] / (double)a->n_poses;
}

/* ---- moments of x' S x, x normal: coefficients of covariance C, the chain's of unit covariance and mean b ---- */

/* Column j of S, those rows that belong to coefficients. */
static void column(const kc_accuracy_t *a, const float *sums, uint32_t j, double *out)
{
    for (uint32_t i = 0u; i < a->n_coef; i++) { out[i] = (double)sums[at(i, j)]; }
}

/* y' C y of coefficients; C is that of est. */
static double quadratic(const kc_accuracy_t *a, const kc_est_t *est, const double *y)
{
    double v[KC_COEF_MAX];
    kc_la_mul(est->cov, a->n_coef, KC_COEF_MAX, y, 1u, 1u, v);
    return kc_v_dot(y, v, a->n_coef);
}

/* Element i of S times c. */
static double row_times(const kc_accuracy_t *a, const float *sums, uint32_t i, const double *c)
{
    uint32_t below = at(i, i);
    const float *row = &sums[below - i];
    double s = 0.0;
    for (uint32_t k = 0u; k <= i; k++) { s += (double)row[k] * c[k]; }
    for (uint32_t k = i + 1u; k < a->n_coef; k++) { /* down column i */
        below += k;
        s += (double)sums[below] * c[k];
    }
    return s;
}

/* Row j of C S C S, its element j, and that of C S. */
static double coefficient(const kc_accuracy_t *a, const float *sums, const kc_est_t *est, uint32_t j,
                          double *trace)
{
    double s[KC_COEF_MAX], w[KC_COEF_MAX], both = 0.0;
    const double *c = &est->cov[j * KC_COEF_MAX];
    column(a, sums, j, s);
    kc_la_mul(est->cov, a->n_coef, KC_COEF_MAX, s, 1u, 1u, w); /* column j of C S */
    for (uint32_t i = 0u; i < a->n_coef; i++) {
        both += row_times(a, sums, i, c) * w[i];
        *trace += c[i] * s[i];
    }
    return both;
}

/* The chain's share of the mean, *mean, and of half the variance. */
static double unknown_chain(const kc_accuracy_t *a, const float *sums, const kc_est_t *est, double scale,
                            const double *known, double *mean)
{
    const uint32_t n = a->n_coef;
    double half = 0.0, moved[KC_COEF_MAX] = {0}, y[KC_COEF_MAX];
    for (uint32_t i = 0u; i < KC_CHAIN_COUNT; i++) {
        double by_known = 0.0;
        for (uint32_t j = 0u; j < KC_CHAIN_COUNT; j++) {
            const double s = (double)sums[at(n + i, n + j)];
            half += s * s;
            by_known += s * known[j];
        }
        *mean += (double)sums[at(n + i, n + i)] + by_known * known[i];
        half += 2.0 * by_known * by_known;
        column(a, sums, n + i, y);
        half += 2.0 * scale * scale * quadratic(a, est, y);
        for (uint32_t c = 0u; c < n; c++) { moved[c] += y[c] * known[i]; }
    }
    return half + 2.0 * scale * scale * quadratic(a, est, moved);
}

double kc_accuracy_dof(const kc_accuracy_t *a, const float *sums, const kc_est_t *est, double scale,
                       const double known[KC_CHAIN_COUNT])
{
    const double scale2 = scale * scale;
    const uint32_t most = KC_ACCURACY_MAX;
    double mean = 0.0, half = unknown_chain(a, sums, est, scale, known, &mean);
    for (uint32_t j = 0u; j < a->n_coef; j++) {
        double trace = 0.0;
        half += scale2 * scale2 * coefficient(a, sums, est, j, &trace);
        mean += scale2 * trace;
    }
    const double dof = half > 0.0 ? mean * mean / half : 1.0; /* 2 mean^2 / variance */
    return kc_max(1.0, kc_min(dof, (double)most));
}

uint64_t kc_accuracy_dof_cost(const kc_est_t *est)
{
    const uint64_t n = est->terms->n_coef;
    return 500000u + 200u * n * n + 20u * n * n * n;
}

double kc_accuracy_bound(double rms, double dof, double confidence)
{
    if (confidence <= 0.0) { return rms; }
    return rms * kc_sqrt(kc_chi2_quantile_real(1.0 - confidence, dof) / dof);
}
