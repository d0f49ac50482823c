#include "kc_layout.h"

/* Outer limits: what can be true of any arm on a lander. The finer rules are the validate functions'. */
#define ANGLE_MAX 6.2831853071795865
#define LENGTH_MAX_M 10.0
#define JOINT_MAX 100.0
#define CHAIN_SIGMA_MAX 0.1 /* what it does to the estimate is computed to first order */
#define COEF_ABS_MAX 1e6
#define U16_MAX 0xffffu
#define U32_MAX 0xffffffffu

static void walk_joint(kc_walk_t *w, kc_joint_t *j)
{
    kc_walk_u8(w, 3u, &j->type, KC_REVOLUTE, KC_PRISMATIC); /* 0 revolute, 1 prismatic */
    kc_walk_u8(w, 4u, &j->has_mass, 0u, 1u);
    kc_walk_f64(w, 5u, &j->phi_rad, -ANGLE_MAX, ANGLE_MAX);
    kc_walk_f64(w, 6u, &j->alpha_rad, -ANGLE_MAX, ANGLE_MAX);
    kc_walk_f64(w, 7u, &j->a_m, -LENGTH_MAX_M, LENGTH_MAX_M);
    kc_walk_f64(w, 8u, &j->d_m, -LENGTH_MAX_M, LENGTH_MAX_M);
    kc_walk_f64(w, 9u, &j->q_min, -JOINT_MAX, JOINT_MAX); /* rad or m */
    kc_walk_f64(w, 10u, &j->q_max, -JOINT_MAX, JOINT_MAX); /* above q_min */
    kc_walk_rule(w, 10u, j->q_max > j->q_min, j->q_max);
    kc_walk_f64(w, 11u, &j->speed_max, 1e-6, JOINT_MAX); /* rad/s or m/s */
    kc_walk_f64(w, 12u, &j->mass_kg, 0.0, 1e4);
    kc_walk_vec(w, 13u, j->com_m, 3u, -LENGTH_MAX_M, LENGTH_MAX_M); /* in frame i */
    kc_walk_f64(w, 14u, &j->gear_ratio, 0.0, 1e5); /* 0 = unknown */
}

static void walk_arm(kc_walk_t *w, kc_arm_t *a)
{
    uint32_t n;
    kc_walk_name(w, 1u, a->name);
    n = kc_walk_count(w, 2u, &a->n_joints, 1u, KC_JOINT_MAX);
    for (uint32_t j = 0u; j < n; j++) {
        w->index = (int32_t)j;
        walk_joint(w, &a->joint[j]);
    }
    w->index = -1;
    kc_walk_vec(w, 15u, a->base_xyz_m, 3u, -LENGTH_MAX_M, LENGTH_MAX_M);
    kc_walk_quat(w, 16u, a->base_quat_wxyz);
    kc_walk_vec(w, 17u, a->tool_xyz_m, 3u, -LENGTH_MAX_M, LENGTH_MAX_M);
    kc_walk_quat(w, 18u, a->tool_quat_wxyz);
    kc_walk_vec(w, 19u, a->gravity_m_s2, 3u, -JOINT_MAX, JOINT_MAX); /* in the base frame */
}

static void walk_tags(kc_walk_t *w, kc_camera_t *c)
{
    uint32_t n = kc_walk_count(w, 15u, &c->n_tags, 1u, KC_TAG_MAX);
    for (uint32_t i = 0u; i < n; i++) {
        kc_tag_t *t = &c->tag[i];
        w->index = (int32_t)i;
        kc_walk_i32(w, 16u, &t->id, 0, 586); /* 36h11, each once */
        for (uint32_t k = 0u; k < i; k++) { kc_walk_rule(w, 16u, c->tag[k].id != t->id, (double)t->id); }
        kc_walk_f64(w, 17u, &t->size_m, 1e-3, 1.0);
        kc_walk_vec(w, 18u, t->xyz_m, 3u, -LENGTH_MAX_M, LENGTH_MAX_M);
        kc_walk_quat(w, 19u, t->quat_wxyz);
    }
    w->index = -1;
}

