#include "kc_acquire.h"

#include <stddef.h>

#include "kc_la.h"
#include "kc_libm.h"
#include "kc_rng.h"

#define LD KC_COEF_MAX
#define LEFT_MIN 1e-12 /* no measurement takes all of a variance; rounding might */

double kc_acq_beta(uint32_t n_cand, uint32_t k, double scale)
{
    const double kk = (double)k;
    return scale * 2.0 * kc_log((double)n_cand * kk * kk * KC_PI * KC_PI / (6.0 * 0.1));
}

static double largest(const double *v, uint32_t n, double floor)
{
    double m = floor;
    for (uint32_t i = 0; i < n; i++) { m = kc_max(v[i], m); }
    return m;
}

void kc_acq_objective(const double *dp_m, const double *dr_rad, uint32_t n, double a1, double sp_floor_m,
                      double sq_floor_rad, double *y)
{
    const double s_p = largest(dp_m, n, sp_floor_m);
    const double s_q = largest(dr_rad, n, sq_floor_rad);
    for (uint32_t i = 0; i < n; i++) { y[i] = -(a1 * dp_m[i] / s_p + (1.0 - a1) * dr_rad[i] / s_q); }
}

kc_status_t kc_acq_ucb(const kc_gp_t *gp, const uint8_t *usable, double beta, uint32_t *c, double *value)
{
    kc_status_t st = KC_ERR_ARG;
    const double weight = kc_sqrt(beta);
    for (uint32_t i = 0; i < gp->n_cand; i++) {
        if (usable[i] == 0u) { continue; }
        const double u = kc_gp_cand_mean(gp, i) + weight * kc_sqrt(gp->var[i]);
        if (st != KC_OK || u > *value) {
            *c = i;
            *value = u;
            st = KC_OK;
        }
    }
    return st;
}

kc_status_t kc_acq_random(const uint8_t *usable, uint32_t n_cand, uint64_t *rng, uint32_t *c)
{
    uint32_t n = 0u;
    for (uint32_t i = 0; i < n_cand; i++) { n += (usable[i] != 0u) ? 1u : 0u; }
    if (n == 0u) { return KC_ERR_ARG; }
    uint32_t pick = kc_rng_below(rng, n);
    for (uint32_t i = 0; i < n_cand; i++) {
        if (usable[i] != 0u && pick-- == 0u) { *c = i; }
    }
    return KC_OK;
}

/* Rows of work->J: whitened columns of the requested coefficients, times their scale. */
static void take_jacobian(const kc_est_t *est, const double W[36], kc_acq_work_t *w)
{
    for (uint32_t j = 0; j < w->n; j++) {
        const double scale = est->terms->coef[w->idx[j]].scale;
        kc_la_whiten_apply(W, w->eval.J[w->idx[j]], w->J[j]);
        for (uint32_t k = 0; k < 6u; k++) { w->J[j][k] *= scale; }
    }
}

static void eval_candidate(const kc_est_t *est, const float *q, kc_acq_work_t *w)
{
    kc_ctx_t ctx = {0};
    kc_loads_t work;
    for (uint32_t i = 0; i < 3u; i++) { ctx.g_m_s2[i] = est->arm->gravity_m_s2[i]; }
    if (est->n_obs > 0u) { ctx = est->obs[est->n_obs - 1u].ctx; }
    for (uint32_t j = 0; j < KC_JOINT_MAX; j++) { ctx.q[j] = (double)q[j]; }
    kc_fixed_eval(&w->fixed, &ctx, kc_fixed_needed_loads(&w->fixed, &ctx, &work), true, &w->eval);
}

static void zero(double *A, uint32_t n)
{
    for (uint32_t i = 0; i < n; i++) {
        for (uint32_t j = 0; j < n; j++) { A[i * LD + j] = 0.0; }
    }
}

