/* Primal active-set method for a box-constrained convex QP, with LDL' of the free block.
 *
 * Every iteration minimises over the free variables, as far as the box lets it:
 * - Newton step of the free variables; where a bound comes first, every variable that reaches its
 *   bound at that point becomes fixed, so all others keep room to move;
 * - variables whose pivot vanishes depend on those before them: along their null direction the cost
 *   is flat or falls at a constant rate, and then it is followed to the first bound;
 * - at the minimum over the free ones, the fixed variable with the most wrong gradient becomes free.
 * A freed variable can always move (no ties are left), so the cost falls strictly between releases
 * and no active set comes twice. */
#include "kc_qp.h"

#include "kc_vec.h"

#define LD KC_COEF_MAX

/* Accepted scaled KKT residual. */
#define KKT_TOL 1e-9
/* Gradients below this part of the terms they are the sum of count as zero. */
#define GRAD_TOL 1e-14
/* A pivot below this part of its diagonal is rounding error: H is singular there. */
#define PIVOT_TOL 1e-13
/* So is a curvature below this part of the terms it is the sum of. */
#define FLAT_TOL 1e-15

typedef enum { STEP_FULL, STEP_BLOCKED, STEP_UNBOUNDED } step_t;

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

/* Gradient at x; returns the largest sum of |terms| in it, the scale of its rounding errors. */
static double gradient(kc_qp_t *qp)
{
    double scale = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        const double *row = &qp->H[i * LD];
        double s = qp->g[i], size = kc_fabs(s);
        for (uint32_t j = 0u; j < qp->n; j++) {
            s += row[j] * qp->x[j];
            size += kc_fabs(row[j] * qp->x[j]);
        }
        qp->grad[i] = s;
        scale = kc_max(scale, size);
    }
    return scale;
}

/* How far variable i is from the KKT conditions: its gradient, unless a bound holds against it. */
static double violation(const kc_qp_t *qp, uint32_t i)
{
    const double g = qp->grad[i];
    if (g > 0.0 && qp->x[i] <= qp->lb[i]) { return 0.0; }
    if (g < 0.0 && qp->x[i] >= qp->ub[i]) { return 0.0; }
    return kc_fabs(g);
}

/* The free or the fixed variable (rested) that violates the conditions most; *worst: by how much. */
static uint32_t worst_variable(const kc_qp_t *qp, bool rested, double *worst)
{
    uint32_t at = 0u;
    *worst = 0.0;
    for (uint32_t i = 0u; i < qp->n; i++) {
        const double v = (qp->active[i] != KC_QP_FREE) == rested ? violation(qp, i) : 0.0;
        if (v > *worst) {
            *worst = v;
            at = i;
        }
    }
    return at;
}

/* Keep variable i inside the box; on a bound it becomes fixed. */
static void settle(kc_qp_t *qp, uint32_t i)
{
    qp->x[i] = kc_clamp(qp->x[i], qp->lb[i], qp->ub[i]);
    qp->active[i] = qp->x[i] <= qp->lb[i]   ? KC_QP_AT_LOWER
                    : qp->x[i] >= qp->ub[i] ? KC_QP_AT_UPPER
                                            : KC_QP_FREE;
}

/* LDL' of the free block: unit L in the rows of qp->L, D on its diagonal. A dependent variable gets
 * D = 0 and leaves no trace in later rows. Returns how many are free, listed in qp->idx. */
static uint32_t factor_free(kc_qp_t *qp)
{
    uint32_t m = 0u;
    for (uint32_t i = 0u; i < qp->n; i++) {
        if (qp->active[i] == KC_QP_FREE) { qp->idx[m++] = i; }
    }
    for (uint32_t i = 0u; i < m; i++) {
        double *Li = &qp->L[i * LD];
        const double *Hi = &qp->H[qp->idx[i] * LD];
        const double Hii = Hi[qp->idx[i]];
        for (uint32_t j = 0u; j < i; j++) { /* L_ij D_j */
            const double *Lj = &qp->L[j * LD];
            double s = Hi[qp->idx[j]];
            for (uint32_t k = 0u; k < j; k++) { s -= Li[k] * Lj[k]; }
            Li[j] = Lj[j] > 0.0 ? s : 0.0;
        }
        double d = Hii;
        for (uint32_t j = 0u; j < i; j++) { /* divide by D_j */
            const double Dj = qp->L[j * LD + j];
            const double lij = Dj > 0.0 ? Li[j] / Dj : 0.0;
            d -= lij * Li[j];
            Li[j] = lij;
        }
        Li[i] = d > PIVOT_TOL * kc_fabs(Hii) ? d : 0.0;
    }
    return m;
}

/* d <- L^-T d over the free variables. */
static void solve_lt(kc_qp_t *qp, uint32_t m)
{
    for (uint32_t i = m; i-- > 0u;) {
        for (uint32_t j = 0u; j < i; j++) { qp->d[j] -= qp->L[i * LD + j] * qp->d[i]; }
    }
}