static void walk_camera(kc_walk_t *w, kc_camera_t *c)
{
    kc_walk_vec(w, 1u, c->mast_xyz_m, 3u, -LENGTH_MAX_M, LENGTH_MAX_M);
    kc_walk_quat(w, 2u, c->mast_quat_wxyz);
    kc_walk_vec(w, 3u, c->pantilt_xyz_m, 3u, -LENGTH_MAX_M, LENGTH_MAX_M);
    kc_walk_quat(w, 4u, c->pantilt_quat_wxyz);
    kc_walk_f64(w, 5u, &c->pan_min_rad, -ANGLE_MAX, ANGLE_MAX);
    kc_walk_f64(w, 6u, &c->pan_max_rad, -ANGLE_MAX, ANGLE_MAX); /* above pan_min_rad */
    kc_walk_rule(w, 6u, c->pan_max_rad > c->pan_min_rad, c->pan_max_rad);
    kc_walk_f64(w, 7u, &c->tilt_min_rad, -ANGLE_MAX, ANGLE_MAX);
    kc_walk_f64(w, 8u, &c->tilt_max_rad, -ANGLE_MAX, ANGLE_MAX); /* above tilt_min_rad */
    kc_walk_rule(w, 8u, c->tilt_max_rad > c->tilt_min_rad, c->tilt_max_rad);
    kc_walk_f64(w, 9u, &c->fx_px, 1.0, 1e6);
    kc_walk_f64(w, 10u, &c->fy_px, 1.0, 1e6);
    kc_walk_f64(w, 11u, &c->cx_px, -1e5, 1e5);
    kc_walk_f64(w, 12u, &c->cy_px, -1e5, 1e5);
    kc_walk_u32(w, 13u, &c->width_px, 1u, 16384u);
    kc_walk_u32(w, 14u, &c->height_px, 1u, 16384u);
    walk_tags(w, c);
    /* 1-sigma of the camera chain; 0 = exact */
    kc_walk_f64(w, 20u, &c->mast_sigma_m, 0.0, CHAIN_SIGMA_MAX);
    kc_walk_f64(w, 21u, &c->mast_sigma_rad, 0.0, CHAIN_SIGMA_MAX);
    kc_walk_f64(w, 22u, &c->zero_sigma_rad, 0.0, CHAIN_SIGMA_MAX);
    kc_walk_f64(w, 23u, &c->axis_sigma_rad, 0.0, CHAIN_SIGMA_MAX);
    kc_walk_f64(w, 24u, &c->tag_size_sigma, 0.0, CHAIN_SIGMA_MAX);
    kc_walk_f64(w, 25u, &c->plate_sigma_m, 0.0, CHAIN_SIGMA_MAX);
    kc_walk_f64(w, 26u, &c->plate_sigma_rad, 0.0, CHAIN_SIGMA_MAX);
    kc_walk_f64(w, 27u, &c->drift_sigma_m_s, 0.0, CHAIN_SIGMA_MAX);
    kc_walk_f64(w, 28u, &c->drift_sigma_rad_s, 0.0, CHAIN_SIGMA_MAX);
}

static void walk_coef(kc_walk_t *w, kc_coef_t *c)
{
    kc_walk_name(w, 3u, c->name);
    kc_walk_f64(w, 4u, &c->lb, -COEF_ABS_MAX, COEF_ABS_MAX);
    kc_walk_f64(w, 5u, &c->ub, -COEF_ABS_MAX, COEF_ABS_MAX); /* not below lb */
    kc_walk_rule(w, 5u, c->ub >= c->lb, c->ub);
    kc_walk_f64(w, 6u, &c->prior_sigma, 0.0, COEF_ABS_MAX); /* 0 = flat */
    kc_walk_f64(w, 7u, &c->scale, 1e-12, COEF_ABS_MAX);
    kc_walk_u8(w, 8u, &c->enabled, 0u, 1u);
}