/* The requested coefficients, and their prior precision in units of scale. */
static void take_coefs(const kc_est_t *est, kc_acq_work_t *w)
{
    w->n = 0u;
    for (uint32_t c = 0; c < est->terms->n_coef; c++) {
        const kc_coef_t *k = &est->terms->coef[c];
        if (k->enabled == 0u || ((est->opt.free_mask >> c) & 1u) == 0u) { continue; }
        const bool own = est->opt.use_prior != 0u && k->prior_sigma > 0.0;
        const double usual = w->by_bounds ? kc_est_bound_sigma(k) / k->scale : KC_ACQ_SIGMA;
        double s = own ? k->scale / k->prior_sigma : 1.0 / usual;
        if (w->by_prior) { s = k->scale / est->prior_sigma[c]; }
        w->prior[w->n] = s * s;
        w->idx[w->n++] = c;
    }
}

/* ---- parts: M = (sum J' W J + prior)^-1 over the observations ---- */

typedef enum { OVER = 0, INFORM, INVERT, SPREAD, WEIGH, GAIN } phase_t;

static void inform(const kc_est_t *est, uint32_t i, kc_acq_work_t *w)
{
    const kc_obs_t *o = &est->obs[i];
    kc_loads_t work;
    double W[36];
    double r[6];
    const kc_loads_t *loads = kc_fixed_needed_loads(&w->fixed, &o->ctx, &work);
    const uint32_t m = kc_fixed_residual(&w->fixed, o, loads, r, &w->eval);
    (void)kc_la_whiten(o->cov, m, W); /* kc_est_add has checked it */
    take_jacobian(est, W, w);
    kc_la_rank_update(w->S, w->n, LD, &w->J[0][0]);
}

/* S becomes zero for what is summed over the candidates. */
static kc_status_t invert(kc_acq_work_t *w)
{
    if (kc_la_chol(w->S, w->n, LD) != KC_OK) { return KC_ERR_NUM; }
    kc_la_chol_inverse(w->S, w->n, LD, w->M, LD);
    for (uint32_t j = 0; j < w->n; j++) { w->known += 1.0 - w->M[j * (LD + 1u)] * w->prior[j]; }
    zero(w->S, w->n);
    return KC_OK;
}

/* ---- vopt: N = M (sum over X of J'J) M into S, J in units of the requested variance. By N, what a
 * measurement takes off the total is a 6x6 trace. ---- */

static void spread(const kc_est_t *est, const float *q, kc_acq_work_t *w)
{
    double unit[36] = {0};
    for (uint32_t k = 0; k < 6u; k++) { unit[k * 7u] = (k < 3u) ? 1.0 / w->len_m : 1.0; }
    eval_candidate(est, q, w);
    take_jacobian(est, unit, w);
    kc_la_rank_update(w->S, w->n, LD, &w->J[0][0]);
}

/* total: trace of (sum J'J) M, the total before. */
static void weigh(kc_acq_work_t *w)
{
    const uint32_t n = w->n;
    double *line = w->prior; /* no longer needed */
    w->total = 0.0;
    kc_la_mirror(w->S, n, LD);
    for (uint32_t i = 0; i < n; i++) { /* S <- S M, row by row */
        for (uint32_t j = 0; j < n; j++) {
            line[j] = 0.0;
            for (uint32_t k = 0; k < n; k++) { line[j] += w->S[i * LD + k] * w->M[k * LD + j]; }
        }
        for (uint32_t j = 0; j < n; j++) { w->S[i * LD + j] = line[j]; }
        w->total += line[i];
    }
    for (uint32_t j = 0; j < n; j++) { /* S <- M S, column by column */
        for (uint32_t i = 0; i < n; i++) {
            line[i] = 0.0;
            for (uint32_t k = 0; k < n; k++) { line[i] += w->M[i * LD + k] * w->S[k * LD + j]; }
        }
        for (uint32_t i = 0; i < n; i++) { w->S[i * LD + j] = line[i]; }
    }
}

/* ---- the candidate of the largest gain ---- */

/* Variance of the tool's position by the whitened covariance A of its pose, before a measurement. */
static double position_m2(const kc_acq_work_t *w, const double A[36])
{
    double sum = 0.0;
    for (uint32_t k = 0; k < 3u; k++) {
        for (uint32_t i = 0; i <= k; i++) {
            for (uint32_t j = 0; j <= k; j++) { sum += w->L[k * 3u + i] * A[i * 6u + j] * w->L[k * 3u + j]; }
        }
    }
    return sum;
}

