#include "kc_dls.h"

#include <string.h>

#include "kc_la.h"
#include "kc_libm.h"

static double weight(uint32_t row) { return row < 3u ? 1.0 : KC_DLS_LEN_M; }

double kc_dls_cost(const double e[6])
{
    double sum = 0.0;
    for (uint32_t r = 0u; r < 6u; r++) {
        double w = weight(r) * e[r];
        sum += w * w;
    }
    return sum;
}

/* e - J dq */
static void remaining(const double Jq[][6], uint32_t n, const double e[6], const double *dq, double out[6])
{
    for (uint32_t r = 0u; r < 6u; r++) {
        out[r] = e[r];
        for (uint32_t j = 0u; j < n; j++) { out[r] -= Jq[j][r] * dq[j]; }
    }
}

double kc_dls_predicted(const double Jq[][6], uint32_t n, const double e[6], const double *dq)
{
    double left[6];
    remaining(Jq, n, e, dq, left);
    return kc_dls_cost(left);
}

/* Squared weights times a, for sums of products with other columns. */
static void weigh(const double a[6], double out[6])
{
    for (uint32_t r = 0u; r < 6u; r++) { out[r] = weight(r) * weight(r) * a[r]; }
}

static double dot6(const double a[6], const double b[6])
{
    double sum = 0.0;
    for (uint32_t r = 0u; r < 6u; r++) { sum += a[r] * b[r]; }
    return sum;
}

/* Solve for the joints that are free, the others keep their dq. */
static kc_status_t solve_free(const double Jq[][6], uint32_t n, const double e[6], double damping,
                              const uint8_t *fixed, double *dq)
{
    double A[KC_JOINT_MAX * KC_JOINT_MAX];
    double b[KC_JOINT_MAX];
    double left[6];
    uint32_t idx[KC_JOINT_MAX];
    uint32_t m = 0u;
    for (uint32_t j = 0u; j < n; j++) {
        if (fixed[j]) { continue; }
        dq[j] = 0.0;
        idx[m++] = j;
    }
    if (m == 0u) { return KC_OK; }
    remaining(Jq, n, e, dq, left);
    for (uint32_t i = 0u; i < m; i++) {
        double weighed[6];
        weigh(Jq[idx[i]], weighed);
        b[i] = dot6(weighed, left);
        for (uint32_t k = 0u; k <= i; k++) {
            A[i * KC_JOINT_MAX + k] = dot6(weighed, Jq[idx[k]]) + (i == k ? damping * damping : 0.0);
        }
    }
    if (kc_la_chol(A, m, KC_JOINT_MAX) != KC_OK) { return KC_ERR_NUM; }
    kc_la_chol_solve(A, m, KC_JOINT_MAX, b);
    for (uint32_t i = 0u; i < m; i++) { dq[idx[i]] = b[i]; }
    return KC_OK;
}

/* Put the free joint that is farthest outside its box on the edge; 0 if all are inside. */
static bool fix_worst(const double *lo, const double *hi, uint32_t n, uint8_t *fixed, double *dq)
{
    uint32_t worst = n;
    double by = 0.0;
    for (uint32_t j = 0u; j < n; j++) {
        double out = kc_max(lo[j] - dq[j], dq[j] - hi[j]);
        if (!fixed[j] && out > by) {
            by = out;
            worst = j;
        }
    }
    if (worst == n) { return false; }
    dq[worst] = kc_clamp(dq[worst], lo[worst], hi[worst]);
    fixed[worst] = 1u;
    return true;
}

kc_status_t kc_dls_step(const double Jq[][6], uint32_t n, const double e[6], double damping, const double *lo,
                        const double *hi, double *dq)
{
    uint8_t fixed[KC_JOINT_MAX] = {0};
    kc_status_t st;
    memset(dq, 0, n * sizeof *dq);
    for (uint32_t pass = 0u; pass <= n; pass++) { /* every pass but the last fixes one more joint */
        st = solve_free(Jq, n, e, damping, fixed, dq);
        if (st != KC_OK || !kc_finite(kc_dls_predicted(Jq, n, e, dq))) {
            memset(dq, 0, n * sizeof *dq);
            return KC_ERR_NUM;
        }
        if (!fix_worst(lo, hi, n, fixed, dq)) { break; }
    }
    return KC_OK;
}

void kc_dls_limit(double *dq, uint32_t n, double step_max)
{
    double worst = 0.0;
    for (uint32_t j = 0u; j < n; j++) { worst = kc_max(kc_fabs(dq[j]), worst); }
    if (worst <= step_max) { return; }
    for (uint32_t j = 0u; j < n; j++) { dq[j] *= step_max / worst; }
}

void kc_dls_eval(const kc_fixed_t *fixed, const double *q, kc_eval_t *work)
{
    const kc_arm_t *arm = fixed->arm;
    kc_ctx_t ctx;
    kc_loads_t loads;
    memset(&ctx, 0, sizeof ctx);
    memcpy(ctx.q, q, arm->n_joints * sizeof *q);
    memcpy(ctx.g_m_s2, arm->gravity_m_s2, sizeof ctx.g_m_s2);
    kc_fixed_eval(fixed, &ctx, kc_fixed_needed_loads(fixed, &ctx, &loads), false, work);
}

void kc_dls_box(const kc_joint_t *j, double margin, double q, double *lo, double *hi)
{
    *lo = kc_min(j->q_min + margin - q, 0.0);
    *hi = kc_max(j->q_max - margin - q, 0.0);
}