static void walk_term(kc_walk_t *w, kc_term_t *t, uint32_t n_coef)
{
    kc_walk_u16(w, 9u, &t->coef, 0u, KC_COEF_MAX - 1u); /* below n_coef */
    kc_walk_rule(w, 9u, t->coef < n_coef, (double)t->coef);
    /* 0 .. n, 9 tool, 10 camera, 11 measured pose */
    kc_walk_u8(w, 10u, &t->frame, 0u, KC_FRAME_COUNT - 1u);
    kc_walk_u8(w, 11u, &t->comp, KC_TX, KC_RZ); /* tx ty tz rx ry rz */
    kc_walk_f64(w, 12u, &t->gain, -COEF_ABS_MAX, COEF_ABS_MAX);
    for (uint32_t b = 0u; b < 2u; b++) {
        kc_walk_u8(w, 13u, &t->basis[b].fn, 0u, KC_FN_COUNT - 1u); /* kc_fn_t */
        kc_walk_u8(w, 14u, &t->basis[b].var, 0u, KC_VAR_COUNT - 1u); /* kc_var_t */
        /* joint or link the variable belongs to; gravity lever: 16 x link + body, body 0 is the tool */
        kc_walk_u8(w, 15u, &t->basis[b].index, 0u, UINT8_MAX);
        kc_walk_f64(w, 16u, &t->basis[b].c0, -COEF_ABS_MAX, COEF_ABS_MAX);
        kc_walk_f64(w, 17u, &t->basis[b].c1, -COEF_ABS_MAX, COEF_ABS_MAX);
    }
}

static void walk_terms(kc_walk_t *w, kc_terms_t *t)
{
    uint32_t n_coef = kc_walk_count(w, 1u, &t->n_coef, 1u, KC_COEF_MAX);
    uint32_t n_term = kc_walk_count(w, 2u, &t->n_term, 1u, KC_TERM_MAX);
    for (uint32_t i = 0u; i < n_coef; i++) {
        w->index = (int32_t)i;
        walk_coef(w, &t->coef[i]);
    }
    for (uint32_t i = 0u; i < n_term; i++) {
        w->index = KC_TERMS_INDEX_TERM + (int32_t)i;
        walk_term(w, &t->term[i], n_coef);
    }
    kc_walk_u32(w, 18u, &t->kinematics_crc, 0u, U32_MAX); /* of the arm they were made for; 0: any */
}

static void walk_kin(kc_walk_t *w, kc_kin_t *k)
{
    uint32_t n = kc_walk_count(w, 1u, &k->n_coef, 1u, KC_COEF_MAX); /* as in TERMS */
    bool nominal = true;
    for (uint32_t i = 0u; i < n; i++) {
        w->index = (int32_t)i;
        /* inside the coefficient's bounds */
        kc_walk_f64(w, 2u, &k->value[i], -COEF_ABS_MAX, COEF_ABS_MAX);
        kc_walk_f64(w, 3u, &k->sigma[i], 0.0, COEF_ABS_MAX);
        nominal = nominal && k->value[i] == 0.0; /* -0 counts as 0 */
    }
    w->index = -1;
    kc_walk_u32(w, 4u, &k->arm_crc, 0u, U32_MAX); /* 0 only if all values are 0 */
    kc_walk_u32(w, 5u, &k->terms_crc, 0u, U32_MAX); /* 0 if and only if arm_crc is */
    /* Only a table of zeros may belong to no arm: both CRCs, or neither and nominal. */
    kc_walk_rule(w, 5u, (k->arm_crc == 0u) == (k->terms_crc == 0u), (double)k->terms_crc);
    kc_walk_rule(w, 4u, k->arm_crc != 0u || nominal, (double)k->arm_crc);
    kc_walk_u32(w, 6u, &k->prev_crc, 0u, U32_MAX);
    kc_walk_u32(w, 7u, &k->session, 0u, U32_MAX);
    kc_walk_u32(w, 8u, &k->n_poses, 0u, KC_MEAS_MAX);
    kc_walk_u64(w, 9u, &k->made_us, 0u, UINT64_MAX);
}

