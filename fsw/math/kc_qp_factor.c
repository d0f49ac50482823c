/* LDL' of the free block of H, whose rows are kept while the order of the variables before them stays. */
#include "kc_qp_priv.h"
#include "kc_rows.h"

#define LD KC_QP_LD

/* A pivot below this part of its diagonal is rounding error: H is singular there. */
#define PIVOT_TOL 1e-13

/* The rows of those that are no longer free are taken out; a later row moves with its columns before the first
 * change. Returns that place; *kept: how many are left. */
static uint32_t take_out(kc_qp_t *qp, uint32_t *kept)
{
    uint32_t first = qp->rows, k = 0u;
    for (uint32_t i = 0u; i < qp->m; i++) {
        const uint32_t v = qp->idx[i];
        if (qp->active[v] != KC_QP_FREE) {
            first = i < first ? i : first;
            continue;
        }
        if (k != i) {
            qp->idx[k] = v;
            for (uint32_t j = 0u; j < first; j++) { qp->L[k * LD + j] = qp->L[i * LD + j]; }
        }
        k++;
    }
    *kept = k;
    return first;
}

/* Behind them come those that have become free, in the order of their numbers. */
static void append(kc_qp_t *qp, uint32_t kept)
{
    bool listed[KC_COEF_MAX];
    for (uint32_t v = 0u; v < qp->n; v++) { listed[v] = false; }
    for (uint32_t i = 0u; i < kept; i++) { listed[qp->idx[i]] = true; }
    qp->m = kept;
    for (uint32_t v = 0u; v < qp->n; v++) {
        if (qp->active[v] == KC_QP_FREE && !listed[v]) { qp->idx[qp->m++] = v; }
    }
}

/* Row i of the factor, whose columns before `from` are there: L D, then 1 / D. */
static void factor_row(kc_qp_t *qp, uint32_t i, uint32_t from)
{
    double *w = &qp->L[i * LD];
    const double *h = &qp->H[qp->idx[i] * LD];
    const double h_ii = h[qp->idx[i]];
    for (uint32_t j = from; j < i; j++) { w[j] = h[qp->idx[j]]; }
    kc_rows_forward(qp->L, LD, w, from, i);
    double odd = 0.0, even = 0.0;
    for (uint32_t j = 0u; j < i; j++) {
        const double l = w[j] * qp->inv_d[j];
        qp->L[j * LD + i] = l;
        if ((j & 1u) != 0u) {
            odd += l * w[j];
        } else {
            even += l * w[j];
        }
    }
    const double d = h_ii - (even + odd);
    const bool independent = d > PIVOT_TOL * kc_fabs(h_ii);
    w[i] = independent ? d : 0.0;
    qp->inv_d[i] = independent ? 1.0 / d : 0.0;
}

bool kc_qp_factor(kc_qp_t *qp, bool strict)
{
    uint32_t kept;
    const uint32_t first = take_out(qp, &kept);
    append(qp, kept);
    bool go_on = true;
    for (uint32_t i = first; i < qp->m && go_on; i++) {
        factor_row(qp, i, i < kept ? first - first % 4u : 0u);
        go_on = !strict || qp->inv_d[i] > 0.0;
    }
    qp->rows = go_on ? qp->m : 0u;
    return go_on;
}

void kc_qp_newton_direction(kc_qp_t *qp)
{
    for (uint32_t i = 0u; i < qp->m; i++) { qp->d[i] = -qp->grad[qp->idx[i]]; }
    kc_rows_forward(qp->L, LD, qp->d, 0u, qp->m);
    kc_rows_backward(qp->L, LD, qp->inv_d, qp->d, qp->m);
}

void kc_qp_flat_direction(kc_qp_t *qp, uint32_t k)
{
    for (uint32_t i = 0u; i < qp->m; i++) { qp->d[i] = 0.0; }
    qp->d[k] = qp->grad[qp->idx[k]] > 0.0 ? -1.0 : 1.0;
    kc_rows_take(qp->d, &qp->L[k * LD], qp->d[k], 0u, k);
    kc_rows_backward(qp->L, LD, qp->inv_d, qp->d, k);
}