/* Newton direction of the independent free variables; the dependent ones rest. */
static void newton_direction(kc_qp_t *qp, uint32_t m)
{
    for (uint32_t i = 0u; i < m; i++) {
        double s = -qp->grad[qp->idx[i]];
        for (uint32_t j = 0u; j < i; j++) { s -= qp->L[i * LD + j] * qp->d[j]; }
        qp->d[i] = s;
    }
    for (uint32_t i = 0u; i < m; i++) {
        const double D = qp->L[i * LD + i];
        qp->d[i] = D > 0.0 ? qp->d[i] / D : 0.0;
    }
    solve_lt(qp, m);
}

/* Downhill along the null direction of dependent variable k. */
static void flat_direction(kc_qp_t *qp, uint32_t m, uint32_t k)
{
    for (uint32_t i = 0u; i < m; i++) { qp->d[i] = 0.0; }
    qp->d[k] = qp->grad[qp->idx[k]] > 0.0 ? -1.0 : 1.0;
    solve_lt(qp, m);
}

/* Step to the minimum along d, infinite where the cost falls for ever. */
static double exact_step(const kc_qp_t *qp, uint32_t m)
{
    double slope = 0.0, curve = 0.0, size = 0.0;
    for (uint32_t i = 0u; i < m; i++) {
        slope += qp->grad[qp->idx[i]] * qp->d[i];
        for (uint32_t j = 0u; j < m; j++) {
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
static step_t move(kc_qp_t *qp, uint32_t m, double want)
{
    double step = want;
    for (uint32_t i = 0u; i < m; i++) { step = kc_min(room(qp, i), step); }
    if (!(step < KC_INF)) { return STEP_UNBOUNDED; }
    for (uint32_t i = 0u; i < m; i++) {
        const uint32_t v = qp->idx[i];
        const bool meets = room(qp, i) <= step;
        qp->x[v] += step * qp->d[i];
        if (meets) { qp->x[v] = qp->d[i] > 0.0 ? qp->ub[v] : qp->lb[v]; }
        settle(qp, v);
    }
    return step < want ? STEP_BLOCKED : STEP_FULL;
}

/* Largest gradient of the independent free variables; *dependent: the worst of the others. */
static double independent_gradient(const kc_qp_t *qp, uint32_t m, uint32_t *dependent)
{
    double worst = 0.0, worst_dependent = 0.0;
    for (uint32_t i = 0u; i < m; i++) {
        const double g = kc_fabs(qp->grad[qp->idx[i]]);
        if (qp->L[i * LD + i] > 0.0) {
            worst = kc_max(worst, g);
        } else if (g > worst_dependent) {
            worst_dependent = g;
            *dependent = i;
        }
    }
    return worst;
}

/* One step toward the minimum over the free variables. floor_g: gradient that Newton's method could
 * not improve on, because of rounding. */
static step_t minimise_free(kc_qp_t *qp, double tol)
{
    uint32_t k = 0u;
    const uint32_t m = factor_free(qp);
    const double before = independent_gradient(qp, m, &k);
    const bool newton = before > tol;
    if (newton) {
        newton_direction(qp, m);
    } else {
        flat_direction(qp, m, k);
    }
    const step_t step = move(qp, m, newton ? 1.0 : exact_step(qp, m));
    qp->scale = gradient(qp);
    if (newton && step == STEP_FULL) {
        const double after = independent_gradient(qp, m, &k);
        if (after > 0.5 * before) { qp->floor_g = after; }
    }
    return step;
}

/* KKT residual, and the status it earns. */
static void finish(kc_qp_t *qp)
{
    double worst_free, worst_fixed;
    (void)worst_variable(qp, false, &worst_free);
    (void)worst_variable(qp, true, &worst_fixed);
    const double worst = kc_max(worst_free, worst_fixed);
    qp->kkt = worst / kc_max(1.0, max_abs(qp->g, qp->n));
    const bool solved = qp->kkt <= KKT_TOL || worst <= GRAD_TOL * qp->scale;
    if (qp->status == KC_ERR_ITER && solved) { qp->status = KC_OK; }
}

void kc_qp_begin(kc_qp_t *qp)
{
    qp->status = arguments_ok(qp) ? KC_ERR_ITER : KC_ERR_ARG;
    if (qp->status == KC_ERR_ARG) { return; }
    for (uint32_t i = 0u; i < qp->n; i++) { settle(qp, i); }
    qp->floor_g = 0.0;
    qp->scale = gradient(qp);
    qp->iters = 0u;
}

/* A step toward the minimum over the free variables; or, there, one more variable becomes free. False at the
 * minimum over all, and where there is none. */
static bool improve(kc_qp_t *qp)
{
    double worst;
    const double tol = kc_max(GRAD_TOL * qp->scale, qp->floor_g);
    (void)worst_variable(qp, false, &worst);
    if (worst > tol) {
        if (minimise_free(qp, tol) == STEP_UNBOUNDED) { qp->status = KC_ERR_NUM; }
        qp->iters++;
        return qp->status == KC_ERR_ITER;
    }
    const uint32_t wrong = worst_variable(qp, true, &worst);
    if (worst <= tol) { return false; }
    qp->active[wrong] = KC_QP_FREE;
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