static void walk_cand(kc_walk_t *w, kc_cand_t *c, uint32_t n_joints, uint32_t n_hub)
{
    for (uint32_t i = 0u; i < 3u; i++) { kc_walk_f32(w, 10u, &c->p_m[i], -LENGTH_MAX_M, LENGTH_MAX_M); }
    kc_walk_quatf(w, 11u, c->q_wxyz);
    for (uint32_t j = 0u; j < n_joints; j++) {
        kc_walk_f32(w, 12u, &c->q_seed[j], -JOINT_MAX, JOINT_MAX); /* inside the joint limits */
    }
    kc_walk_f32(w, 13u, &c->pan_rad, -ANGLE_MAX, ANGLE_MAX);
    kc_walk_f32(w, 14u, &c->tilt_rad, -ANGLE_MAX, ANGLE_MAX);
    kc_walk_u8(w, 15u, &c->tags, 1u, (1u << KC_TAG_MAX) - 1u); /* bit per tag expected in view */
    kc_walk_u8(w, 16u, &c->hub, 0u, KC_HUB_MAX - 1u); /* below n_hub; reachable from hub 0 */
    kc_walk_rule(w, 16u, c->hub < n_hub, (double)c->hub);
    /* checks it passed, INTERFACES.md; bit 15: a local initial pose, which must be in `initial`; bit 14:
     * a reserve pose */
    kc_walk_u16(w, 17u, &c->why, 0u, U16_MAX);
}

static void walk_space_roadmap(kc_walk_t *w, kc_space_t *s, uint32_t n_cand)
{
    uint32_t n_hub = kc_walk_count(w, 2u, &s->n_hub, 1u, KC_HUB_MAX);
    uint32_t n_joints = kc_walk_count(w, 3u, &s->n_joints, 1u, KC_JOINT_MAX); /* as in ARM */
    /* local initial poses, then the others */
    uint32_t n_initial = kc_walk_count(w, 4u, &s->n_initial, 0u, KC_INITIAL_MAX);
    for (uint32_t i = 0u; i < n_initial; i++) {
        w->index = (int32_t)i;
        /* below n_cand, none twice; local initial poses first */
        kc_walk_u16(w, 5u, &s->initial[i], 0u, (uint16_t)(KC_CAND_MAX - 1u));
        kc_walk_rule(w, 5u, s->initial[i] < n_cand, (double)s->initial[i]);
    }
    for (uint32_t h = 0u; h < n_hub; h++) {
        w->index = (int32_t)h;
        for (uint32_t j = 0u; j < n_joints; j++) {
            kc_walk_f32(w, 6u, &s->hub_q[h][j], -JOINT_MAX, JOINT_MAX); /* inside the joint limits */
        }
        kc_walk_u16(w, 7u, &s->hub_edge[h], 0u, U16_MAX); /* bit h: segment to hub h; both ways */
    }
    w->index = -1;
    for (uint32_t j = 0u; j < n_joints; j++) { kc_walk_f32(w, 8u, &s->servo_bound[j], 1e-6, JOINT_MAX); }
    kc_walk_u32(w, 9u, &s->arm_crc, 1u, U32_MAX); /* there is no space for any arm */
}

static void walk_point(kc_walk_t *w, uint32_t field, float p[3])
{
    for (uint32_t i = 0u; i < 3u; i++) { kc_walk_f32(w, field, &p[i], -LENGTH_MAX_M, LENGTH_MAX_M); }
}

