#include "given_largest.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "given_tables.h"
#include "given_world.h"
#include "kc_rng.h"
#include "kc_vec.h"

#define APP (&kc_app_instance)

/* ---- the largest tables ---- */

static void largest_arm(void)
{
    kc_arm_t *a = &world.arm;
    a->joint[7] = a->joint[6];
    a->joint[7].alpha_rad = 1.0;
    a->joint[7].a_m = 0.1;
    a->joint[6].alpha_rad = 0.9;
    a->joint[6].a_m = 0.05;
    a->n_joints = KC_JOINT_MAX;
    world.truth = world.arm;
    world.truth.joint[6].phi_rad += 0.02;
    world.truth.joint[2].d_m += 0.01;
}

/* Two bases in each term, all of them gravity's and with the dearest functions. */
static void largest_terms(void)
{
    static const double bound[4] = {1.5, 1.5, 0.3, 0.3};
    static const uint8_t fn[4] = {KC_FN_SIN, KC_FN_COS, KC_FN_TANH, KC_FN_EXPN};
    kc_terms_t *t = &world.terms;
    memset(t, 0, sizeof *t);
    (void)kc_terms_add_dh(t, KC_JOINT_MAX, bound);
    for (; t->n_coef < KC_COEF_MAX; t->n_coef++) {
        kc_coef_t *k = &t->coef[t->n_coef];
        (void)snprintf(k->name, sizeof k->name, "k%u", (unsigned)t->n_coef);
        *k = (kc_coef_t){.lb = -0.7, .ub = 0.7, .scale = 0.02, .prior_sigma = 1.0, .enabled = 1u};
        (void)snprintf(k->name, sizeof k->name, "k%u", (unsigned)t->n_coef);
    }
    for (; t->n_term < KC_TERM_MAX; t->n_term++) {
        uint32_t k = t->n_term, link = k % KC_JOINT_MAX;
        t->term[k] = (kc_term_t){
            .coef = (uint16_t)(32u + k % 32u),
            .frame = (uint8_t)(k % 3u == 0u ? KC_FRAME_CAMERA : 1u + link),
            .comp = (uint8_t)(k / 8u % 6u),
            .gain = 1.0,
            .basis = {{fn[k % 4u], (uint8_t)(k % 2u ? KC_VAR_TAU : KC_VAR_LEVX), 0u, 0.1 * k, 0.3 + 0.01 * k},
                      {fn[k / 4u % 4u], KC_VAR_Q, (uint8_t)(1u + (k + 3u) % KC_JOINT_MAX), 0.0,
                       1.0 + 0.02 * k}},
        };
        t->term[k].basis[0].index = (uint8_t)(k % 2u ? 1u + link : KC_LEVER_INDEX(link, KC_LEVER_TOOL));
    }
}

static void largest_kernel(void)
{
    kc_kernel_t *k = &world.kernel;
    k->n_hyper = KC_HYPER_MAX;
    k->choose = 1u;
    for (uint32_t i = 0u; i < k->n_hyper; i++) {
        kc_hyper_t *h = &k->hyper[i];
        *h =
            (kc_hyper_t){.sigma_s = 0.2 + 0.1 * i, .beta_m = 0.2 + 0.02 * i, .kappa = 0.7, .trunc_err = 1e-9};
        h->n_w = KC_SPECTRUM_MAX - 1u;
        double sum = 0.0;
        for (uint32_t n = 0u; n < h->n_w; n += 2u) {
            h->w[n] = 1.0 / (1.0 + (double)(n * n));
            sum += h->w[n] * (double)(n + 1u);
        }
        for (uint32_t n = 0u; n < h->n_w; n++) { h->w[n] /= sum; }
    }
}

static void largest_bodies(kc_space_t *s)
{
    s->n_body = KC_BODY_MAX;
    for (uint32_t i = 0u; i < KC_BODY_MAX; i++) {
        float x = 0.01f * (float)(i + 1u);
        s->body[i] = (kc_body_t){
            (uint8_t)(i % (KC_JOINT_MAX + 1u)), {x, 0.0f, 0.0f}, {x, 0.0f, 1e-3f}, 1e-4f, (1u << i) - 1u};
    }
    s->n_volume = KC_VOLUME_MAX;
    for (uint32_t i = 0u; i < KC_VOLUME_MAX; i++) {
        s->volume[i] =
            (kc_volume_t){KC_VOL_BOX, {0.0f, 0.0f, -5.0f - 0.3f * (float)i}, {1.0f, 1.0f, 0.1f}, 0.0f, 0u};
    }
}

