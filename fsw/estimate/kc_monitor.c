#include "kc_chi2.h"
#include "kc_monitor.h"

#include <string.h>

#include "kc_estimate.h"
#include "kc_la.h"
#include "kc_libm.h"
#include "kc_vec.h"

#define ITER_MAX 5u     /* Gauss-Newton in one unknown                           */
#define BIAS_MAX 1.6    /* [rad or m]; a larger error is not a joint bias        */
#define STEP_SMALL 1e-9 /* [rad or m]                                            */

/* One joint, one onset. */
typedef struct {
    double bias, gain, rest, info, var; /* gain: chi-square it takes away; var: of the whitened gradient */
} fit_t;

void kc_monitor_init(kc_monitor_t *m, const kc_arm_t *arm, double floor_pos_m, double floor_rot_rad)
{
    memset(m, 0, sizeof *m);
    m->n_joints = arm->n_joints;
    for (uint32_t j = 0u; j < arm->n_joints; j++) {
        if (arm->joint[j].type == KC_PRISMATIC) { m->prismatic |= 1u << j; }
    }
    for (uint32_t i = 0u; i < 6u; i++) {
        double floor = i < 3u ? floor_pos_m : floor_rot_rad;
        m->floor2[i] = floor * floor;
    }
}

kc_status_t kc_monitor_add(kc_monitor_t *m, const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                           const kc_obs_t *obs, kc_eval_t *work)
{
    kc_loads_t loads;
    double cov[36], W[36], r[6];
    if (!obs->has_rot) { return KC_ERR_ARG; }
    memcpy(cov, obs->cov, sizeof cov);
    for (uint32_t i = 0u; i < 6u; i++) { cov[7u * i] = kc_max(cov[7u * i], m->floor2[i]); }
    if (kc_la_whiten(cov, 6u, W) != KC_OK) { return KC_ERR_NUM; }
    kc_model_needed_loads(arm, terms, coef, &obs->ctx, &loads);
    (void)kc_model_residual(arm, terms, coef, obs, &loads, r, work);
    if (!kc_v_finite(r, 6u)) { return KC_ERR_NUM; }
    kc_mon_obs_t *k = &m->obs[m->next];
    memcpy(k->r, r, sizeof k->r);
    memcpy(k->W, W, sizeof k->W);
    memcpy(k->Jq, work->Jq, sizeof k->Jq);
    m->next = (m->next + 1u) % KC_MON_OBS_MAX;
    if (m->n < KC_MON_OBS_MAX) { m->n++; }
    return KC_OK;
}

const kc_mon_obs_t *kc_monitor_back(const kc_monitor_t *m, uint32_t i)
{
    return &m->obs[(m->next + KC_MON_OBS_MAX - 1u - i) % KC_MON_OBS_MAX];
}

/* Residual of observation k if joint j stands `bias` beyond its reading, and its derivative with respect
 * to the bias (a = - d r / d bias). A turn by b about axis z through o moves the tool p by sin b z x (p -
 * o) + (1 - cos b) z x (z x (p - o)); the row holds z x (p - o) and z. */
static void shifted(const kc_monitor_t *m, const kc_mon_obs_t *k, uint32_t j, double bias, double r[6],
                    double a[6])
{
    const double *c = k->Jq[j], *z = c + 3;
    memcpy(r, k->r, 6u * sizeof(double));
    memcpy(a, c, 6u * sizeof(double));
    if ((m->prismatic >> j & 1u) != 0u) {
        kc_v3_add_scaled(r, -bias, c, r);
        return;
    }
    double zc[3], w[3], turn[9], measured[9], left[9], s = kc_sin(bias), h = kc_sin(0.5 * bias);
    kc_v3_cross(z, c, zc);
    for (uint32_t i = 0u; i < 3u; i++) {
        r[i] -= s * c[i] + 2.0 * h * h * zc[i];
        a[i] = kc_cos(bias) * c[i] + s * zc[i];
        w[i] = -bias * z[i];
    }
    kc_R_exp(w, turn);
    kc_R_exp(k->r + 3, measured);
    kc_m3_mul(measured, turn, left);
    kc_R_log(left, r + 3);
}

/* Sums over the newest n observations at this bias: chi-square, gradient, information and its variance. Of
 * the gradient's variance (= information, if observations are independent) the floor's part adds up as
 * amplitudes. */
static double sums(const kc_monitor_t *m, uint32_t n, uint32_t j, fit_t *f)
{
    double grad = 0.0, shared = 0.0, shared2 = 0.0;
    f->rest = 0.0;
    f->info = 0.0;
    for (uint32_t i = 0u; i < n; i++) {
        const kc_mon_obs_t *k = kc_monitor_back(m, i);
        double r[6], a[6], s2 = 0.0;
        shifted(m, k, j, f->bias, r, a);
        kc_la_whiten_apply(k->W, r, r);
        kc_la_whiten_apply(k->W, a, a);
        for (uint32_t c = 0u; c < 6u; c++) {
            double u = 0.0; /* W' W a: how this component of an error pulls */
            for (uint32_t b = c; b < 6u; b++) { u += k->W[6u * b + c] * a[b]; }
            s2 += u * u * m->floor2[c];
            f->rest += r[c] * r[c];
            f->info += a[c] * a[c];
            grad += a[c] * r[c];
        }
        shared += kc_sqrt(s2);
        shared2 += s2;
    }
    f->var = f->info + shared * shared - shared2;
    return grad;
}

