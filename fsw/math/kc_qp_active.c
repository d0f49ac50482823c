/* Active-set method for what projected Newton leaves: singular H, and problems where its steps do not help.
 *
 * Every iteration minimises over the free variables, as far as the box lets it:
 * - Newton step of the free variables; where a bound comes first, every variable that reaches its
 *   bound at that point becomes fixed, so all others keep room to move;
 * - variables whose pivot vanishes depend on those before them: along their null direction the cost
 *   is flat or falls at a constant rate, and then it is followed to the first bound;
 * - at the minimum over the free ones, the fixed variable with the most wrong gradient becomes free.
 * A freed variable can always move (no ties are left), so the cost falls strictly between releases
 * and no active set comes twice. */
#include "kc_qp_priv.h"

#define LD KC_QP_LD

/* A curvature below this part of the terms it is the sum of is rounding error. */
#define FLAT_TOL 1e-15

typedef enum { STEP_FULL, STEP_BLOCKED, STEP_UNBOUNDED } step_t;

/* The fixed variable that violates the conditions most; *worst: by how much. */
static uint32_t worst_fixed(const kc_qp_t *qp, double *worst)
{
    uint32_t at = 0u;
    *worst = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        const double v = qp->active[i] != KC_QP_FREE ? kc_qp_violation(qp, i) : 0.0;
        if (v > *worst) {
            *worst = v;
            at = i;
        }
    }
    return at;
}

/* Step to the minimum along d, infinite where the cost falls for ever. */
static double exact_step(const kc_qp_t *qp)
{
    double slope = 0.0, curve = 0.0, size = 0.0;
    for (uint32_t i = 0u; i < qp->m; i++) {
        slope += qp->grad[qp->idx[i]] * qp->d[i];
        for (uint32_t j = 0u; j < qp->m; j++) {
            const double c = qp->H[qp->idx[i] * LD + qp->idx[j]] * qp->d[i] * qp->d[j];
            curve += c;
            size += kc_fabs(c);
        }
    }
    return curve > FLAT_TOL * size ? kc_max(-slope / curve, 0.0) : KC_INF;
}

/* Room of free variable i along d, as a step. */
static double room(const kc_qp_t *qp, uint32_t i)
{
    const uint32_t v = qp->idx[i];
    if (qp->d[i] > 0.0) { return (qp->ub[v] - qp->x[v]) / qp->d[i]; }
    if (qp->d[i] < 0.0) { return (qp->lb[v] - qp->x[v]) / qp->d[i]; }
    return KC_INF;
}

/* Move by `want` steps of d, or to the first bound; variables at their bound are fixed there. */
static step_t move(kc_qp_t *qp, double want)
{
    double step = want;
    for (uint32_t i = 0u; i < qp->m; i++) { step = kc_min(room(qp, i), step); }
    if (!(step < KC_INF)) { return STEP_UNBOUNDED; }
    for (uint32_t i = 0u; i < qp->m; i++) {
        const uint32_t v = qp->idx[i];
        const bool meets = room(qp, i) <= step;
        qp->x[v] += step * qp->d[i];
        if (meets) { qp->x[v] = qp->d[i] > 0.0 ? qp->ub[v] : qp->lb[v]; }
        kc_qp_settle(qp, v);
    }
    return step < want ? STEP_BLOCKED : STEP_FULL;
}

/* Largest gradient of the independent free variables; *dependent: the worst of the others. */
static double independent_gradient(const kc_qp_t *qp, uint32_t *dependent)
{
    double worst = 0.0, worst_dependent = 0.0;
    for (uint32_t i = 0u; i < qp->m; i++) {
        const double g = kc_fabs(qp->grad[qp->idx[i]]);
        if (qp->inv_d[i] > 0.0) {
            worst = kc_max(worst, g);
        } else if (g > worst_dependent) {
            worst_dependent = g;
            *dependent = i;
        }
    }
    return worst;
}

/* One step toward the minimum over the free variables. */
static step_t minimise_free(kc_qp_t *qp)
{
    uint32_t k = 0u;
    (void)kc_qp_factor(qp, false);
    const double before = independent_gradient(qp, &k);
    const bool newton = !kc_qp_negligible(qp, before);
    if (newton) {
        kc_qp_newton_direction(qp);
    } else {
        kc_qp_flat_direction(qp, k);
    }
    const step_t step = move(qp, newton ? 1.0 : exact_step(qp));
    kc_qp_gradient(qp);
    if (newton && step == STEP_FULL) {
        const double after = independent_gradient(qp, &k);
        if (after > 0.5 * before) { qp->floor_g = after; }
    }
    return step;
}

bool kc_qp_active_step(kc_qp_t *qp)
{
    double worst;
    if (!kc_qp_negligible(qp, kc_qp_worst(qp, false))) {
        if (minimise_free(qp) == STEP_UNBOUNDED) { qp->status = KC_ERR_NUM; }
        return qp->status == KC_ERR_ITER;
    }
    const uint32_t wrong = worst_fixed(qp, &worst);
    if (kc_qp_negligible(qp, worst)) { return false; }
    qp->active[wrong] = KC_QP_FREE;
    return true;
}
