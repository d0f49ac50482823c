/* Box-constrained convex QP: projected Newton, and for what that leaves an active-set method. Both work on the
 * same variables, gradient and factor; here is what begins, ends and bounds them. */
#include "kc_qp_priv.h"
#include "kc_vec.h"

#define LD KC_QP_LD

/* Accepted scaled KKT residual. */
#define KKT_TOL 1e-9
/* Of its iterations, those of projected Newton; it has needed two a variable at most. */
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

/* KKT residual, and the status it earns. */
static void finish(kc_qp_t *qp)
{
    const double worst = kc_qp_worst(qp, true);
    kc_qp_settle_all(qp);
    qp->kkt = worst / kc_max(1.0, qp->g_max);
    if (!kc_v_finite(qp->grad, qp->n)) {
        qp->status = KC_ERR_NUM;
    } else if (qp->status == KC_ERR_ITER && (qp->kkt <= KKT_TOL || kc_qp_rounding(qp, worst))) {
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
        uint32_t at;
        for (at = i; at > 0u && qp->d[at - 1u] < key; at--) {
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
    kc_qp_settle_all(qp);
    order(qp);
    kc_qp_gradient(qp);
    qp->floor_g = 0.0;
    qp->at_minimum = kc_qp_negligible(qp, kc_qp_worst(qp, false));
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
    } else if (qp->at_minimum && kc_qp_negligible(qp, kc_qp_worst(qp, true))) {
        go_on = false;
    } else {
        qp->newton = kc_qp_newton_step(qp) ? qp->newton - 1u : 0u;
        if (qp->newton == 0u) {
            kc_qp_settle_all(qp);
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

/* The factor made anew; and rows of n numbers, of the path with all its bends or of the active-set method. */
uint64_t kc_qp_cost(uint32_t n)
{
    return 5000u + 400u * (uint64_t)n + 60u * (uint64_t)n * n + (uint64_t)n * n * n * 9u / 10u;
}

kc_status_t kc_qp_solve(kc_qp_t *qp)
{
    kc_qp_begin(qp);
    for (uint32_t i = 0u; i < KC_QP_ITER_PER_VAR * KC_COEF_MAX && kc_qp_iterate(qp); i++) {}
    return qp->status;
}
