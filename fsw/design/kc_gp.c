#include "kc_gp.h"

#include "kc_la.h"
#include "kc_libm.h"

_Static_assert(KC_CAND_MAX % 4u == 0u, "four candidates at a time");
_Static_assert(sizeof(kc_gp_t) <= 300u * 1024u, "GP memory budget");

static uint32_t row(uint32_t n) { return n * (n + 1u) / 2u; }

static double prior_var(const kc_gp_t *gp, const kc_point_t *x)
{
    return kc_kernel_eval(gp->kernel, gp->hyper, x, x);
}

kc_status_t kc_gp_init(kc_gp_t *gp, const kc_kernel_t *kernel, uint32_t hyper, const kc_point_t *cand,
                       uint32_t n_cand)
{
    if (n_cand > KC_CAND_MAX || hyper >= kernel->n_hyper) { return KC_ERR_ARG; }
    gp->kernel = kernel;
    gp->hyper = hyper;
    gp->n = 0u;
    gp->n_cand = n_cand;
    for (uint32_t c = 0; c < n_cand; c++) { gp->var[c] = prior_var(gp, &cand[c]); }
    return KC_OK;
}

/* Row i of the factor for the points 0..i already in gp->x (GPML Alg. 2.1 line 2, one row). */
static kc_status_t factor_row(kc_gp_t *gp, uint32_t i)
{
    double k[KC_MEAS_MAX];
    const double eps = gp->kernel->sigma_eps;
    kc_kernel_row(gp->kernel, gp->hyper, &gp->x[i], gp->x, i, k);
    return kc_la_packed_append(gp->L, i, k, prior_var(gp, &gp->x[i]) + eps * eps);
}

/* Row i of L^-1 K(X, candidates) and its part of every candidate's variance. Four candidates at a time; behind the last
 * one, what is no candidate is taken along and not kept. */
static void cache_row(kc_gp_t *gp, uint32_t i, const kc_point_t *cand)
{
    const double *l = &gp->L[row(i)];
    for (uint32_t c = 0; c < gp->n_cand; c += 4u) {
        const uint32_t n = gp->n_cand - c < 4u ? gp->n_cand - c : 4u;
        double s[4] = {0};
        kc_kernel_row(gp->kernel, gp->hyper, &gp->x[i], &cand[c], n, s);
        kc_la_take_four(l, i, &gp->v[0][c], KC_CAND_MAX, s);
        for (uint32_t k = 0u; k < n; k++) {
            const double v = s[k] / l[i];
            gp->v[i][c + k] = (float)v;
            gp->var[c + k] = kc_max(gp->var[c + k] - v * v, 0.0);
        }
    }
}

void kc_gp_set_y(kc_gp_t *gp, const double *y)
{
    for (uint32_t i = 0; i < gp->n; i++) { gp->y[i] = gp->z[i] = y[i]; }
    kc_la_packed_solve(gp->L, gp->n, gp->z);
}

kc_status_t kc_gp_add(kc_gp_t *gp, const kc_point_t *x, double y, const kc_point_t *cand)
{
    const uint32_t n = gp->n;
    if (n >= KC_MEAS_MAX) { return KC_ERR_FULL; }
    gp->x[n] = *x; /* beyond gp->n: not part of the state until the factor is extended */
    if (!kc_finite(y) || factor_row(gp, n) != KC_OK) { return KC_ERR_NUM; }
    gp->y[n] = y;
    gp->n = n + 1u;
    kc_gp_set_y(gp, gp->y);
    cache_row(gp, n, cand);
    return KC_OK;
}

double kc_gp_cand_mean(const kc_gp_t *gp, uint32_t c)
{
    double s = 0.0;
    for (uint32_t j = 0; j < gp->n; j++) { s += (double)gp->v[j][c] * gp->z[j]; }
    return s;
}

