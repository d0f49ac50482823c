#include "kc_est_priv.h"
#include "kc_la.h"
#include "kc_libm.h"

#define DAMP_START 1e-3
#define DAMP_MAX 1e12
#define DAMP_UP 8.0
#define DAMP_DOWN 0.1
#define TRIES_MAX 20u   /* damping increases for one step: 8^20 passes DAMP_MAX */
#define ROUNDING 1e-13  /* part of the cost that rounding of its sum can hide   */
#define BOUND_SNAP 1e-9 /* of scale: a total this close to its bound is on it   */

/* Model of the cost around est->coef, in steps over scale: H = S R'R S, g = -S R'z, box for the total. */
static void build_qp(kc_est_t *est)
{
    kc_qp_t *qp = &est->qp;
    const uint32_t n = est->n_idx;
    double *z = est->trial; /* column n of R, made contiguous */
    qp->n = n;
    for (uint32_t i = 0; i < n; i++) { z[i] = est->R[i * KC_EST_LD + n]; }
    kc_la_upper_t_mul(est->R, n, KC_EST_LD, z, qp->g);
    kc_la_upper_gram(est->R, n, KC_EST_LD, qp->H, KC_COEF_MAX);
    for (uint32_t i = 0; i < n; i++) {
        const kc_coef_t *k = &est->terms->coef[est->idx[i]];
        const double x = est->coef[est->idx[i]];
        qp->g[i] *= -k->scale;
        qp->lb[i] = (k->lb - x) / k->scale;
        qp->ub[i] = (k->ub - x) / k->scale;
        for (uint32_t j = 0; j < n; j++) {
            qp->H[i * KC_COEF_MAX + j] *= k->scale * est->terms->coef[est->idx[j]].scale;
        }
    }
}

/* Marquardt: the diagonal grows by `by` of its undamped value diag. */
static void damp(kc_est_t *est, const double *diag, double by)
{
    for (uint32_t i = 0; i < est->n_idx; i++) {
        est->qp.H[i * KC_COEF_MAX + i] = diag[i] * (1.0 + by);
        est->qp.x[i] = 0.0;
    }
}

/* est->trial = coef + step, kept inside the box against rounding. Returns the largest step over scale. */
static double take_step(kc_est_t *est)
{
    double largest = 0.0;
    for (uint32_t c = 0; c < est->terms->n_coef; c++) { est->trial[c] = est->coef[c]; }
    for (uint32_t i = 0; i < est->n_idx; i++) {
        const uint32_t c = est->idx[i];
        const kc_coef_t *k = &est->terms->coef[c];
        est->trial[c] = kc_clamp(est->coef[c] + est->qp.x[i] * k->scale, k->lb, k->ub);
        largest = kc_max(largest, kc_fabs(est->qp.x[i]));
    }
    return largest;
}

/* Fall of the quadratic model over the step: -(2 g'x + x'Hx), as cost is twice the QP's. */
static double predicted_fall(const kc_qp_t *qp)
{
    double s = 0.0;
    for (uint32_t i = 0; i < qp->n; i++) {
        double hx = 0.0;
        for (uint32_t j = 0; j < qp->n; j++) { hx += qp->H[i * KC_COEF_MAX + j] * qp->x[j]; }
        s -= (2.0 * qp->g[i] + hx) * qp->x[i];
    }
    return s;
}

static double cost_at(kc_est_t *est, const double *coef)
{
    kc_est_sums_t s;
    kc_est_sums(est, coef, &s);
    return s.chi2 + s.prior;
}

typedef enum { STEP_TAKEN, STEP_LAST, STEP_NONE } step_t;

/* Raise the damping until the cost does not rise. */
static step_t descend(kc_est_t *est, double *lambda, double *cost)
{
    double diag[KC_COEF_MAX] = {0};
    kc_est_linearise(est);
    build_qp(est);
    for (uint32_t i = 0; i < est->n_idx; i++) { diag[i] = est->qp.H[i * KC_COEF_MAX + i]; }
    for (uint32_t t = 0; t < TRIES_MAX && *lambda < DAMP_MAX; t++) {
        damp(est, diag, *lambda);
        (void)kc_qp_solve(&est->qp); /* feasible whatever it answers; the cost decides */
        const double largest = take_step(est);
        const double trial_cost = cost_at(est, est->trial);
        if (trial_cost <= *cost) {
            for (uint32_t c = 0; c < est->terms->n_coef; c++) { est->coef[c] = est->trial[c]; }
            *cost = trial_cost;
            *lambda *= DAMP_DOWN;
            return (largest < est->opt.tol_step) ? STEP_LAST : STEP_TAKEN;
        }
        /* at the minimum the sum's rounding is larger than what is left to gain */
        if (largest < est->opt.tol_step || predicted_fall(&est->qp) < ROUNDING * *cost) { return STEP_LAST; }
        *lambda *= DAMP_UP;
    }
    return STEP_NONE;
}

kc_status_t kc_est_fit(kc_est_t *est)
{
    double lambda = DAMP_START;
    double cost = cost_at(est, est->coef);
    step_t step = STEP_TAKEN;
    if (!kc_finite(cost)) { return KC_ERR_NUM; }
    for (uint32_t it = 0; it < est->opt.iter_max && step == STEP_TAKEN; it++) {
        step = descend(est, &lambda, &cost);
        est->iters++;
    }
    return (step == STEP_LAST) ? KC_OK : KC_ERR_ITER;
}

/* Bound that coefficient c sits on, from its value and the sign of the cost's gradient there. */
static kc_coef_status_t bound_status(const kc_coef_t *k, double x, double grad)
{
    if (x - k->lb <= BOUND_SNAP * k->scale && grad >= 0.0) { return KC_COEF_AT_LOWER; }
    if (k->ub - x <= BOUND_SNAP * k->scale && grad <= 0.0) { return KC_COEF_AT_UPPER; }
    return KC_COEF_ESTIMATED;
}

static double column_norm(const kc_est_t *est, uint32_t j)
{
    double s = 0.0;
    for (uint32_t i = 0; i <= j; i++) { s += est->R[i * KC_EST_LD + j] * est->R[i * KC_EST_LD + j]; }
    return kc_sqrt(s);
}

double kc_est_kkt(kc_est_t *est, double cost)
{
    const uint32_t n = est->n_idx;
    double *z = est->trial;
    double *g = est->qp.g;
    double worst = 0.0;
    kc_est_linearise(est);
    for (uint32_t i = 0; i < n; i++) { z[i] = est->R[i * KC_EST_LD + n]; }
    kc_la_upper_t_mul(est->R, n, KC_EST_LD, z, g);
    for (uint32_t i = 0; i < n; i++) {
        const uint32_t c = est->idx[i];
        const kc_coef_status_t st = bound_status(&est->terms->coef[c], est->coef[c], -g[i]);
        est->status[c] = (uint8_t)st;
        if (st != KC_COEF_ESTIMATED) { continue; }
        worst = kc_max(worst, kc_fabs(g[i]) / (column_norm(est, i) * kc_max(1.0, kc_sqrt(cost))));
    }
    return worst;
}
