/* Projected Newton: of the methods of Bertsekas, "Projected Newton methods for optimization problems with simple
 * constraints", SIAM J. Control and Optimization 20, 1982.
 *
 * Newton's direction over the free variables leads to the minimum over them. Projected onto the box it bends at every
 * bound that it meets: many variables become fixed in one iteration. The whole projected step is taken if the cost
 * falls enough; otherwise the path is followed to the first minimum along it. Only where a whole step met no bound, at
 * the minimum over the free variables, all that are fixed by a bound that does not hold against their gradient become
 * free. Newton's direction descends for them too where a bound clips it at once.
 *
 * H_FF d = -g_F is known without a product, so that the gradient of the free variables goes along the path for a
 * column of H for each bound that is met; that of all variables is computed at the minimum only. The cost falls from
 * one such minimum to the next. */
#include "kc_qp_priv.h"

#define LD KC_QP_LD

/* Part of the fall that the slope promises; a projected step that falls less is not taken. */
#define ARMIJO 1e-4

static void release(kc_qp_t *qp)
{
    for (uint32_t i = 0u; i < qp->n; i++) {
        if (kc_qp_violation(qp, i) > 0.0) { qp->active[i] = KC_QP_FREE; }
    }
}

/* q = H d of the free variables. */
static void product_of_direction(kc_qp_t *qp)
{
    for (uint32_t i = 0u; i < qp->m; i++) { qp->q[i] = -qp->grad[qp->idx[i]]; }
}

/* Of the direction of the variable in place i this part goes: so does its column in q. */
static void take_part(kc_qp_t *qp, uint32_t i, double part)
{
    const double *h = &qp->H[qp->idx[i] * LD];
    for (uint32_t k = 0u; k < qp->m; k++) { qp->q[k] -= part * h[qp->idx[k]]; }
}

/* Where the whole step leads the variable in place i, inside the box. */
static double projected(const kc_qp_t *qp, uint32_t i)
{
    const uint32_t v = qp->idx[i];
    return kc_clamp(qp->x[v] + qp->d[i], qp->lb[v], qp->ub[v]);
}

/* The whole step, projected, where the cost falls enough by it. *whole: no bound clips it; then it is the minimum over
 * the free variables, and what the cost falls may be rounding. */
static bool step_projected(kc_qp_t *qp, bool *whole)
{
    double slope = 0.0, curve = 0.0;
    *whole = true;
    product_of_direction(qp);
    for (uint32_t i = 0u; i < qp->m; i++) {
        const uint32_t v = qp->idx[i];
        const double to = qp->x[v] + qp->d[i];
        if (to < qp->lb[v] || to > qp->ub[v]) {
            take_part(qp, i, to - projected(qp, i));
            *whole = false;
        }
    }
    for (uint32_t i = 0u; i < qp->m; i++) {
        const uint32_t v = qp->idx[i];
        const double step = projected(qp, i) - qp->x[v];
        slope += qp->grad[v] * step;
        curve += qp->q[i] * step;
    }
    const bool falls = slope < 0.0 && slope + 0.5 * curve <= ARMIJO * slope;
    const bool rounding = *whole && kc_finite(slope);
    if (!falls && !rounding) { return false; }
    for (uint32_t i = 0u; i < qp->m; i++) {
        const uint32_t v = qp->idx[i];
        qp->x[v] = projected(qp, i);
        qp->grad[v] += qp->q[i];
        kc_qp_settle(qp, v);
    }
    return true;
}

/* The length of the path at which each free variable meets its bound. */
static void begin_path(kc_qp_t *qp)
{
    product_of_direction(qp);
    for (uint32_t i = 0u; i < qp->m; i++) {
        const uint32_t v = qp->idx[i];
        qp->until[i] = KC_INF;
        if (qp->d[i] > 0.0) { qp->until[i] = (qp->ub[v] - qp->x[v]) / qp->d[i]; }
        if (qp->d[i] < 0.0) { qp->until[i] = (qp->lb[v] - qp->x[v]) / qp->d[i]; }
    }
}

/* Those that meet their bound at t stay there. The length at which the next one does. */
static double stop_at_bounds(kc_qp_t *qp, double t)
{
    double next = KC_INF;
    for (uint32_t i = 0u; i < qp->m; i++) {
        const uint32_t v = qp->idx[i];
        if (qp->until[i] <= t) {
            qp->x[v] = qp->d[i] > 0.0 ? qp->ub[v] : qp->lb[v];
            take_part(qp, i, qp->d[i]);
            qp->d[i] = 0.0;
            qp->until[i] = KC_INF;
        }
        next = kc_min(qp->until[i], next);
    }
    return next;
}

/* How much farther the cost falls along the straight part of the path that begins here; infinite: for ever. */
static double fall(const kc_qp_t *qp)
{
    double slope = 0.0, curve = 0.0;
    for (uint32_t i = 0u; i < qp->m; i++) {
        slope += qp->grad[qp->idx[i]] * qp->d[i];
        curve += qp->q[i] * qp->d[i];
    }
    if (!(slope < 0.0)) { return 0.0; }
    return curve > 0.0 ? -slope / curve : KC_INF;
}

/* Along the projected direction to the first minimum; false where there is none, or no way to go. */
static bool step_along_path(kc_qp_t *qp)
{
    double t = 0.0;
    bool over = false;
    begin_path(qp);
    for (uint32_t bends = 0u; bends <= qp->m && !over; bends++) {
        const double next = stop_at_bounds(qp, t);
        const double length = kc_min(fall(qp), next - t);
        over = length < next - t;
        if (!(length < KC_INF)) { return false; }
        for (uint32_t i = 0u; i < qp->m; i++) {
            qp->x[qp->idx[i]] += length * qp->d[i];
            qp->grad[qp->idx[i]] += length * qp->q[i];
        }
        t = over ? t + length : next;
    }
    for (uint32_t i = 0u; i < qp->m; i++) { kc_qp_settle(qp, qp->idx[i]); }
    return t > 0.0;
}

bool kc_qp_newton_step(kc_qp_t *qp)
{
    const bool was_minimum = qp->at_minimum;
    bool whole = false;
    if (was_minimum) { release(qp); }
    qp->at_minimum = false;
    if (!kc_qp_factor(qp, true)) { return false; }
    const double before = was_minimum ? kc_qp_worst(qp, false) : KC_INF; /* along a path it is not exact */
    kc_qp_newton_direction(qp);
    if (!step_projected(qp, &whole)) { return step_along_path(qp); }
    if (whole) {
        kc_qp_gradient(qp);
        qp->at_minimum = true;
        const double after = kc_qp_worst(qp, false);
        if (after > 0.5 * before) { qp->floor_g = after; }
    }
    return true;
}
