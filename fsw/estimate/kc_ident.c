#include "kc_est_priv.h"
#include "kc_la.h"
#include "kc_libm.h"

/* A coefficient belongs to a null direction if it moves by this part of the largest in it, in units
 * of scale; exact null directions show rounding (1e-12) elsewhere. */
#define NULL_PART 1e-3
#define TINY 1e-300

/* Null direction of the dependent column at place j of the factored R: the coefficients in it. */
static uint64_t null_members(const kc_est_t *est, const double *F, uint32_t n, uint32_t j)
{
    double top = 1.0; /* of the dependent column itself */
    for (uint32_t i = 0; i < est->rank; i++) { top = kc_max(top, kc_fabs(F[i * n + j])); }
    uint64_t set = (uint64_t)1u << est->column[est->perm[j]];
    for (uint32_t i = 0; i < est->rank; i++) {
        if (kc_fabs(F[i * n + j]) > NULL_PART * top) { set |= (uint64_t)1u << est->column[est->perm[i]]; }
    }
    return set;
}

static void entangle(kc_est_t *est, uint64_t set)
{
    for (uint32_t c = 0; c < est->terms->n_coef; c++) {
        const uint64_t bit = (uint64_t)1u << c;
        if ((set & bit) != 0u) { est->confounded[c] |= set & ~bit; }
    }
}

/* Relative tolerance for kc_la_rank: rank_tol, or what keeps pivots above KC_EST_PIVOT_MIN. The first
 * pivot is the largest column norm. */
static double tolerance(const kc_est_t *est, const double *scale)
{
    double top2 = 0.0;
    for (uint32_t j = 0; j < est->n_column; j++) {
        double s = 0.0;
        for (uint32_t i = 0; i <= j; i++) { s += est->R[i * KC_EST_LD + j] * est->R[i * KC_EST_LD + j]; }
        top2 = kc_max(top2, s * scale[j] * scale[j]);
    }
    return kc_max(est->opt.rank_tol, KC_EST_PIVOT_MIN / kc_sqrt(kc_max(top2, TINY)));
}

uint32_t kc_est_rank(kc_est_t *est, double *F)
{
    double *scale = est->qp.d;
    uint32_t rank = 0u;
    const uint32_t n = est->n_column;
    for (uint32_t i = 0; i < n; i++) {
        scale[i] = est->terms->coef[est->column[i]].scale;
        for (uint32_t j = i; j < n; j++) { F[i * n + j] = est->R[i * KC_EST_LD + j]; }
    }
    kc_la_rank(F, n, n, scale, tolerance(est, scale), est->perm, est->pivot, &rank);
    est->cond = (rank > 0u) ? est->pivot[0] / est->pivot[rank - 1u] : 0.0;
    return rank;
}

void kc_est_identify(kc_est_t *est, uint64_t requested)
{
    double *F = est->qp.L; /* the QP is not running now */
    uint64_t held = 0u;
    est->rank = kc_est_rank(est, F);
    for (uint32_t c = 0; c < est->terms->n_coef; c++) {
        est->status[c] = (uint8_t)((((requested >> c) & 1u) != 0u) ? KC_COEF_ESTIMATED : KC_COEF_MASKED);
        est->confounded[c] = 0u;
    }
    for (uint32_t j = est->rank; j < est->n_column && !est->hold_none; j++) {
        const uint32_t c = est->column[est->perm[j]];
        est->status[c] = (uint8_t)KC_COEF_HELD;
        held |= (uint64_t)1u << c;
        entangle(est, null_members(est, F, est->n_column, j));
    }
    est->n_idx = kc_est_list(est, requested & ~held, est->idx);
    est->weak = (est->hold_none || kc_est_rows(est) < 2u * est->n_idx) ? 1u : 0u;
}
