#include "given_tables.h"

#include <math.h>
#include <string.h>

#include "kc_acquire.h"
#include "kc_crc.h"

#define PI 3.14159265358979323846

static const struct {
    double a, alpha, d, lo, hi, mass, com[3], gear;
} s_wam[7] = {
    {0.0, -PI / 2, 0.0, -2.6, 2.6, 10.7677, {-.00443, .12189, -.00066}, 42.0},
    {0.0, PI / 2, 0.0, -2.0, 2.0, 3.8749, {-.00237, .03106, .01542}, 28.25},
    {.045, -PI / 2, .55, -2.8, 2.8, 1.8023, {-.03826, .20751, .00003}, 28.25},
    {-.045, PI / 2, 0.0, -0.9, 3.1, 2.1727, {.00553, .00007, .11928}, 18.0},
    {0.0, -PI / 2, .30, -4.76, 1.24, .35656, {.00005, .02886, .00148}, 9.48},
    {0.0, PI / 2, 0.0, -1.6, 1.6, .40916, {-.00006, -.01686, .02419}, 9.48},
    {0.0, 0.0, .06, -3.0, 3.0, .07548, {.00015, .00007, -.00335}, 14.93},
};

void given_arm(kc_arm_t *a)
{
    memset(a, 0, sizeof *a);
    memcpy(a->name, "WAM7", 5u);
    a->n_joints = 7u;
    for (uint32_t j = 0u; j < 7u; j++) {
        kc_joint_t *k = &a->joint[j];
        k->type = KC_REVOLUTE;
        k->has_mass = 1u;
        k->alpha_rad = s_wam[j].alpha;
        k->a_m = s_wam[j].a;
        k->d_m = s_wam[j].d;
        k->q_min = s_wam[j].lo;
        k->q_max = s_wam[j].hi;
        k->speed_max = 0.8;
        k->mass_kg = s_wam[j].mass;
        memcpy(k->com_m, s_wam[j].com, sizeof k->com_m);
        k->gear_ratio = s_wam[j].gear;
    }
    a->base_xyz_m[2] = 0.346;
    a->base_quat_wxyz[0] = 1.0;
    a->tool_xyz_m[2] = 0.10;
    a->tool_quat_wxyz[0] = 1.0;
    a->gravity_m_s2[2] = -9.81;
}

void given_camera(kc_camera_t *c)
{
    memset(c, 0, sizeof *c);
    c->mast_xyz_m[0] = -0.35;
    c->mast_xyz_m[1] = 0.45;
    c->mast_xyz_m[2] = 1.25;
    c->mast_quat_wxyz[0] = 1.0;
    c->pantilt_xyz_m[0] = 0.05;
    c->pantilt_xyz_m[2] = 0.03;
    c->pantilt_quat_wxyz[0] = 0.5;
    c->pantilt_quat_wxyz[1] = -0.5;
    c->pantilt_quat_wxyz[2] = 0.5;
    c->pantilt_quat_wxyz[3] = -0.5;
    c->pan_min_rad = -1.6;
    c->pan_max_rad = 1.6;
    c->tilt_min_rad = -0.6;
    c->tilt_max_rad = 1.4;
    c->fx_px = 1397.0;
    c->fy_px = 1397.0;
    c->cx_px = 959.5;
    c->cy_px = 539.5;
    c->width_px = 1920u;
    c->height_px = 1080u;
    c->n_tags = 2u;
    for (uint32_t i = 0u; i < 2u; i++) {
        double half = (i == 0u ? -12.5 : 12.5) * PI / 180.0; /* Ry of -25 and +25 degrees */
        c->tag[i].id = (int32_t)i;
        c->tag[i].size_m = 0.06;
        c->tag[i].xyz_m[0] = i == 0u ? 0.075 : -0.075;
        c->tag[i].xyz_m[2] = -0.06;
        c->tag[i].quat_wxyz[0] = cos(half);
        c->tag[i].quat_wxyz[2] = sin(half);
    }
}

void given_terms(kc_terms_t *t)
{
    static const double bound[4] = {1.5, 1.5, 0.3, 0.3};
    memset(t, 0, sizeof *t);
    (void)kc_terms_add_dh(t, 7u, bound);
}

void given_kin(kc_kin_t *k)
{
    memset(k, 0, sizeof *k);
    k->n_coef = 28u;
}