/* The arm as capsules, and where it must not be. */
static void walk_bodies(kc_walk_t *w, kc_space_t *s)
{
    /* capsules that the arm lies in */
    uint32_t n_body = kc_walk_count(w, 19u, &s->n_body, 0u, KC_BODY_MAX);
    for (uint32_t i = 0u; i < n_body; i++) {
        kc_body_t *b = &s->body[i];
        w->index = KC_SPACE_INDEX_BODY + (int32_t)i;
        /* 0 tool, j: turns with joint j (before its d, a, alpha); at most n_joints */
        kc_walk_u8(w, 20u, &b->frame, 0u, KC_JOINT_MAX);
        kc_walk_rule(w, 20u, b->frame <= s->n_joints, (double)b->frame);
        walk_point(w, 21u, b->start_m);
        walk_point(w, 22u, b->end_m);
        kc_walk_f32(w, 23u, &b->radius_m, 1e-6, LENGTH_MAX_M);
        /* bit per body before it that it must not touch */
        kc_walk_u32(w, 30u, &b->collision_pairs, 0u, (1u << KC_BODY_MAX) - 1u);
        kc_walk_rule(w, 30u, b->collision_pairs >> i == 0u, (double)b->collision_pairs);
    }
    w->index = -1;
    /* keep-out volumes; base frame */
    uint32_t n_volume = kc_walk_count(w, 24u, &s->n_volume, 0u, KC_VOLUME_MAX);
    for (uint32_t i = 0u; i < n_volume; i++) {
        kc_volume_t *v = &s->volume[i];
        w->index = KC_SPACE_INDEX_VOLUME + (int32_t)i;
        /* half space below, box, capsule, sphere */
        kc_walk_u8(w, 25u, &v->kind, KC_VOL_BELOW, KC_VOL_SPHERE);
        walk_point(w, 26u, v->p_m); /* below: height; box, sphere: middle; capsule: one end */
        walk_point(w, 27u, v->size_m); /* box: half lengths, above 0; capsule: other end */
        kc_walk_f32(w, 28u, &v->radius_m, 0.0, LENGTH_MAX_M); /* capsule, sphere: above 0 */
        /* bit per body that may be inside */
        kc_walk_u32(w, 29u, &v->excluded, 0u, (1u << KC_BODY_MAX) - 1u);
        kc_walk_rule(w, 29u, v->excluded >> n_body == 0u, (double)v->excluded);
    }
    w->index = -1;
}

/* DH errors that the arms had for which the space was verified. */
static void walk_verified(kc_walk_t *w, kc_space_t *s)
{
    for (uint32_t j = 0u; j < s->n_joints; j++) {
        kc_dh_bound_t *v = &s->verified[j];
        w->index = KC_SPACE_INDEX_VERIFIED + (int32_t)j;
        kc_walk_f64(w, 31u, &v->phi_rad, 0.0, ANGLE_MAX); /* verified for errors up to it, both ways */
        kc_walk_f64(w, 32u, &v->alpha_rad, 0.0, ANGLE_MAX);
        kc_walk_f64(w, 33u, &v->a_m, 0.0, LENGTH_MAX_M);
        kc_walk_f64(w, 34u, &v->d_m, 0.0, LENGTH_MAX_M);
    }
    w->index = -1;
}

/* An image without stops ends before them: as all did before there were any. */
static void walk_stops(kc_walk_t *w, kc_space_t *s, uint32_t n_cand)
{
    bool here = w->mode == KC_WALK_READ ? w->pos < w->in_n : s->n_stop > 0u;
    if (!here) { return; }
    /* most stops of a candidate; an image without any ends before this */
    uint32_t n_stop = kc_walk_count(w, 35u, &s->n_stop, 1u, KC_STOP_MAX);
    for (uint32_t i = 0u; i < n_cand; i++) {
        w->index = (int32_t)i;
        for (uint32_t k = 0u; k < n_stop; k++) {
            /* place on the segment from the hub, in 1/256 of it; ascending, then 0: none; local poses have none */
            kc_walk_u8(w, 36u, &s->stop[i][k], 0u, KC_STOP_PARTS - 1u);
            kc_walk_rule(w, 36u, kc_space_stop_fits(s, i, k), (double)s->stop[i][k]);
        }
    }
}

static void walk_space(kc_walk_t *w, kc_space_t *s)
{
    uint32_t n_cand = kc_walk_count(w, 1u, &s->n_cand, 1u, KC_CAND_MAX);
    walk_space_roadmap(w, s, n_cand);
    if (w->lost) { return; } /* the counts below are not to be trusted */
    for (uint32_t i = 0u; i < n_cand; i++) {
        w->index = (int32_t)i;
        walk_cand(w, &s->cand[i], s->n_joints, s->n_hub);
    }
    w->index = -1;
    if (n_cand > 0u) {
        /* bit i (i-1)/2 + j: segment between i > j; n_edge = ceil(n_cand (n_cand-1)/16), bits left over
         * are 0 */
        kc_walk_raw(w, s->edge, (n_cand * (n_cand - 1u) / 2u + 7u) / 8u);
    }
    walk_bodies(w, s);
    walk_verified(w, s);
    walk_stops(w, s, n_cand);
}

