/* Steps of the flight core with everything at its limits: tables of the largest sizes, 62 poses of which 12 are
 * outliers, then two more that are measured, the last update, the proposal and its approval. tests/bench/wcet.py
 * runs it under valgrind, which counts the instructions of each kc_app_step.
 *
 * wcet CASE...: a line for each step in the order of the steps: case, state before, state after. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "given_tables.h"
#include "given_world.h"
#include "kc_rng.h"
#include "kc_vec.h"

#define APP (&kc_app_instance)
#define N_BEFORE (KC_MEAS_MAX - 2u)
#define STEPS_MAX 20000u

static const char *s_case;

static void tick(void)
{
    int before = (int)kc_app_state(APP);
    world_tick();
    (void)printf("%s %d %d\n", s_case, before, (int)kc_app_state(APP));
    for (uint32_t i = 0u; i < world.out.events.n && getenv("WCET_EVENTS") != NULL; i++) {
        const kc_event_t *e = &world.out.events.e[i];
        (void)fprintf(stderr, "  %s %d %g %g\n", kc_event_name(e->id), (int)e->index, e->got, e->want);
    }
}

static void ticks(uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) { tick(); }
}

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
        *k = (kc_coef_t){.lb = -1.0, .ub = 1.0, .scale = 0.02, .prior_sigma = 1.0, .enabled = 1u};
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
                      {fn[k / 4u % 4u], KC_VAR_Q, (uint8_t)(1u + (k + 3u) % KC_JOINT_MAX), 0.0, 1.0 + 0.02 * k}},
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
        *h = (kc_hyper_t){.sigma_s = 0.2 + 0.1 * i, .beta_m = 0.2 + 0.02 * i, .kappa = 0.7, .trunc_err = 1e-9};
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
        s->body[i] = (kc_body_t){(uint8_t)(i % (KC_JOINT_MAX + 1u)), {x, 0.0f, 0.0f}, {x, 0.0f, 1e-3f}, 1e-4f,
                                 (1u << i) - 1u};
    }
    s->n_volume = KC_VOLUME_MAX;
    for (uint32_t i = 0u; i < KC_VOLUME_MAX; i++) {
        s->volume[i] = (kc_volume_t){KC_VOL_BOX, {0.0f, 0.0f, -5.0f - 0.3f * (float)i}, {1.0f, 1.0f, 0.1f}, 0.0f, 0u};
    }
}

static void largest_space(void)
{
    kc_space_t *s = &world.space;
    given_space(s, KC_CAND_MAX, 1u);
    s->n_joints = KC_JOINT_MAX;
    s->servo_bound[7] = 1.5f;
    s->n_hub = KC_HUB_MAX;
    for (uint32_t h = 0u; h < KC_HUB_MAX; h++) {
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { s->hub_q[h][j] = 0.02f * (float)(h * (j == 0u)); }
        s->hub_edge[h] = (uint16_t)(0xFFFFu & ~(1u << h));
    }
    for (uint32_t i = 0u; i < s->n_cand; i++) {
        kc_cand_t *c = &s->cand[i];
        double q[KC_JOINT_MAX], quat[4];
        kc_pose_t T;
        c->q_seed[7] = 0.001f * (float)(i % 500u);
        c->hub = (uint8_t)(i % KC_HUB_MAX);
        for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { q[j] = (double)c->q_seed[j]; }
        kc_arm_fk(&world.arm, q, &T);
        kc_R_to_quat(T.R, quat);
        for (uint32_t k = 0u; k < 3u; k++) { c->p_m[k] = (float)T.p_m[k]; }
        for (uint32_t k = 0u; k < 4u; k++) { c->q_wxyz[k] = (float)quat[k]; }
    }
    memset(s->edge, 0xFF, s->n_cand * (s->n_cand - 1u) / 16u); /* every direct segment */
    largest_bodies(s);
}

static void given_largest(uint8_t acq)
{
    given_world();
    largest_arm();
    largest_terms();
    largest_kernel();
    largest_space();
    world.config.acquisition = acq;
    world.config.est.free_mask = UINT64_MAX;
    world.config.est.iter_max = acq == KC_ACQ_VOPT ? 12u : 2u; /* more of the same: a step computes no more for it */
    world.config.est.outlier_max = acq == KC_ACQ_VOPT ? 14u : 0u;
    world.config.est.outlier_p = 0.4;
    world.config.est.use_prior = 1u;
    world.config.poor_noise_scale = 1000.0;
    world.config.poor_noise_scale_unlikely = 1000.0;
    world.config.poor_p_fit = 0.0;
    world.config.no_change_p = 0.0;
    world.config.servo_steps_max = 0u;
}

/* ---- poses measured before ---- */

static void observe(uint32_t i, kc_obs_t *o)
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

static void given_poses(void)
{
    kc_arena_calibration_t *arena = &APP->arena.calibration;
    for (uint32_t i = 1u; i <= N_BEFORE; i++) {
        kc_obs_t o;
        observe(i, &o);
        if (kc_est_add(&APP->est, &o) != KC_OK) { abort(); }
        (void)kc_gp_add(&arena->gp, &arena->cand_pt[i], -0.1 * (double)(i % 7u), arena->cand_pt);
        kc_plan_measured(&APP->plan, &world.space, i);
    }
    APP->plan.i_initial = world.space.n_initial;
    memcpy(APP->est.coef, APP->learned.coef, sizeof APP->est.coef);
}

/* ---- cases ---- */

