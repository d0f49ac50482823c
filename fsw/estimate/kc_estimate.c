#include "kc_estimate.h"

#include "kc_est_priv.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_vec.h"

_Static_assert(sizeof(kc_est_t) <= 176u * 1024u, "estimator memory budget");

#define UNIT_TOL 1e-6
#define BOUND_MIN 1e-6 /* of scale: bounds that meet leave no coefficient, but no division by zero either */

static bool unit_norm(const double q[4]) { return kc_fabs(kc_sqrt(kc_v_dot(q, q, 4u)) - 1.0) <= UNIT_TOL; }

static bool ctx_finite(const kc_ctx_t *c)
{
    const double one[9] = {c->temp_c, c->t_s,    c->payload_kg, c->range_m, c->incid_rad,
                           c->u_norm, c->v_norm, c->pan_rad,    c->tilt_rad};
    return kc_v_finite(c->q, KC_JOINT_MAX) && kc_v_finite(c->dir, KC_JOINT_MAX) &&
           kc_v_finite(c->qdot, KC_JOINT_MAX) && kc_v_finite(c->g_m_s2, 3u) && kc_v_finite(one, 9u) &&
           kc_v_finite(c->p_cam_tool_m, 3u);
}

static bool obs_good(const kc_obs_t *o)
{
    double W[36];
    const uint32_t m = (o->has_rot != 0u) ? 6u : 3u;
    return ctx_finite(&o->ctx) && kc_v_finite(o->p_m, 3u) && (o->has_rot == 0u || unit_norm(o->q_wxyz)) &&
           (o->has_cam == 0u || (kc_v_finite(o->p_cam_m, 3u) && unit_norm(o->q_cam_wxyz))) &&
           kc_la_whiten(o->cov, m, W) == KC_OK;
}

kc_status_t kc_est_add(kc_est_t *est, const kc_obs_t *obs)
{
    if (est->n_obs >= KC_MEAS_MAX) { return KC_ERR_FULL; }
    if (!obs_good(obs)) { return KC_ERR_ARG; }
    est->obs[est->n_obs++] = *obs;
    return KC_OK;
}

bool kc_est_options_good(const kc_est_t *est)
{
    const kc_est_opt_t *o = &est->opt;
    bool ok = est->n_obs >= 1u && est->n_obs <= KC_MEAS_MAX && est->terms->n_coef <= KC_COEF_MAX &&
              o->iter_max >= 1u && o->iter_max <= 100u && o->tol_step > 0.0 && o->rank_tol > 0.0 &&
              o->outlier_p >= 0.0;
    for (uint32_t c = 0; ok && c < est->terms->n_coef; c++) {
        const kc_coef_t *k = &est->terms->coef[c];
        ok = k->lb <= k->ub && k->scale > 0.0 && kc_finite(est->start[c]);
    }
    return ok;
}

double kc_est_bound_sigma(const kc_coef_t *coef)
{
    return kc_max(coef->ub - coef->lb, BOUND_MIN * coef->scale) / kc_sqrt(12.0);
}

uint64_t kc_est_requested(const kc_est_t *est)
{
    uint64_t mask = 0u;
    for (uint32_t c = 0; c < est->terms->n_coef; c++) {
        if (est->terms->coef[c].enabled != 0u) { mask |= (uint64_t)1u << c; }
    }
    return mask & est->opt.free_mask;
}

void kc_est_to_start(kc_est_t *est, uint64_t which, uint64_t requested)
{
    for (uint32_t c = 0; c < est->terms->n_coef; c++) {
        const kc_coef_t *k = &est->terms->coef[c];
        if (((which >> c) & 1u) == 0u) { continue; }
        const bool in = ((requested >> c) & 1u) != 0u;
        est->coef[c] = in ? kc_clamp(est->start[c], k->lb, k->ub) : est->start[c];
    }
}