void given_kernel(kc_kernel_t *k)
{
    memset(k, 0, sizeof *k);
    k->arg = KC_KERNEL_SO3;
    k->n_hyper = 2u;
    k->sigma_eps = 0.05;
    for (uint32_t i = 0u; i < 2u; i++) {
        kc_hyper_t *h = &k->hyper[i];
        double sum = 0.0;
        h->sigma_s = 1.0;
        h->beta_m = 0.3 + 0.2 * (double)i;
        h->kappa = 0.7;
        h->n_w = 21u;
        h->trunc_err = 1e-9;
        /* heat kernel of SO(3): even degrees only, k(0) = 1 */
        for (uint32_t n = 0u; n < h->n_w; n += 2u) {
            h->w[n] = (double)(n + 1u) * exp(-h->kappa * h->kappa * (double)(n * (n + 2u)) / 2.0);
            sum += h->w[n] * (double)(n + 1u);
        }
        for (uint32_t n = 0u; n < h->n_w; n++) { h->w[n] /= sum; }
    }
}

void given_config(kc_config_t *c)
{
    memset(c, 0, sizeof *c);
    c->acquisition = KC_ACQ_UCB;
    c->n_poses = 6u;
    c->beta_scale = 0.1;
    c->a1 = 0.5;
    c->sp_floor_m = 1e-3;
    c->sq_floor_rad = 2e-3;
    c->vopt_len_m = 0.3;
    c->frames_per_meas = 3u;
    c->frame_retries = 2u;
    c->settle_us = 300000u;
    c->frame_timeout_us = 2000000u;
    c->move_timeout_us = 60000000u;
    c->frame_age_max_us = 1000000u;
    c->search_steps = 8u;
    c->search_step_rad = 0.25;
    c->jump_pos_m = 0.02;
    c->jump_rot_rad = 0.1;
    c->sigma_pos_max_m = 0.02;
    c->sigma_rot_max_rad = 0.1;
    c->sigma_pos_min_m = 2e-4;
    c->sigma_rot_min_rad = 1e-3;
    c->rms_max_px = 3.0;
    c->servo.gain = 0.8;
    c->servo.damping = 0.02;
    c->servo.step_max = 0.4;
    c->servo.bound = 1.5;
    c->servo.tol_pos_m = 0.01;
    c->servo.tol_rot_rad = 0.05;
    c->servo.margin = 0.02;
    c->servo_steps_max = 15u;
    c->speed_scale = 1.0;
    c->arrive_tol = 1e-3;
    c->est.free_mask = (1ull << 28u) - 1ull;
    c->est.iter_max = 40u;
    c->est.tol_step = 1e-9;
    c->est.rank_tol = 1e-6;
    c->est.outlier_p = 0.01;
    c->est.outlier_max = 3u;
    c->est.use_prior = 0u;
    c->accept_change_max_pos_m = 0.005;
    c->accept_sigma_max_pos_m = 0.002;
    c->accept_p_fit_min = 0.01;
    c->no_change_p = 0.05;
    c->flip_rms_ratio = 2.0;
    c->flip_trust_rad = 0.5;
    c->frame_shared = 0.25;
    c->search_safety = 2.0;
    c->poses_min = 3u;
    c->tags_tried_min = 6u;
    c->second_start_noise_scale = 2.0;
    c->mismatch_noise_scale = 3.5;
    c->mismatch_dof_min = 12u;
    c->mismatch_outliers_min = 3u;
    c->poor_noise_scale = 3.0;
    c->poor_noise_scale_unlikely = 2.0;
    c->poor_p_fit = 1e-9;
    c->store_retries = 2u;
    c->store_retry_us = 1000000u;
    c->approval_timeout_us = 600000000u;
    c->signed_age_max_us = 3600000000u;
    c->initial_design = KC_INITIAL_TABLE;
    c->local_safe_m = 0.02;
    c->leave_safe_m = 0.06;
    c->doubt_p = 0.01;
    c->outside_factor = 2.0;
    c->power_min = 0.9;
    c->rate_measure = KC_ACQ_DOPT;
    c->frame_s = 0.3;
    c->extra_obs_max = 0u;
    c->extra_pos_m = 0.02;
    c->extra_rot_rad = 0.05;
    c->stops_max = 0u;
    c->rest_part = 0.01;
}

/* Joints spread over the middle of the limits by a low-discrepancy sequence. */
static double spread(uint32_t k, uint32_t j)
{
    static const double step[KC_JOINT_MAX] = {.7548777, .5698403, .4301597, .3247180,
                                              .2451223, .1850374, .1396808, .1054408};
    double x = 0.5 + (double)(k + 1u) * step[j];
    return x - floor(x);
}