/* Best bias of joint j for the newest n observations. */
static void fit(const kc_monitor_t *m, uint32_t n, uint32_t j, fit_t *f)
{
    memset(f, 0, sizeof *f);
    double grad = sums(m, n, j, f), before = f->rest;
    for (uint32_t i = 0u; i < ITER_MAX && f->info > 0.0; i++) {
        double old = f->bias;
        f->bias = kc_clamp(old + grad / f->info, -BIAS_MAX, BIAS_MAX);
        grad = sums(m, n, j, f);
        if (kc_fabs(f->bias - old) < STEP_SMALL) { break; }
    }
    f->gain = before - f->rest;
}

static double wald(const fit_t *f)
{
    return f->info > 0.0 ? f->bias * f->bias * f->info * f->info / f->var : 0.0;
}

/* Joints that explain the newest n observations about as well as joint j, whose fit is `best`. */
static uint32_t ties(const kc_monitor_t *m, uint32_t n, uint32_t j, const fit_t *best)
{
    uint32_t mask = 1u << j;
    for (uint32_t i = 0u; i < m->n_joints; i++) {
        fit_t f;
        if (i == j) { continue; }
        fit(m, n, i, &f);
        if ((f.rest - best->rest) * best->info / best->var <= KC_MON_TIE) { mask |= 1u << i; }
    }
    return mask;
}

/* The best of all joints and onsets that are significant and leave noise. */
static bool name(const kc_monitor_t *m, kc_mon_verdict_t *v)
{
    const double n_hyp = (double)m->n_joints * (double)(KC_MON_OBS_MAX - KC_MON_OBS_MIN + 1u);
    fit_t best = {0};
    for (uint32_t n = KC_MON_OBS_MIN; n <= m->n; n++) {
        for (uint32_t j = 0u; j < m->n_joints; j++) {
            fit_t f;
            fit(m, n, j, &f);
            if (f.gain <= best.gain || n_hyp * kc_chi2_sf(wald(&f), 1u) > KC_MON_P ||
                kc_chi2_sf(f.rest, 6u * n - 1u) < KC_MON_P_REST) {
                continue;
            }
            best = f;
            v->joint = j;
            v->n_obs = n;
        }
    }
    if (v->n_obs == 0u) { return false; }
    v->bias = best.bias;
    v->sigma = kc_sqrt(best.var) / best.info;
    v->stat = wald(&best);
    v->p = n_hyp * kc_chi2_sf(v->stat, 1u);
    v->rest = best.rest;
    v->p_rest = kc_chi2_sf(best.rest, 6u * v->n_obs - 1u);
    v->suspects = ties(m, v->n_obs, v->joint, &best);
    return true;
}

/* How many of the newest observations are off in a row, each by itself; *p_most: the most likely of the newest
 * KC_MON_OBS_OFF. */
static uint32_t off_in_a_row(const kc_monitor_t *m, double *p_most)
{
    *p_most = 0.0;
    for (uint32_t i = 0u; i < m->n; i++) {
        const kc_mon_obs_t *k = kc_monitor_back(m, i);
        double w[6], chi2 = 0.0;
        kc_la_whiten_apply(k->W, k->r, w);
        for (uint32_t c = 0u; c < 6u; c++) { chi2 += w[c] * w[c]; }
        double p = kc_chi2_sf(chi2, 6u);
        if (p > KC_MON_P) { return i; }
        if (i < KC_MON_OBS_OFF) { *p_most = kc_max(*p_most, p); }
    }
    return m->n;
}

/* Fits of each joint: one for each onset, and one to compare it with the joint that is named. */
uint64_t kc_monitor_evaluate_cost(const kc_monitor_t *m)
{
    const uint64_t n = m->n, observations = n * (n + 1u) / 2u + n, tests = n + 1u;
    return m->n_joints * (2500u * (ITER_MAX + 1u) * observations + 10000u * tests) + 10000u;
}

void kc_monitor_evaluate(const kc_monitor_t *m, kc_mon_verdict_t *v)
{
    memset(v, 0, sizeof *v);
    v->p = 1.0;
    if (m->n == 0u) { return; }
    double p_off;
    v->off_m = kc_v3_norm(kc_monitor_back(m, 0u)->r);
    v->off_rad = kc_v3_norm(kc_monitor_back(m, 0u)->r + 3);
    uint32_t n_off = off_in_a_row(m, &p_off);
    if (name(m, v)) {
        v->state = KC_MON_NAMED;
    } else if (n_off >= KC_MON_OBS_OFF) {
        v->state = KC_MON_UNEXPLAINED;
        v->p = p_off;
        v->n_obs = n_off;
    }
}
