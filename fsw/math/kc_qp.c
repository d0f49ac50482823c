/* Box-constrained convex QP: projected Newton, and for what that leaves an active-set method. Both work on the
 * same variables, gradient and factor; here is what begins, ends and bounds them. */
#include "kc_qp_priv.h"
#include "kc_rows.h"
#include "kc_vec.h"

#define LD KC_QP_LD

/* Accepted scaled KKT residual. */
#define KKT_TOL 1e-9
/* Gradients below this part of the terms they are the sum of count as zero. */
#define GRAD_TOL 1e-14
/* Iterations of projected Newton per variable; random problems need 3 to 6 in all, nearly singular ones up to one a
 * variable. */
#define NEWTON_PER_VAR 4u

static bool arguments_ok(const kc_qp_t *qp)
{
    if (qp->n == 0u || qp->n > KC_COEF_MAX) { return false; }
    bool ok = kc_v_finite(qp->g, qp->n) && kc_v_finite(qp->x, qp->n);
    for (uint32_t i = 0u; i < qp->n; i++) {
        ok = ok && kc_v_finite(&qp->H[i * LD], qp->n);
        /* NaN fails every comparison; a bound of infinity on the wrong side leaves no x. */
        ok = ok && qp->lb[i] <= qp->ub[i] && qp->lb[i] < KC_INF && qp->ub[i] > -KC_INF;
    }
    return ok;
}

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
bool kc_qp_negligible(const kc_qp_t *qp, double gradient)
{
    double sum = 0.0, own = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        const double size = kc_fabs(qp->x[i]);
        sum += size;
        own = kc_max(own, kc_fabs(qp->g[i]) + kc_fabs(qp->H[i * LD + i]) * size);
    }
    if (gradient <= kc_max(qp->floor_g, GRAD_TOL * own)) { return true; }
    return gradient <= GRAD_TOL * (qp->g_max + qp->H_max * sum) && gradient <= GRAD_TOL * terms(qp);
}

double kc_qp_violation(const kc_qp_t *qp, uint32_t i)
{
    const double g = qp->grad[i];
    if (g > 0.0 && qp->x[i] <= qp->lb[i]) { return 0.0; }
    if (g < 0.0 && qp->x[i] >= qp->ub[i]) { return 0.0; }
    return kc_fabs(g);
}

void kc_qp_settle(kc_qp_t *qp, uint32_t i)
{
    qp->x[i] = kc_clamp(qp->x[i], qp->lb[i], qp->ub[i]);
    qp->active[i] = qp->x[i] <= qp->lb[i]   ? KC_QP_AT_LOWER
                    : qp->x[i] >= qp->ub[i] ? KC_QP_AT_UPPER
                                            : KC_QP_FREE;
}

static void settle_all(kc_qp_t *qp)
{
    for (uint32_t i = 0u; i < qp->n; i++) { kc_qp_settle(qp, i); }
}

/* Of the free variables, or of all. */
static double worst_violation(const kc_qp_t *qp, bool all)
{
    double worst = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        if (all || qp->active[i] == KC_QP_FREE) { worst = kc_max(worst, kc_qp_violation(qp, i)); }
    }
    return worst;
}

/* KKT residual, and the status it earns. */
static void finish(kc_qp_t *qp)
{
    const double worst = worst_violation(qp, true);
    settle_all(qp);
    qp->kkt = worst / kc_max(1.0, qp->g_max);
    if (!kc_v_finite(qp->grad, qp->n)) {
        qp->status = KC_ERR_NUM;
    } else if (qp->status == KC_ERR_ITER && (qp->kkt <= KKT_TOL || worst <= GRAD_TOL * terms(qp))) {
        qp->status = KC_OK;
    } else {
        /* as it is */
    }
}

/* All variables in the order in which they are factored: those with much room, in units of the cost, first. */
static void order(kc_qp_t *qp)
{
    for (uint32_t i = 0u; i < qp->n; i++) {
        const double width = qp->ub[i] - qp->lb[i];
        const double key = kc_min(width * width * qp->H[i * LD + i], KC_INF); /* 0 times infinity: NaN */
        uint32_t at = i;
        for (; at > 0u && qp->d[at - 1u] < key; at--) {
            qp->d[at] = qp->d[at - 1u];
            qp->idx[at] = qp->idx[at - 1u];
        }
        qp->d[at] = key;
        qp->idx[at] = i;
    }
    qp->m = qp->n;
    qp->rows = 0u;
}

void kc_qp_begin(kc_qp_t *qp)
{
    qp->status = arguments_ok(qp) ? KC_ERR_ITER : KC_ERR_ARG;
    if (qp->status == KC_ERR_ARG) { return; }
    qp->g_max = 0.0;
    qp->H_max = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        qp->g_max = kc_max(qp->g_max, kc_fabs(qp->g[i]));
        qp->H_max = kc_max(qp->H_max, kc_fabs(qp->H[i * LD + i]));
    }
    settle_all(qp);
    order(qp);
    kc_qp_gradient(qp);
    qp->floor_g = 0.0;
    qp->at_minimum = kc_qp_negligible(qp, worst_violation(qp, false));
    qp->newton = NEWTON_PER_VAR * qp->n;
    qp->iters = 0u;
}

/* One iteration; false at the minimum, and where there is none. What projected Newton leaves, the active-set method
 * takes up where it is. */
static bool improve(kc_qp_t *qp)
{
    bool go_on = true;
    if (qp->newton == 0u) {
        go_on = kc_qp_active_step(qp);
    } else if (qp->at_minimum && kc_qp_negligible(qp, worst_violation(qp, true))) {
        go_on = false;
    } else {
        qp->newton = kc_qp_newton_step(qp) ? qp->newton - 1u : 0u;
        if (qp->newton == 0u) {
            settle_all(qp);
            kc_qp_gradient(qp);
        }
    }
    qp->iters += go_on ? 1u : 0u;
    return go_on;
}

bool kc_qp_iterate(kc_qp_t *qp)
{
    if (qp->status == KC_ERR_ARG) { return false; }
    if (improve(qp) && qp->iters < KC_QP_ITER_PER_VAR * qp->n) { return true; }
    finish(qp);
    return false;
}

uint64_t kc_qp_cost(uint32_t n)
{
    return 5000u + 100u * (uint64_t)n + 30u * (uint64_t)n * n + (uint64_t)n * n * n * 6u / 10u;
}

kc_status_t kc_qp_solve(kc_qp_t *qp)
{
    kc_qp_begin(qp);
    for (uint32_t i = 0u; i < KC_QP_ITER_PER_VAR * KC_COEF_MAX && kc_qp_iterate(qp); i++) {}
    return qp->status;
}
