#include "given_observations.h"

#include <string.h>

#include "kc_rng.h"

double given_noise(uint64_t *rng)
{
    double s = -6.0;
    for (int i = 0; i < 12; i++) { s += kc_rng_uniform(rng); }
    return s;
}

void given_joints(const kc_arm_t *arm, uint64_t *rng, double *q)
{
    for (uint32_t j = 0u; j < arm->n_joints; j++) {
        const kc_joint_t *k = &arm->joint[j];
        q[j] = k->q_min + (k->q_max - k->q_min) * kc_rng_uniform(rng);
    }
}

void given_one_observation(const kc_arm_t *arm, const kc_terms_t *terms, const double *truth, const double *q,
                           double noise, uint64_t *rng, kc_obs_t *obs)
{
    static kc_eval_t ev;
    kc_loads_t loads;
    double w[3];
    double E[9];
    kc_pose_t turned;
    memset(obs, 0, sizeof *obs);
    memcpy(obs->ctx.q, q, arm->n_joints * sizeof *q);
    memcpy(obs->ctx.g_m_s2, arm->gravity_m_s2, sizeof obs->ctx.g_m_s2);
    kc_model_loads(arm, terms, truth, &obs->ctx, &loads);
    kc_model_eval(arm, terms, truth, &obs->ctx, &loads, false, &ev);
    for (int i = 0; i < 3; i++) {
        obs->p_m[i] = ev.T.p_m[i] + noise * OBS_POS_M * given_noise(rng);
        w[i] = noise * OBS_ROT_RAD * given_noise(rng);
        obs->cov[7 * i] = OBS_POS_M * OBS_POS_M;
        obs->cov[7 * (i + 3)] = OBS_ROT_RAD * OBS_ROT_RAD;
    }
    kc_R_exp(w, E);
    kc_pose_t noise_pose = {{0.0, 0.0, 0.0}, {E[0], E[1], E[2], E[3], E[4], E[5], E[6], E[7], E[8]}};
    kc_pose_mul(&noise_pose, &ev.T, &turned);
    kc_R_to_quat(turned.R, obs->q_wxyz);
    obs->has_rot = 1u;
}

void given_paper_errors(double truth[KC_COEF_MAX])
{
    memset(truth, 0, KC_COEF_MAX * sizeof *truth);
    truth[4 * 6 + 0] = 1.3;  /* phi 7   */
    truth[4 * 1 + 1] = 0.4;  /* alpha 2 */
    truth[4 * 2 + 2] = 0.01; /* a 3     */
    truth[4 * 2 + 3] = 0.15; /* d 3     */
}

void given_session(kc_est_t *est, const kc_arm_t *arm, const kc_terms_t *terms, const double *truth,
                   uint32_t n, double noise)
{
    static kc_obs_t obs;
    double q[KC_JOINT_MAX];
    uint64_t rng = 7u;
    memset(est, 0, sizeof *est);
    est->arm = arm;
    est->terms = terms;
    est->opt.free_mask = ~(uint64_t)0u;
    est->opt.iter_max = 50u;
    est->opt.tol_step = 1e-7;
    est->opt.rank_tol = 1e-4;
    est->opt.outlier_p = 0.001;
    est->opt.outlier_max = 4u;
    for (uint32_t i = 0u; i < n; i++) {
        given_joints(arm, &rng, q);
        given_one_observation(arm, terms, truth, q, noise, &rng, &obs);
        (void)kc_est_add(est, &obs);
    }
}
