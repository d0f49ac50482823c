/* LDL' of the free block of H, whose rows are kept while the order of the variables before them stays. */
#include "kc_qp_priv.h"
#include "kc_rows_priv.h"

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

/* A row is solved for four columns at a time, as kc_rows_forward does, but all rows for the same ones: their sums do not
 * wait for each other. Columns before `solved` are done. */
typedef struct {
    uint32_t first, kept; /* rows: from the first that is new or moved; behind `kept` are new ones */
    uint32_t solved; /* columns of a row that moved which are done, a multiple of 4 */
} rows_t;

static uint32_t solved(const rows_t *rows, uint32_t i) { return i < rows->kept ? rows->solved : 0u; }

/* What the rows are made of; q and until: the sums of L D L' in even and odd columns, for the pivots. */
static void load(kc_qp_t *qp, const rows_t *rows)
{
    for (uint32_t i = rows->first; i < qp->m; i++) {
        const double *h = &qp->H[qp->idx[i] * LD];
        double *w = &qp->L[i * LD];
        for (uint32_t j = solved(rows, i); j <= i; j++) { w[j] = h[qp->idx[j]]; }
        qp->q[i] = 0.0;
        qp->until[i] = 0.0;
    }
}

/* The last columns of row i, from j0 on, and its pivot. */
static void finish_row(kc_qp_t *qp, uint32_t i, uint32_t j0)
{
    double *w = &qp->L[i * LD];
    const double h_ii = w[i];
    for (uint32_t j = j0; j < i; j++) {
        const double l = w[j] * qp->inv_d[j];
        kc_rows_take(w, &qp->L[j * LD], w[j], j + 1u, i);
        qp->L[j * LD + i] = l;
        ((j & 1u) != 0u ? qp->until : qp->q)[i] += l * w[j];
    }
    const double d = h_ii - (qp->q[i] + qp->until[i]);
    const bool independent = d > PIVOT_TOL * kc_fabs(h_ii);
    w[i] = independent ? d : 0.0;
    qp->inv_d[i] = independent ? 1.0 / d : 0.0;
}

/* Four columns of row i: L D, and L' above the diagonal. */
static void four_columns(kc_qp_t *qp, uint32_t i, uint32_t j, bool done)
{
    double *w = &qp->L[i * LD + j], *u = &qp->L[j * LD + i];
    const double *inv_d = &qp->inv_d[j];
    if (!done) { kc_rows_forward4(&qp->L[j * LD + j], LD, w); }
    const double l[4] = {w[0] * inv_d[0], w[1] * inv_d[1], w[2] * inv_d[2], w[3] * inv_d[3]};
    u[0] = l[0];
    u[LD] = l[1];
    u[2u * LD] = l[2];
    u[3u * LD] = l[3];
    qp->q[i] = (qp->q[i] + l[0] * w[0]) + l[2] * w[2];
    qp->until[i] = (qp->until[i] + l[1] * w[1]) + l[3] * w[3];
}

bool kc_qp_factor(kc_qp_t *qp, bool strict)
{
    rows_t rows;
    rows.first = take_out(qp, &rows.kept);
    rows.solved = rows.first - rows.first % 4u;
    append(qp, rows.kept);
    load(qp, &rows);
    qp->rows = 0u;
    for (uint32_t j = 0u; j < qp->m; j += 4u) {
        const uint32_t next = j + 4u;
        for (uint32_t i = j > rows.first ? j : rows.first; i < next && i < qp->m; i++) {
            finish_row(qp, i, j);
            if (strict && !(qp->inv_d[i] > 0.0)) { return false; }
        }
        const uint32_t below = next > rows.first ? next : rows.first;
        for (uint32_t i = below; i < qp->m; i++) { four_columns(qp, i, j, j < solved(&rows, i)); }
        for (uint32_t i = below; i < qp->m; i++) {
            double *w = &qp->L[i * LD];
            const uint32_t from = solved(&rows, i);
            kc_rows_take4(w, &qp->L[j * LD], LD, &w[j], next > from ? next : from, i);
        }
    }
    qp->rows = qp->m;
    return true;
}

void kc_qp_newton_direction(kc_qp_t *qp)
{
    for (uint32_t i = 0u; i < qp->m; i++) { qp->d[i] = -qp->grad[qp->idx[i]]; }
    kc_rows_forward(qp->L, LD, qp->d, qp->m);
    kc_rows_backward(qp->L, LD, qp->inv_d, qp->d, qp->m);
}

void kc_qp_flat_direction(kc_qp_t *qp, uint32_t k)
{
    for (uint32_t i = 0u; i < qp->m; i++) { qp->d[i] = 0.0; }
    qp->d[k] = qp->grad[qp->idx[k]] > 0.0 ? -1.0 : 1.0;
    kc_rows_take(qp->d, &qp->L[k * LD], qp->d[k], 0u, k);
    kc_rows_backward(qp->L, LD, qp->inv_d, qp->d, k);
}