void kc_est_reset(kc_est_t *est, uint64_t requested)
{
    kc_est_to_start(est, ~(uint64_t)0u, requested);
    for (uint32_t i = 0; i < KC_MEAS_MAX; i++) { est->outlier[i] = (i + 1u == est->without) ? 1u : 0u; }
    for (uint32_t c = 0; c < KC_COEF_MAX; c++) {
        est->status[c] = (uint8_t)KC_COEF_MASKED;
        est->sigma[c] = 0.0;
        est->confounded[c] = 0u;
    }
    est->n_outliers = (est->without > 0u) ? 1u : 0u;
    est->n_free = est->rank = est->iters = est->n_idx = 0u;
    est->weak = 0u;
    est->kkt = est->cond = 0.0;
    for (uint64_t b = requested; b != 0u; b &= b - 1u) { est->n_free++; }
}

uint64_t kc_est_held(const kc_est_t *est)
{
    uint64_t held = 0u;
    for (uint32_t c = 0; c < est->terms->n_coef; c++) {
        if (est->status[c] == (uint8_t)KC_COEF_HELD) { held |= (uint64_t)1u << c; }
    }
    return held;
}

double kc_est_rms(double sum2, uint32_t n) { return (n > 0u) ? kc_sqrt(sum2 / (double)n) : 0.0; }

/* Spread the n_idx x n_idx block at the top left of cov to its coefficients, from the last backwards:
 * places only move to higher rows and columns, so nothing is overwritten before it was moved. */
static void scatter_cov(kc_est_t *est)
{
    for (uint32_t i = est->n_idx; i-- > 0u;) {
        for (uint32_t j = est->n_idx; j-- > 0u;) {
            const uint32_t from = i * KC_COEF_MAX + j;
            const uint32_t to = est->idx[i] * KC_COEF_MAX + est->idx[j];
            const double v = est->cov[from];
            est->cov[from] = 0.0;
            est->cov[to] = v;
        }
        est->sigma[est->idx[i]] = kc_sqrt(est->cov[est->idx[i] * (KC_COEF_MAX + 1u)]);
    }
}

void kc_est_take_inside(kc_est_t *est)
{
    uint32_t n = 0u;
    for (uint32_t j = 0; j < est->n_idx; j++) {
        if (est->status[est->idx[j]] == (uint8_t)KC_COEF_ESTIMATED) { est->idx[n++] = est->idx[j]; }
    }
    est->n_idx = n;
}

kc_status_t kc_est_covariance(kc_est_t *est)
{
    for (uint32_t k = 0; k < KC_COEF_MAX * KC_COEF_MAX; k++) { est->cov[k] = 0.0; }
    const kc_status_t st = kc_la_upper_cov(est->R, est->n_idx, KC_EST_LD, est->cov, KC_COEF_MAX);
    scatter_cov(est);
    return st;
}

uint64_t kc_est_pose_cov_cost(const kc_est_t *est)
{
    const uint64_t n = est->n_free;
    return kc_model_cost(est->arm, est->terms, est->coef, true) + 4000u + 60u * n + 14u * n * n;
}

void kc_est_pose_cov(const kc_est_t *est, const kc_fixed_t *fixed, const kc_ctx_t *ctx, kc_eval_t *work,
                     double cov[36])
{
    kc_loads_t loads;
    uint32_t idx[KC_COEF_MAX], n = 0u;
    kc_fixed_eval(fixed, ctx, kc_fixed_needed_loads(fixed, ctx, &loads), true, work);
    for (uint32_t c = 0; c < est->terms->n_coef; c++) { /* the others have no covariance */
        if (est->status[c] != (uint8_t)KC_COEF_ESTIMATED) { continue; }
        for (uint32_t k = 0; k < 6u; k++) { work->J[n][k] = work->J[c][k]; } /* only back: n <= c */
        idx[n++] = c;
    }
    kc_la_congruence_at(est->cov, KC_COEF_MAX, idx, n, &work->J[0][0], cov);
}
