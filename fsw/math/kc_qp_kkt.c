/* The conditions of Karush, Kuhn and Tucker at x: gradient, sides of the bounds, what is left. */
#include "kc_qp_priv.h"
#include "kc_rows_priv.h"

#define LD KC_QP_LD

/* Gradients below this part of the terms they are the sum of count as zero. */
#define GRAD_TOL 1e-14

/* Row by row instead of sum by sum, as H is symmetric: no addition waits for the one before it. */
void kc_qp_gradient(kc_qp_t *qp)
{
    const uint32_t n = qp->n;
    uint32_t j = 0u;
    for (uint32_t i = 0u; i < n; i++) { qp->grad[i] = qp->g[i]; }
    for (; j + 4u <= n; j += 4u) {
        const double c[4] = {-qp->x[j], -qp->x[j + 1u], -qp->x[j + 2u], -qp->x[j + 3u]};
        const double most = kc_max(kc_max(kc_fabs(c[0]), kc_fabs(c[1])),
                                   kc_max(kc_fabs(c[2]), kc_fabs(c[3])));
        if (most > 0.0) { kc_rows_take4(qp->grad, &qp->H[j * LD], LD, c, 0u, n); } /* a start is often 0 */
    }
    for (; j < n; j++) { kc_rows_take(qp->grad, &qp->H[j * LD], -qp->x[j], 0u, n); }
}

/* Largest sum of |terms| in a component of the gradient: the scale of its rounding errors. */
static double terms(const kc_qp_t *qp)
{
    double most = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        double size = kc_fabs(qp->g[i]);
        for (uint32_t j = 0u; j < qp->n; j++) { size += kc_fabs(qp->H[i * LD + j] * qp->x[j]); }
        most = kc_max(most, size);
    }
    return most;
}

/* The largest sum of terms is not computed where it can be told without: it is at least the largest of own terms, and
 * no |H_ij| is larger than the largest of the diagonal. */
bool kc_qp_rounding(const kc_qp_t *qp, double gradient)
{
    double sum = 0.0, own = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        const double size = kc_fabs(qp->x[i]);
        sum += size;
        own = kc_max(own, kc_fabs(qp->g[i]) + kc_fabs(qp->H[i * LD + i]) * size);
    }
    if (gradient <= GRAD_TOL * own) { return true; }
    return gradient <= GRAD_TOL * (qp->g_max + qp->H_max * sum) && gradient <= GRAD_TOL * terms(qp);
}

bool kc_qp_negligible(const kc_qp_t *qp, double gradient)
{
    return gradient <= qp->floor_g || kc_qp_rounding(qp, gradient);
}

void kc_qp_settle(kc_qp_t *qp, uint32_t i)
{
    qp->x[i] = kc_clamp(qp->x[i], qp->lb[i], qp->ub[i]);
    qp->active[i] = qp->x[i] <= qp->lb[i]   ? KC_QP_AT_LOWER
                    : qp->x[i] >= qp->ub[i] ? KC_QP_AT_UPPER
                                            : KC_QP_FREE;
}

void kc_qp_settle_all(kc_qp_t *qp)
{
    for (uint32_t i = 0u; i < qp->n; i++) { kc_qp_settle(qp, i); }
}

double kc_qp_worst(const kc_qp_t *qp, bool all)
{
    double worst = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        if (all || qp->active[i] == KC_QP_FREE) { worst = kc_max(worst, kc_qp_violation(qp, i)); }
    }
    return worst;
}
