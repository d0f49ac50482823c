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

static double max_abs(const double *v, uint32_t n)
{
    double m = 0.0;
    for (uint32_t i = 0u; i < n; i++) { m = kc_max(m, kc_fabs(v[i])); }
    return m;
}

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

/* Column by column, as H is symmetric: no sum waits for another. */
void kc_qp_gradient(const kc_qp_t *qp, const double *x, double *out)
{
    const uint32_t n = qp->n;
    uint32_t j = 0u;
    for (uint32_t i = 0u; i < n; i++) { out[i] = qp->g[i]; }
    for (; j + 4u <= n; j += 4u) {
        const double c[4] = {-x[j], -x[j + 1u], -x[j + 2u], -x[j + 3u]};
        if (c[0] == 0.0 && c[1] == 0.0 && c[2] == 0.0 && c[3] == 0.0) { continue; }
        kc_rows_take4(out, &qp->H[j * LD], LD, c, 0u, n);
    }
    for (; j < n; j++) { kc_rows_take(out, &qp->H[j * LD], -x[j], 0u, n); }
}

double kc_qp_terms(const kc_qp_t *qp)
{
    double most = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        double size = kc_fabs(qp->g[i]);
        for (uint32_t j = 0u; j < qp->n; j++) { size += kc_fabs(qp->H[i * LD + j] * qp->x[j]); }
        most = kc_max(most, size);
    }
    return most;
}

bool kc_qp_negligible(const kc_qp_t *qp, double gradient)
{
    if (gradient <= qp->floor_g) { return true; }
    double sum = 0.0, own = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        const double size = kc_fabs(qp->x[i]);
        sum += size;
        own = kc_max(own, kc_fabs(qp->g[i]) + qp->H[i * LD + i] * size);
    }
    if (gradient <= GRAD_TOL * own) { return true; }
    if (gradient > GRAD_TOL * (qp->g_max + qp->H_max * sum)) { return false; }
    return gradient <= GRAD_TOL * kc_qp_terms(qp);
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

static double worst_violation(const kc_qp_t *qp)
{
    double worst = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) { worst = kc_max(worst, kc_qp_violation(qp, i)); }
    return worst;
}

/* KKT residual, and the status it earns. */
static void finish(kc_qp_t *qp)
{
    if (!qp->at_minimum) { kc_qp_gradient(qp, qp->x, qp->grad); }
    const double worst = worst_violation(qp);
    settle_all(qp);
    qp->kkt = worst / kc_max(1.0, max_abs(qp->g, qp->n));
    if (qp->status == KC_ERR_ITER && (qp->kkt <= KKT_TOL || worst <= GRAD_TOL * kc_qp_terms(qp))) {
        qp->status = KC_OK;
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
    settle_all(qp);
    order(qp);
    qp->floor_g = 0.0;
    kc_qp_gradient(qp, qp->x, qp->grad);
    qp->g_max = max_abs(qp->g, qp->n);
    qp->H_max = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) { qp->H_max = kc_max(qp->H_max, kc_fabs(qp->H[i * LD + i])); }
    qp->iters = 0u;
    qp->newton = NEWTON_PER_VAR * qp->n;
    qp->at_minimum = false;
}

/* One iteration; false at the minimum, and where there is none. */
static bool improve(kc_qp_t *qp)
{
    if (qp->newton > 0u) {
        if (qp->at_minimum && kc_qp_negligible(qp, worst_violation(qp))) { return false; }
        qp->newton = kc_qp_newton_step(qp) ? qp->newton - 1u : 0u;
        if (qp->newton == 0u) {
            settle_all(qp);
            kc_qp_gradient(qp, qp->x, qp->grad);
        }
        qp->iters++;
        return true;
    }
    if (!kc_qp_active_step(qp)) { return false; }
    qp->iters++;
    return true;
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