/* dopt: log det(I + J M J'). vopt: tr((I + J M J')^-1 J N J'). A: J M J'. */
static kc_status_t gain(kc_acq_work_t *w, double A[36], double *value)
{
    double B[36];
    for (uint32_t k = 0; k < 6u; k++) { A[k * 7u] += 1.0; }
    *value = 0.0;
    if (kc_la_chol(A, 6u, 6u) != KC_OK) { return KC_ERR_NUM; }
    if (w->kind == KC_ACQ_DOPT) {
        for (uint32_t k = 0; k < 6u; k++) { *value += 2.0 * kc_log(A[k * 7u]); }
        return KC_OK;
    }
    kc_la_congruence(w->S, w->n, LD, &w->J[0][0], B);
    for (uint32_t k = 0; k < 6u; k++) {
        kc_la_chol_solve(A, 6u, 6u, &B[k * 6u]); /* row k of a symmetric B is its column k */
        *value += B[k * 7u];
    }
    return KC_OK;
}

/* Per unit of cost; a share of the variance as its logarithm, so that gains add up like those of dopt. */
static double per_cost(const kc_acq_work_t *w, double g)
{
    if (w->cost == NULL) { return g; }
    const double nats = (w->kind == KC_ACQ_VOPT) ? -kc_log(kc_max(1.0 - g / w->total, LEFT_MIN)) : g;
    return nats / (double)w->cost[w->i];
}

/* Those that are safe come first, and among them the largest gain; of others the most certain one. */
static bool better(const kc_acq_work_t *w, bool safe, double g, double sigma2_m2)
{
    if (w->status != KC_OK || safe != w->safe) { return w->status != KC_OK || safe; }
    return safe ? g > w->value : sigma2_m2 < w->sigma2_m2;
}

static kc_status_t consider(const kc_est_t *est, const float *q, kc_acq_work_t *w)
{
    double g, A[36];
    eval_candidate(est, q, w);
    take_jacobian(est, w->W, w);
    kc_la_congruence(w->M, w->n, LD, &w->J[0][0], A);
    const double sigma2_m2 = position_m2(w, A);
    const bool safe = w->safe_m2 <= 0.0 || sigma2_m2 <= w->safe_m2;
    if (!safe && w->only_safe != NULL) { w->only_safe[w->i] = 0u; }
    if (gain(w, A, &g) != KC_OK) { return KC_ERR_NUM; }
    g = per_cost(w, g);
    if (better(w, safe, g, sigma2_m2)) {
        w->best = w->i;
        w->value = g;
        w->safe = safe;
        w->sigma2_m2 = sigma2_m2;
        w->status = KC_OK;
    }
    return KC_OK;
}

/* ---- steps ---- */

void kc_acq_begin(const kc_acq_ask_t *ask, const kc_est_t *est, kc_acq_work_t *work)
{
    double C[9];
    work->phase = (uint8_t)OVER;
    work->status = KC_ERR_ARG;
    work->kind = ask->kind;
    work->len_m = ask->len_m;
    work->by_bounds = ask->by_bounds;
    work->by_prior = ask->by_prior;
    work->only_safe = ask->only_safe;
    work->safe_m2 = ask->safe_m * ask->safe_m;
    work->cost = ask->cost;
    work->i = 0u;
    work->safe = false;
    work->known = 0.0;
    take_coefs(est, work);
    if ((ask->kind != KC_ACQ_DOPT && ask->kind != KC_ACQ_VOPT) || work->n == 0u || !(ask->len_m > 0.0) ||
        kc_la_whiten(ask->cov, 6u, work->W) != KC_OK) {
        return;
    }
    for (uint32_t i = 0; i < 9u; i++) { C[i] = ask->cov[i / 3u * 6u + i % 3u]; }
    (void)kc_la_chol(C, 3u, 3u); /* a leading block of what kc_la_whiten has factored */
    for (uint32_t i = 0; i < 9u; i++) { work->L[i] = C[i]; }
    kc_model_fix(est->arm, est->terms, est->coef, &work->fixed);
    zero(work->S, work->n);
    for (uint32_t j = 0; j < work->n; j++) { work->S[j * LD + j] = work->prior[j]; }
    work->phase = (uint8_t)INFORM;
}