/* A wrist and a tool, a ground far below and a box far away. */
static void given_bodies(kc_space_t *s)
{
    s->n_body = 2u;
    s->body[0] = (kc_body_t){7u, {0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.03f}, 0.03f, 0u};
    s->body[1] = (kc_body_t){0u, {0.1f, 0.0f, 0.0f}, {-0.1f, 0.0f, 0.0f}, 0.01f, 0u};
    s->n_volume = 2u;
    s->volume[0] = (kc_volume_t){KC_VOL_BELOW, {0.0f, 0.0f, -5.0f}, {0.0f, 0.0f, 0.0f}, 0.0f, 1u};
    s->volume[1] = (kc_volume_t){KC_VOL_BOX, {0.0f, 0.0f, -4.0f}, {1.0f, 1.0f, 0.1f}, 0.0f, 0u};
}

void given_space(kc_space_t *s, uint32_t n_cand, uint32_t arm_crc)
{
    kc_arm_t arm;
    given_arm(&arm);
    memset(s, 0, sizeof *s);
    given_bodies(s);
    s->n_cand = n_cand;
    s->n_hub = 2u;
    s->n_joints = 7u;
    s->n_initial = n_cand < 3u ? n_cand : 3u;
    for (uint32_t k = 0u; k < s->n_initial; k++) { s->initial[k] = (uint16_t)k; }
    s->hub_q[1][0] = 0.5f;
    s->hub_q[1][3] = 1.0f;
    s->hub_edge[0] = 2u;
    s->hub_edge[1] = 1u;
    for (uint32_t j = 0u; j < s->n_joints; j++) {
        s->servo_bound[j] = 1.5f;
        s->verified[j] = (kc_dh_bound_t){1.5, 1.5, 0.3, 0.3}; /* as given_terms */
    }
    s->arm_crc = arm_crc;
    for (uint32_t i = 0u; i < n_cand; i++) {
        kc_cand_t *c = &s->cand[i];
        kc_pose_t T;
        double q[KC_JOINT_MAX], quat[4];
        for (uint32_t j = 0u; j < 7u; j++) {
            double mid = 0.5 * (arm.joint[j].q_min + arm.joint[j].q_max);
            double half = 0.5 * (arm.joint[j].q_max - arm.joint[j].q_min);
            c->q_seed[j] = (float)(mid + 0.4 * half * (2.0 * spread(i, j) - 1.0));
            q[j] = (double)c->q_seed[j];
        }
        kc_arm_fk(&arm, q, &T);
        kc_R_to_quat(T.R, quat);
        for (uint32_t k = 0u; k < 3u; k++) { c->p_m[k] = (float)T.p_m[k]; }
        for (uint32_t k = 0u; k < 4u; k++) { c->q_wxyz[k] = (float)quat[k]; }
        c->tilt_rad = 0.4f;
        c->tags = 3u;
        c->hub = (uint8_t)(i & 1u);
    }
    for (uint32_t i = 2u; i < n_cand; i++) {
        uint32_t bit = i * (i - 1u) / 2u + (i - 2u);
        s->edge[bit / 8u] = (uint8_t)(s->edge[bit / 8u] | (1u << (bit % 8u)));
    }
}

void given_chain(kc_space_t *s, uint32_t n)
{
    given_space(s, n, 1u);
    memset(s->edge, 0, sizeof s->edge);
    s->n_hub = n;
    for (uint32_t h = 0u; h < n; h++) {
        s->hub_edge[h] = (uint16_t)((h > 0u ? 1u << (h - 1u) : 0u) | (h + 1u < n ? 1u << (h + 1u) : 0u));
        s->cand[h].hub = (uint8_t)h;
    }
}

uint32_t given_image(uint16_t kind, const void *table, uint8_t *image)
{
    uint32_t n = 0u;
    (void)kc_tbl_encode(kind, table, 0u, image, KC_IMAGE_MAX, &n);
    return n;
}

static void put_u32(uint8_t *b, uint32_t v)
{
    for (uint32_t i = 0u; i < 4u; i++) { b[i] = (uint8_t)(v >> (8u * i)); }
}

void given_resealed(uint8_t *image, uint32_t n)
{
    put_u32(&image[8], n - KC_TBL_HDR_BYTES);
    put_u32(&image[12], kc_crc32(0u, &image[KC_TBL_HDR_BYTES], n - KC_TBL_HDR_BYTES));
}

int event_at(const kc_events_t *q, uint16_t id)
{
    int at = -1;
    for (uint32_t i = 0u; i < q->n; i++) {
        if (q->e[i].id != id) { continue; }
        if (at >= 0) { return -1; }
        at = (int)i;
    }
    return at;
}