void kc_gp_predict(const kc_gp_t *gp, const kc_point_t *x, double *mean, double *var)
{
    double v[KC_MEAS_MAX];
    kc_kernel_row(gp->kernel, gp->hyper, x, gp->x, gp->n, v);
    kc_la_packed_solve(gp->L, gp->n, v);
    double m = 0.0;
    double s = prior_var(gp, x);
    for (uint32_t i = 0; i < gp->n; i++) {
        m += v[i] * gp->z[i];
        s -= v[i] * v[i];
    }
    *mean = m;
    *var = kc_max(s, 0.0);
}

double kc_gp_log_marginal(const kc_gp_t *gp)
{
    double s = 0.0;
    for (uint32_t i = 0; i < gp->n; i++) {
        s -= 0.5 * gp->z[i] * gp->z[i] + kc_log(gp->L[row(i) + i]) + 0.5 * kc_log(2.0 * KC_PI);
    }
    return s;
}

/* Factor and z on set `hyper`; the candidate cache is left as it was. Appending row by row gives the
 * same bits as kc_gp_add did. */
static kc_status_t refactor(kc_gp_t *gp, uint32_t hyper)
{
    kc_status_t st = KC_OK;
    gp->hyper = hyper;
    for (uint32_t i = 0; i < gp->n && st == KC_OK; i++) { st = factor_row(gp, i); }
    if (st == KC_OK) { kc_gp_set_y(gp, gp->y); }
    return st;
}

void kc_gp_choose_begin(kc_gp_t *gp)
{
    gp->choice = (kc_gp_choice_t){.old = gp->hyper, .best = gp->hyper, .best_ml = kc_gp_log_marginal(gp)};
}

/* Trial factors overwrite L, so no second one is kept; the best is factored once more at the end. A set
 * whose factor breaks down is passed over. */
static void try_set(kc_gp_t *gp, uint32_t h)
{
    kc_gp_choice_t *c = &gp->choice;
    if (h == c->old || refactor(gp, h) != KC_OK) { return; }
    const double ml = kc_gp_log_marginal(gp);
    if (ml > c->best_ml) {
        c->best_ml = ml;
        c->best = h;
    }
}

static void take_best(kc_gp_t *gp, const kc_point_t *cand)
{
    (void)refactor(gp, gp->choice.best);
    if (gp->choice.best == gp->choice.old) { return; }
    for (uint32_t c = 0; c < gp->n_cand; c++) { gp->var[c] = prior_var(gp, &cand[c]); }
}

/* Of a factor of all points, of a row of the candidate cache, of its prior variances. */
static uint64_t factor_cost(const kc_gp_t *gp)
{
    const uint64_t n = gp->n + 1u;
    return 10000u + n * n * kc_kernel_cost(gp->kernel) / 2u + 5u * n * n * n;
}

static uint64_t row_cost(const kc_gp_t *gp)
{
    return 10000u + gp->n_cand * (kc_kernel_cost(gp->kernel) + 10u * (uint64_t)gp->n);
}

uint64_t kc_gp_cost(const kc_gp_t *gp)
{
    const uint64_t n = gp->n + 1u;
    return row_cost(gp) + n * (kc_kernel_cost(gp->kernel) + 20u * n);
}

bool kc_gp_choose_step(kc_gp_t *gp, const kc_point_t *cand, kc_work_t *work)
{
    kc_gp_choice_t *c = &gp->choice;
    for (; c->h < gp->kernel->n_hyper; c->h++) {
        if (!kc_work_take(work, factor_cost(gp))) { return false; }
        try_set(gp, c->h);
    }
    if (c->h == gp->kernel->n_hyper) {
        if (!kc_work_take(work, factor_cost(gp) + row_cost(gp))) { return false; }
        take_best(gp, cand);
        c->h++;
    }
    for (; c->best != c->old && c->i < gp->n; c->i++) {
        if (!kc_work_take(work, row_cost(gp))) { return false; }
        cache_row(gp, c->i, cand);
    }
    return true;
}

uint32_t kc_gp_choose(kc_gp_t *gp, const kc_point_t *cand)
{
    kc_work_t work = kc_work_unlimited();
    kc_gp_choose_begin(gp);
    (void)kc_gp_choose_step(gp, cand, &work);
    return gp->hyper;
}
