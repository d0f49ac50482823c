#include "kc_consider.h"

#include <string.h>

#include "kc_la.h"
#include "kc_vec.h"

#define N KC_CHAIN_COUNT

void kc_consider_begin(kc_consider_t *c) { memset(c, 0, sizeof *c); }

uint64_t kc_consider_add_cost(const kc_est_t *est) { return 40000u + 900u * est->terms->n_coef; }

void kc_consider_add(kc_consider_t *c, const kc_est_t *est, const kc_consider_pose_t *pose)
{
    double h[N][6], col[6];
    for (uint32_t k = 0u; k < N; k++) {
        kc_la_whiten_apply(pose->W, pose->H[k], h[k]);
        c->b_before[k] += kc_v_dot(h[k], pose->before, 6u);
        c->b[k] += kc_v_dot(h[k], pose->after, 6u);
        for (uint32_t j = 0u; j <= k; j++) { c->HH[k * N + j] += kc_v_dot(h[k], h[j], 6u); }
    }
    for (uint32_t i = 0u; i < est->terms->n_coef; i++) {
        kc_la_whiten_apply(pose->W, pose->eval->J[i], col);
        for (uint32_t k = 0u; k < N; k++) { c->S[i * N + k] += kc_v_dot(col, h[k], 6u); }
        c->JJ[i] += kc_v_dot(col, col, 6u);
    }
}

/* A column of J'H becomes one of S; A, lower triangle, loses what the estimate takes. */
static void gain(kc_consider_t *c, const kc_est_t *est, uint32_t k)
{
    const uint32_t n = est->terms->n_coef;
    double s[KC_COEF_MAX];
    kc_la_mul(est->cov, n, KC_COEF_MAX, &c->S[k], 1u, N, s);
    /* columns after k are still those of J'H */
    for (uint32_t j = k; j < N; j++) {
        double both = 0.0;
        for (uint32_t i = 0u; i < n; i++) { both += s[i] * c->S[i * N + j]; }
        c->A[j * N + k] = c->HH[j * N + k] - both;
    }
    for (uint32_t i = 0u; i < n; i++) { c->S[i * N + k] = s[i]; }
}

/* M, lower triangle of a positive semidefinite matrix but for rounding, becomes the factor of I + M, and b is
 * solved by it. Where a table makes M too large for its digits, nothing is explained: the fit is then as unlikely as
 * with an exact camera. */
static void factor(double *M, double *b)
{
    for (uint32_t k = 0u; k < N; k++) { M[k * (N + 1u)] += 1.0; }
    if (kc_la_chol(M, N, N) == KC_OK) {
        kc_la_solve_lower(M, N, N, b);
        return;
    }
    memset(b, 0, N * sizeof *b);
    memset(M, 0, (size_t)N * N * sizeof *M);
    for (uint32_t k = 0u; k < N; k++) { M[k * (N + 1u)] = 1.0; }
}

void kc_consider_scale(kc_consider_t *c, double noise_scale)
{
    const double weight = 1.0 / (noise_scale * noise_scale);
    for (uint32_t k = 0u; k < N * N; k++) { c->L[k] = weight * c->A[k]; }
    for (uint32_t k = 0u; k < N; k++) { c->b_after[k] = weight * c->b[k]; }
    factor(c->L, c->b_after);
}

void kc_consider_visible(kc_consider_t *c, const kc_est_t *est, uint32_t n)
{
    double b[N] = {0};
    memcpy(c->L, c->HH, sizeof c->L); /* not in use yet */
    factor(c->L, b);
    for (uint32_t i = 0u; i < est->terms->n_coef; i++) {
        memcpy(b, &c->S[i * N], sizeof b);
        kc_la_solve_lower(c->L, n, N, b);
        c->visible[i] = c->JJ[i] - kc_v_dot(b, b, n);
    }
}

void kc_consider_end(kc_consider_t *c, const kc_est_t *est)
{
    for (uint32_t k = 0u; k < N; k++) { gain(c, est, k); }
    factor(c->HH, c->b_before);
    kc_consider_scale(c, 1.0);
}

double kc_consider_explains_before(const kc_consider_t *c, uint32_t n)
{
    return kc_v_dot(c->b_before, c->b_before, n);
}

double kc_consider_explains_after(const kc_consider_t *c, uint32_t n)
{
    return kc_v_dot(c->b_after, c->b_after, n);
}

double kc_consider_cov(const kc_consider_t *c, uint32_t i, uint32_t j)
{
    double s = 0.0;
    for (uint32_t k = 0u; k < N; k++) { s += c->S[i * N + k] * c->S[j * N + k]; }
    return s;
}

uint64_t kc_consider_pose_cost(const kc_est_t *est) { return 40000u + 1200u * est->terms->n_coef; }

void kc_consider_motion(const kc_consider_t *c, const kc_est_t *est, const kc_eval_t *eval, double (*seen)[6],
                        double move[6][KC_CHAIN_COUNT])
{
    double v[N][6];
    for (uint32_t k = 0u; k < N; k++) {
        /* the tags' errors do not move what else the camera sees */
        const bool moves = seen != NULL && k >= KC_CHAIN_DRIFT;
        for (uint32_t a = 0u; a < 6u; a++) { v[k][a] = moves ? -seen[k][a] : 0.0; }
    }
    kc_la_add_mul_t(c->S, est->terms->n_coef, N, &eval->J[0][0], &v[0][0]);
    for (uint32_t a = 0u; a < 6u; a++) {
        for (uint32_t k = 0u; k < N; k++) { move[a][k] = v[k][a]; }
    }
    for (uint32_t a = 0u; a < 6u; a++) { kc_la_solve_lower(c->L, N, N, move[a]); }
}

void kc_consider_pose(const kc_consider_t *c, const kc_est_t *est, const kc_eval_t *eval, double (*seen)[6],
                      double *pos2, double *rot2)
{
    double move[6][N], var[6];
    kc_consider_motion(c, est, eval, seen, move);
    for (uint32_t a = 0u; a < 6u; a++) {
        double mean = 0.0;
        for (uint32_t k = 0u; k < N; k++) { mean += move[a][k] * c->b_after[k]; }
        var[a] = mean * mean + kc_v_dot(move[a], move[a], N);
    }
    *pos2 = var[0] + var[1] + var[2];
    *rot2 = var[3] + var[4] + var[5];
}