static void walk_hyper(kc_walk_t *w, kc_hyper_t *h)
{
    uint32_t n;
    kc_walk_f64(w, 5u, &h->sigma_s, 1e-6, 1e3);
    kc_walk_f64(w, 6u, &h->beta_m, 1e-3, 1e3);
    kc_walk_f64(w, 7u, &h->kappa, 1e-3, 1e3);
    kc_walk_f64(w, 8u, &h->nu, 0.0, 100.0); /* 0 = heat */
    n = kc_walk_count(w, 9u, &h->n_w, 1u, KC_SPECTRUM_MAX);
    kc_walk_vec(w, 10u, h->w, n, 0.0, 1.0); /* so3: odd degrees 0; sum of (n+1) w_n = 1 */
    kc_walk_f64(w, 11u, &h->trunc_err, 0.0, 0.1);
}

static void walk_kernel(kc_walk_t *w, kc_kernel_t *k)
{
    uint32_t n;
    kc_walk_u8(w, 1u, &k->arg, KC_KERNEL_SO3, KC_KERNEL_PAPER); /* 0 so3, 1 paper */
    n = kc_walk_count(w, 2u, &k->n_hyper, 1u, KC_HYPER_MAX);
    kc_walk_f64(w, 3u, &k->sigma_eps, 1e-9, 1e3);
    kc_walk_u8(w, 4u, &k->choose, 0u, 1u);
    for (uint32_t i = 0u; i < n; i++) {
        w->index = (int32_t)i;
        walk_hyper(w, &k->hyper[i]);
    }
}

void kc_layout_walk(kc_walk_t *w, uint16_t kind, void *t)
{
    w->index = -1;
    switch (kind) {
    case KC_TBL_ARM: walk_arm(w, t); break;
    case KC_TBL_CAMERA: walk_camera(w, t); break;
    case KC_TBL_TERMS: walk_terms(w, t); break;
    case KC_TBL_KIN: walk_kin(w, t); break;
    case KC_TBL_SPACE: walk_space(w, t); break;
    case KC_TBL_KERNEL: walk_kernel(w, t); break;
    case KC_TBL_CONFIG: kc_config_walk(w, t); break;
    default: w->lost = 1u; break;
    }
}

uint16_t kc_layout_version(uint16_t kind)
{
    /* One more for every change of what a kind's image holds or means. */
    static const uint16_t version[KC_TBL_COUNT] = {
        [KC_TBL_ARM] = 1u,   [KC_TBL_CAMERA] = 2u, [KC_TBL_TERMS] = 1u,  [KC_TBL_KIN] = 1u,
        [KC_TBL_SPACE] = 2u, [KC_TBL_KERNEL] = 1u, [KC_TBL_CONFIG] = 2u,
    };
    return kind < KC_TBL_COUNT ? version[kind] : 0u;
}

uint32_t kc_layout_struct_bytes(uint16_t kind)
{
    switch (kind) {
    case KC_TBL_ARM: return (uint32_t)sizeof(kc_arm_t);
    case KC_TBL_CAMERA: return (uint32_t)sizeof(kc_camera_t);
    case KC_TBL_TERMS: return (uint32_t)sizeof(kc_terms_t);
    case KC_TBL_KIN: return (uint32_t)sizeof(kc_kin_t);
    case KC_TBL_SPACE: return (uint32_t)sizeof(kc_space_t);
    case KC_TBL_KERNEL: return (uint32_t)sizeof(kc_kernel_t);
    case KC_TBL_CONFIG: return (uint32_t)sizeof(kc_config_t);
    default: return 0u;
    }
}