void kc_acq_info_begin(kc_acq_t kind, const kc_est_t *est, const double cov[36], double len_m,
                       kc_acq_work_t *work)
{
    const kc_acq_ask_t ask = {.kind = kind, .cov = cov, .len_m = len_m};
    kc_acq_begin(&ask, est, work);
}

static void next(kc_acq_work_t *w, phase_t phase)
{
    w->phase = (uint8_t)phase;
    w->i = 0u;
}

static void fail(kc_acq_work_t *w)
{
    w->status = KC_ERR_NUM;
    w->phase = (uint8_t)OVER;
}

/* How many units the phase has; what one costs; unit i of it; and what comes after the last one. */
static uint32_t units(const kc_est_t *est, uint32_t n_cand, const kc_acq_work_t *w)
{
    if (w->phase == (uint8_t)INFORM) { return est->n_obs; }
    return w->phase == (uint8_t)SPREAD || w->phase == (uint8_t)GAIN ? n_cand : 1u;
}

static uint64_t unit_cost(const kc_est_t *est, const kc_acq_work_t *w)
{
    const uint64_t n = w->n;
    const uint64_t jacobian = kc_model_cost(est->arm, est->terms, est->coef, true) + 2000u + 130u * n;
    switch (w->phase) {
    case INVERT: return 20000u + 3u * n * n * n;
    case WEIGH: return 20000u + 20u * n * n * n;
    case GAIN: return jacobian + 4000u + (w->kind == KC_ACQ_VOPT ? 2u : 1u) * (60u * n + 14u * n * n);
    default: return jacobian + 14u * n * n;
    }
}

static bool needed(const kc_est_t *est, const uint8_t *usable, const kc_acq_work_t *w)
{
    if (w->phase == (uint8_t)INFORM) { return est->outlier[w->i] == 0u; }
    return w->phase != (uint8_t)GAIN || usable[w->i] != 0u;
}

static void do_unit(const kc_est_t *est, const float *q, kc_acq_work_t *w)
{
    const float *at = &q[w->i * KC_JOINT_MAX];
    kc_status_t st = KC_OK;
    switch (w->phase) {
    case INFORM: inform(est, w->i, w); break;
    case INVERT: st = invert(w); break;
    case SPREAD: spread(est, at, w); break;
    case WEIGH: weigh(w); break;
    default: st = consider(est, at, w); break;
    }
    if (st != KC_OK) { fail(w); }
}

static void after(kc_acq_work_t *w, uint32_t n_cand)
{
    switch (w->phase) {
    case INFORM: next(w, INVERT); break;
    case INVERT: next(w, w->kind == KC_ACQ_VOPT ? SPREAD : GAIN); break;
    case SPREAD: next(w, WEIGH); break;
    case WEIGH: next(w, GAIN); break;
    default:
        if (w->kind == KC_ACQ_VOPT && w->cost == NULL && w->status == KC_OK) {
            w->value = (w->total - w->value) / (double)n_cand;
        }
        next(w, OVER);
        break;
    }
}

bool kc_acq_info_step(const kc_est_t *est, const float *q, uint32_t n_cand, const uint8_t *usable,
                      kc_acq_work_t *work, kc_work_t *budget)
{
    while (work->phase != (uint8_t)OVER) {
        const uint32_t n = units(est, n_cand, work);
        const uint64_t cost = unit_cost(est, work);
        for (; work->i < n && work->phase != (uint8_t)OVER; work->i++) {
            if (!needed(est, usable, work)) { continue; }
            if (!kc_work_take(budget, cost)) { return false; }
            do_unit(est, q, work);
        }
        if (work->phase != (uint8_t)OVER) { after(work, n_cand); }
    }
    return true;
}

kc_status_t kc_acq_info(kc_acq_t kind, const kc_est_t *est, const float *q, uint32_t n_cand,
                        const uint8_t *usable, const double cov[36], double len_m, kc_acq_work_t *work,
                        uint32_t *c, double *value)
{
    kc_work_t all = kc_work_unlimited();
    kc_acq_info_begin(kind, est, cov, len_m, work);
    (void)kc_acq_info_step(est, q, n_cand, usable, work, &all);
    if (work->status == KC_OK) {
        *c = work->best;
        *value = work->value;
    }
    return work->status;
}
