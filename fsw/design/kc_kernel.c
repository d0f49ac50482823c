#include "kc_kernel.h"

#include <stddef.h>

#include "kc_la.h"
#include "kc_vec.h"

/* Sum of kept weights against k(0) = 1; only rounding in the table may part them. */
#define SUM_TOL 1e-9
#define TRUNC_MAX 0.1

/* cos t of METHOD.md 3: |<q1,q2>| is the cosine of half the rotation angle, so eq. 1's angle has
 * cos d = 2 <q1,q2>^2 - 1. Both are taken without an acos. */
static double cos_t(uint8_t arg, const double q1[4], const double q2[4])
{
    const double product = kc_v3_dot(q1, q2) + q1[3] * q2[3], dot = kc_min(kc_fabs(product), 1.0);
    return (arg == KC_KERNEL_PAPER) ? 2.0 * dot * dot - 1.0 : dot;
}

/* sum w_n U_n(x) by Clenshaw: b_n = w_n + 2x b_{n+1} - b_{n+2}, the sum is b_0; two steps at a time, so that no b is
 * moved. No division by sin t, so t = 0 and t = pi need no special case. */
double kc_kernel_rot(const kc_kernel_t *k, uint32_t hyper, const double q1[4], const double q2[4])
{
    const kc_hyper_t *h = &k->hyper[hyper];
    const double x2 = 2.0 * cos_t(k->arg, q1, q2);
    double b1 = 0.0;
    double b2 = 0.0;
    for (size_t n = h->n_w; n > 1u; n -= 2u) {
        b2 = h->w[n - 1u] + x2 * b1 - b2;
        b1 = h->w[n - 2u] + x2 * b2 - b1;
    }
    return (h->n_w & 1u) != 0u ? h->w[0] + x2 * b1 - b2 : b1;
}

/* k from its rotation part. */
static double with_position(const kc_hyper_t *h, double rot, const kc_point_t *x1, const kc_point_t *x2)
{
    double d[3];
    kc_v3_sub(x1->p_m, x2->p_m, d);
    return h->sigma_s * h->sigma_s * rot * kc_exp(-0.5 * kc_v3_dot(d, d) / (h->beta_m * h->beta_m));
}

double kc_kernel_eval(const kc_kernel_t *k, uint32_t hyper, const kc_point_t *x1, const kc_point_t *x2)
{
    return with_position(&k->hyper[hyper], kc_kernel_rot(k, hyper, x1->q_wxyz, x2->q_wxyz), x1, x2);
}

void kc_kernel_row(const kc_kernel_t *k, uint32_t hyper, const kc_point_t *x, const kc_point_t *at,
                   uint32_t n, double *out)
{
    const kc_hyper_t *h = &k->hyper[hyper];
    for (uint32_t i = 0u; i < n; i += 4u) {
        const uint32_t last = n - i < 4u ? n - i - 1u : 3u; /* stands in the places after it too */
        double x2[4], rot[4];
        for (uint32_t p = 0u; p < 4u; p++) {
            x2[p] = 2.0 * cos_t(k->arg, x->q_wxyz, at[i + (p < last ? p : last)].q_wxyz);
        }
        kc_la_chebyshev(h->w, h->n_w, x2, rot);
        for (uint32_t p = 0u; p <= last; p++) { out[i + p] = with_position(h, rot[p], x, &at[i + p]); }
    }
}

uint64_t kc_kernel_cost(const kc_kernel_t *k)
{
    uint64_t n_w = 0u;
    for (uint32_t i = 0u; i < k->n_hyper; i++) { n_w = k->hyper[i].n_w > n_w ? k->hyper[i].n_w : n_w; }
    return 350u + 7u * n_w;
}

static bool in_range(double x, double lo, double hi, double *got)
{
    *got = x;
    return x >= lo && x <= hi; /* NaN fails */
}

/* Weights: none negative (that is what makes the kernel positive definite), odd ones zero on SO(3),
 * and their sum at t = 0 is 1. */
static kc_status_t weights_validate(uint8_t arg, const kc_hyper_t *h, double *got)
{
    double sum = 0.0;
    for (uint32_t n = 0; n < h->n_w; n++) {
        const double top = (arg == KC_KERNEL_SO3 && (n & 1u) != 0u) ? 0.0 : 1.0;
        if (!in_range(h->w[n], 0.0, top, got)) { return KC_ERR_RANGE; }
        sum += h->w[n] * (double)(n + 1u);
    }
    return in_range(sum, 1.0 - SUM_TOL, 1.0 + SUM_TOL, got) ? KC_OK : KC_ERR_RANGE;
}

static kc_status_t hyper_validate(uint8_t arg, const kc_hyper_t *h, double *got)
{
    if (!in_range(h->sigma_s, 1e-6, 1e3, got) || !in_range(h->beta_m, 1e-3, 1e3, got) ||
        !in_range(h->kappa, 1e-3, 1e3, got) || !in_range(h->nu, 0.0, 100.0, got) ||
        !in_range(h->trunc_err, 0.0, TRUNC_MAX, got) ||
        !in_range((double)h->n_w, 1.0, (double)KC_SPECTRUM_MAX, got)) {
        return KC_ERR_RANGE;
    }
    return weights_validate(arg, h, got);
}

kc_status_t kc_kernel_validate(const kc_kernel_t *k, int32_t *index, double *got)
{
    *index = -1;
    if (!in_range((double)k->arg, 0.0, (double)KC_KERNEL_PAPER, got) ||
        !in_range((double)k->n_hyper, 1.0, (double)KC_HYPER_MAX, got) ||
        !in_range(k->sigma_eps, 1e-9, 1e3, got) || !in_range((double)k->choose, 0.0, 1.0, got)) {
        return KC_ERR_RANGE;
    }
    for (uint32_t i = 0; i < k->n_hyper; i++) {
        *index = (int32_t)i;
        if (hyper_validate(k->arg, &k->hyper[i], got) != KC_OK) { return KC_ERR_RANGE; }
    }
    return KC_OK;
}
