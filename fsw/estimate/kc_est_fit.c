#include "kc_est_priv.h"
#include "kc_la.h"
#include "kc_libm.h"

#define DAMP_MAX 1e12
#define DAMP_UP 8.0
#define DAMP_DOWN 0.1
#define TRIES_MAX 20u   /* damping increases for one step: 8^20 passes DAMP_MAX */
#define ROUNDING 1e-13  /* part of the cost that rounding of its sum can hide   */
#define BOUND_SNAP 1e-9 /* of scale: a total this close to its bound is on it   */

/* Model of the cost around est->coef, in steps over scale: H = S (R'R + priors) S, g = -S (R'z + priors), box for the
 * total. */
void kc_est_model(kc_est_t *est)
{
    kc_qp_t *qp = &est->qp;
    const uint32_t n = est->n_idx, all = est->n_column;
    uint32_t at[KC_COEF_MAX] = {0}, m = 0u; /* their columns in R */
    double *z = est->trial; /* the last column of R, made contiguous */
    qp->n = n;
    for (uint32_t j = 0; j < all; j++) {
        z[j] = est->R[j * KC_EST_LD + all];
        if (m < n && est->column[j] == est->idx[m]) { at[m++] = j; }
    }
    kc_la_upper_t_mul(est->R, all, KC_EST_LD, z, qp->grad);
    kc_la_upper_gram(est->R, KC_EST_LD, at, n, qp->H, KC_COEF_MAX);
    for (uint32_t i = 0; i < n; i++) {
        const kc_coef_t *k = &est->terms->coef[est->idx[i]];
        const double x = est->coef[est->idx[i]];
        double centre;
        const double w = kc_est_prior_precision(est, est->idx[i], &centre);
        qp->H[i * KC_COEF_MAX + i] += w * w;
        qp->g[i] = -k->scale * (qp->grad[at[i]] + w * w * (centre - x));
        qp->lb[i] = (k->lb - x) / k->scale;
        qp->ub[i] = (k->ub - x) / k->scale;
        for (uint32_t j = 0; j < n; j++) {
            qp->H[i * KC_COEF_MAX + j] *= k->scale * est->terms->coef[est->idx[j]].scale;
        }
    }
    for (uint32_t i = 0; i < n; i++) { est->pivot[i] = qp->H[i * KC_COEF_MAX + i]; }
}

/* Marquardt: the diagonal grows by lambda of its undamped value. */
kc_est_step_t kc_est_try(kc_est_t *est)
{
    kc_est_job_t *job = &est->job;
    if (job->tries >= TRIES_MAX || job->lambda >= DAMP_MAX) { return KC_EST_STEP_NONE; }
    for (uint32_t i = 0; i < est->n_idx; i++) {
        est->qp.H[i * KC_COEF_MAX + i] = est->pivot[i] * (1.0 + job->lambda);
        est->qp.x[i] = 0.0;
    }
    kc_qp_begin(&est->qp); /* its x is feasible whatever it answers; the cost decides */
    return KC_EST_STEP_AGAIN;
}

/* Kept inside the box against rounding. largest: step over scale. */
void kc_est_trial(kc_est_t *est)
{
    double largest = 0.0;
    for (uint32_t c = 0; c < est->terms->n_coef; c++) { est->trial[c] = est->coef[c]; }
    for (uint32_t i = 0; i < est->n_idx; i++) {
        const uint32_t c = est->idx[i];
        const kc_coef_t *k = &est->terms->coef[c];
        est->trial[c] = kc_clamp(est->coef[c] + est->qp.x[i] * k->scale, k->lb, k->ub);
        largest = kc_max(largest, kc_fabs(est->qp.x[i]));
    }
    est->job.largest = largest;
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

kc_est_step_t kc_est_compare(kc_est_t *est, double trial_cost)
{
    kc_est_job_t *job = &est->job;
    const bool small = job->largest < est->opt.tol_step;
    job->fresh = trial_cost <= job->cost;
    if (job->fresh) {
        for (uint32_t c = 0; c < est->terms->n_coef; c++) { est->coef[c] = est->trial[c]; }
        job->cost = trial_cost;
        job->lambda *= DAMP_DOWN;
        return small ? KC_EST_STEP_LAST : KC_EST_STEP_TAKEN;
    }
    /* at the minimum the sum's rounding is larger than what is left to gain */
    if (small || predicted_fall(&est->qp) < ROUNDING * job->cost) { return KC_EST_STEP_LAST; }
    job->lambda *= DAMP_UP;
    job->tries++;
    return KC_EST_STEP_AGAIN;
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