static void calibrate(uint8_t acq)
{
    static const char *name[] = {"ucb", "random", "dopt", "vopt"};
    s_case = name[acq];
    given_largest(acq);
    world_boot();
    tick();
    (void)world_cmd(KC_CMD_START, acq, (int32_t)KC_MEAS_MAX, 3);
    tick();
    given_poses();
    for (uint32_t i = 0u; i < STEPS_MAX && world_calibrating(); i++) { tick(); }
    int32_t crc = (int32_t)world.proposal.crc;
    (void)world_cmd(KC_CMD_APPROVE_ARM, crc, 0, 0);
    tick();
    (void)world_cmd(KC_CMD_APPROVE_GO, crc, 0, 0);
    ticks(2u);
    (void)fprintf(stderr, "%s: state %d, %u poses, %u outliers, rank %u of %u, GP set %u\n", s_case,
                  (int)kc_app_state(APP), (unsigned)APP->plan.n_meas, (unsigned)APP->est.n_outliers,
                  (unsigned)APP->est.rank, (unsigned)APP->est.n_free,
                  (unsigned)APP->arena.calibration.gp.hyper);
}

/* A calibration with tables as they fly: the small world of the unit tests. */
static void replay(uint8_t acq)
{
    s_case = "replay";
    given_world();
    world.truth.joint[6].phi_rad = 0.2;
    world.config.acquisition = acq;
    world.config.n_poses = 8u;
    world.kernel.choose = 1u;
    world_boot();
    tick();
    (void)world_cmd(KC_CMD_START, -1, 0, 3);
    tick();
    for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) { tick(); }
}

static void send_table(uint16_t kind, const void *table)
{
    uint32_t n = given_image(kind, table, world.image), crc = kc_tbl_image_crc(world.image, n);
    for (uint32_t at = 0u; at < n;) {
        for (uint32_t i = 0u; i < KC_CHUNK_QUEUE_MAX && at < n; i++) {
            kc_chunk_t *c = &world.in.chunk[world.in.n_chunk++];
            *c = (kc_chunk_t){.kind = kind, .total = n, .offset = at};
            c->n = n - at < KC_CHUNK_BYTES ? n - at : KC_CHUNK_BYTES;
            memcpy(c->data, &world.image[at], c->n);
            at += c->n;
        }
        tick();
    }
    for (uint32_t i = 0u; i < KC_CMD_QUEUE_MAX; i++) {
        (void)world_cmd(KC_CMD_TABLE_VALIDATE, kind, (int32_t)crc, 0);
    }
    tick();
    (void)world_cmd(KC_CMD_TABLE_ACTIVATE, kind, (int32_t)crc, 0);
    tick();
    (void)world_cmd(KC_CMD_TABLE_DUMP, kind, 0, 0);
    ticks(3u);
    (void)fprintf(stderr, "table %u: %u bytes, active crc %08x of %08x\n", (unsigned)kind, (unsigned)n,
                  (unsigned)APP->tables.active.crc[kind], (unsigned)crc);
}

/* Idle: tables, and as many detections as a step takes for the monitor. */
static void idle(void)
{
    s_case = "tables";
    given_largest(KC_ACQ_RANDOM);
    world_boot();
    tick();
    send_table(KC_TBL_CONFIG, &world.config);
    send_table(KC_TBL_KERNEL, &world.kernel);
    send_table(KC_TBL_TERMS, &world.terms);
    send_table(KC_TBL_SPACE, &world.space);
    s_case = "monitor";
    ticks(20u);
    for (uint32_t i = 0u; i < 4u; i++) {
        kc_obs_t o;
        for (uint32_t k = 0u; k < KC_DET_QUEUE_MAX; k++) {
            kc_detection_t *d = &world.in.det[k];
            memset(d, 0, sizeof *d);
            observe(1u + i, &o);
            memcpy(d->p_cam_tool_m, o.p_m, sizeof o.p_m);
            d->t_us = world.now_us + TICK_US;
            d->seq = (int32_t)(100u * i + k + 1u);
            d->n_tags = 2u;
            d->tag_id[0] = 0;
            d->tag_id[1] = 1;
            d->tag_id[2] = d->tag_id[3] = -1;
            d->q_cam_tool_wxyz[0] = d->q_alt_wxyz[0] = 1.0;
            for (uint32_t c = 0u; c < 6u; c++) { d->cov[7u * c] = 1e-8; }
            d->rms_px = d->rms_alt_px = 0.3;
            d->range_m = 1.0;
            d->u_px = 960.0;
            d->v_px = 540.0;
        }
        world.in.n_det = KC_DET_QUEUE_MAX;
        tick();
    }
    (void)fprintf(stderr, "monitor: %u observations\n", (unsigned)APP->arena.idle.monitor.n);
}

int main(int argc, char **argv)
{
    for (int i = 1; i < argc; i++) {
        const char *what = argv[i];
        if (strcmp(what, "idle") == 0) { idle(); }
        if (strcmp(what, "replay") == 0) {
            for (uint8_t acq = 0u; acq < KC_ACQ_COUNT; acq++) { replay(acq); }
        }
        if (strcmp(what, "ucb") == 0) { calibrate(KC_ACQ_UCB); }
        if (strcmp(what, "random") == 0) { calibrate(KC_ACQ_RANDOM); }
        if (strcmp(what, "dopt") == 0) { calibrate(KC_ACQ_DOPT); }
        if (strcmp(what, "vopt") == 0) { calibrate(KC_ACQ_VOPT); }
    }
    return 0;
}