static void largest_space(void)
{
    kc_space_t *s = &world.space;
    given_space(s, KC_CAND_MAX, 1u);
    s->n_joints = KC_JOINT_MAX;
    s->servo_bound[7] = 1.5f;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { s->verified[j] = (kc_dh_bound_t){6.0, 6.0, 9.0, 9.0}; }
    s->n_hub = KC_HUB_MAX;
    for (uint32_t h = 0u; h < KC_HUB_MAX; h++) {
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { s->hub_q[h][j] = 0.02f * (float)(h * (j == 0u)); }
        s->hub_edge[h] = (uint16_t)(0xFFFFu & ~(1u << h));
    }
    for (uint32_t i = 0u; i < s->n_cand; i++) {
        kc_cand_t *c = &s->cand[i];
        c->q_seed[7] = 0.001f * (float)(i % 500u);
        c->hub = (uint8_t)(i % KC_HUB_MAX);
        given_pose_of_seed(c);
    }
    memset(s->edge, 0xFF, s->n_cand * (s->n_cand - 1u) / 16u); /* every direct segment */
    largest_bodies(s);
}

void given_largest(uint8_t acq)
{
    given_world();
    largest_arm();
    largest_terms();
    largest_kernel();
    largest_space();
    world.config.acquisition = acq;
    world.config.est.free_mask = UINT64_MAX;
    world.config.est.iter_max = 2u; /* more of the same: a step computes no more for it */
    world.config.est.outlier_max = 14u;
    world.config.est.outlier_p = 0.4;
    world.config.est.use_prior = 1u;
    world.config.poor_noise_scale = 1000.0;
    world.config.poor_noise_scale_unlikely = 1000.0;
    world.config.poor_p_fit = 0.0;
    world.config.no_change_p = 1e-12;
    world.config.servo_steps_max = 0u;
}

/* ---- poses measured before ---- */

void given_observation(uint32_t i, kc_obs_t *o)
{
    kc_pose_t T, C;
    memset(o, 0, sizeof *o);
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { o->ctx.q[j] = (double)world.space.cand[i].q_seed[j]; }
    o->ctx.g_m_s2[2] = -9.81;
    o->ctx.temp_c = 20.0;
    o->ctx.range_m = 1.0;
    kc_arm_fk(&world.truth, o->ctx.q, &T);
    kc_camera_pose(&world.camera, 0.0, 0.0, &C);
    for (uint32_t k = 0u; k < 3u; k++) {
        double off = i % 5u == 0u ? 0.05 : 1e-4; /* one pose in five is an outlier */
        o->p_m[k] = T.p_m[k] + off * (2.0 * kc_rng_uniform(&world.rng) - 1.0);
        o->p_cam_m[k] = C.p_m[k];
    }
    kc_R_to_quat(T.R, o->q_wxyz);
    kc_R_to_quat(C.R, o->q_cam_wxyz);
    for (uint32_t k = 0u; k < 6u; k++) { o->cov[7u * k] = k < 3u ? 1e-8 : 4e-8; }
    o->has_rot = o->has_cam = 1u;
}

void given_poses(uint32_t n)
{
    kc_arena_calibration_t *arena = &APP->arena.calibration;
    for (uint32_t i = 1u; i <= n; i++) {
        kc_obs_t o;
        given_observation(i, &o);
        if (kc_est_add(&APP->est, &o) != KC_OK) { abort(); }
        (void)kc_gp_add(&arena->gp, &arena->cand_pt[i], -0.1 * (double)(i % 7u), arena->cand_pt);
        kc_plan_measured(&APP->plan, &world.space, i);
    }
    APP->plan.begun = UINT32_MAX; /* initial poses */
    memcpy(APP->est.coef, APP->latest.coef, sizeof APP->est.coef);
}
