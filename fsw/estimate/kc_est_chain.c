#include <string.h>

#include "kc_camera.h"
#include "kc_est_priv.h"
#include "kc_la.h"
#include "kc_vec.h"

#define N KC_CHAIN_COUNT

double kc_est_since_s(const kc_est_t *est, uint32_t i) { return est->obs[i].ctx.t_s - est->obs[0].ctx.t_s; }

void kc_est_chain_motion(const kc_est_t *est, const kc_camera_t *camera, uint32_t i, double H[N][6])
{
    const kc_obs_t *o = &est->obs[i];
    kc_pose_t seen;
    kc_pose_from_quat(o->p_m, o->q_wxyz, &seen);
    kc_camera_chain(camera, o->ctx.pan_rad, o->ctx.tilt_rad, &seen, kc_est_since_s(est, i), H);
}

/* The same, whitened; rows that are missing are zero. */
static void whitened(const kc_est_t *est, uint32_t i, double h[N][6])
{
    const kc_obs_t *o = &est->obs[i];
    double W[36];
    kc_est_chain_motion(est, est->camera, i, h);
    (void)kc_la_whiten(o->cov, (o->has_rot != 0u) ? 6u : 3u, W); /* kc_est_add has checked it */
    for (uint32_t k = 0u; k < N; k++) { kc_la_whiten_apply(W, h[k], h[k]); }
}

void kc_est_chain_add(kc_est_t *est, uint32_t i)
{
    kc_est_chain_t *chain = &est->chain;
    const uint32_t n = est->n_idx;
    double h[N][6], raw[6];
    (void)kc_est_block(est, i, raw);
    whitened(est, i, h);
    for (uint32_t k = 0u; k < N; k++) {
        chain->b[k] += kc_v_dot(h[k], &est->blk[6u * n], 6u);
        for (uint32_t j = 0u; j <= k; j++) { chain->L[k * N + j] += kc_v_dot(h[k], h[j], 6u); }
        for (uint32_t c = 0u; c < n; c++) {
            chain->U[k / 6u][6u * c + k % 6u] += kc_v_dot(h[k], &est->blk[6u * c], 6u);
        }
    }
}

/* Columns j and k of U. */
static double product(const kc_est_chain_t *chain, uint32_t n, uint32_t j, uint32_t k)
{
    double s = 0.0;
    for (uint32_t c = 0u; c < n; c++) {
        s += chain->U[j / 6u][6u * c + j % 6u] * chain->U[k / 6u][6u * c + k % 6u];
    }
    return s;
}

void kc_est_chain_end(kc_est_t *est)
{
    kc_est_chain_t *chain = &est->chain;
    const uint32_t n = est->n_idx;
    for (uint32_t g = 0u; g < N / 6u; g++) { kc_la_solve_upper_t(est->R, n, KC_EST_LD, chain->U[g]); }
    for (uint32_t k = 0u; k < N; k++) {
        for (uint32_t j = 0u; j <= k; j++) { chain->L[k * N + j] -= product(chain, n, j, k); }
        chain->L[k * (N + 1u)] += 1.0;
    }
    chain->known = kc_la_chol(chain->L, N, N) == KC_OK;
    if (chain->known) { kc_la_solve_lower(chain->L, N, N, chain->b); }
}

double kc_est_chain_explains(const kc_est_t *est)
{
    const kc_est_chain_t *chain = &est->chain;
    return chain->known ? kc_v_dot(chain->b, chain->b, N) : 0.0;
}

void kc_est_chain_correct(const kc_est_t *est, uint32_t i, const double *T, double w[6], double S[36])
{
    const kc_est_chain_t *chain = &est->chain;
    const uint32_t n = est->n_idx;
    double h[N][6], M[6][N];
    if (!chain->known) { return; }
    whitened(est, i, h);
    for (uint32_t a = 0u; a < 6u; a++) {
        for (uint32_t k = 0u; k < N; k++) {
            M[a][k] = h[k][a];
            for (uint32_t c = 0u; c < n; c++) {
                M[a][k] -= T[6u * c + a] * chain->U[k / 6u][6u * c + k % 6u];
            }
        }
        kc_la_solve_lower(chain->L, N, N, M[a]);
        w[a] -= kc_v_dot(M[a], chain->b, N);
        for (uint32_t b = 0u; b <= a; b++) { S[a * 6u + b] -= kc_v_dot(M[a], M[b], N); }
    }
}
