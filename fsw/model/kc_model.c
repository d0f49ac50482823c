#include "kc_model.h"

#include <string.h>

#include "kc_vec.h"

/* What coefficient c is; NULL: all are 0. */
static double value_of(const double *coef, uint32_t c) { return coef != NULL ? coef[c] : 0.0; }

static bool is_constant(const kc_term_t *t)
{
    return (t->basis[0].var | t->basis[1].var) == (uint32_t)KC_VAR_ONE; /* which is 0 */
}

/* A term that is constant costs no call. */
static double term_weight(const kc_term_t *t, const kc_ctx_t *ctx, const kc_loads_t *loads)
{
    if (is_constant(t)) { return t->gain; }
    const double weight = t->gain * kc_basis_eval(&t->basis[0], ctx, loads);
    return weight * kc_basis_eval(&t->basis[1], ctx, loads);
}

static bool needs_loads(const kc_term_t *t)
{
    return !is_constant(t) && (kc_basis_needs_loads(&t->basis[0]) || kc_basis_needs_loads(&t->basis[1]));
}

/* Components of the twists to which a term adds that is not constant, as far as its coefficient is not 0. */
static void find_varying(const kc_terms_t *terms, const double *coef, uint8_t *varies)
{
    memset(varies, 0, KC_FRAME_COUNT * sizeof *varies);
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        const kc_term_t *t = &terms->term[k];
        if (is_constant(t) || kc_is_zero(value_of(coef, t->coef))) { continue; }
        varies[t->frame] = (uint8_t)(varies[t->frame] | (1u << t->comp));
    }
}

static bool is_in(const uint8_t *varies, const kc_term_t *t)
{
    return ((varies[t->frame] >> t->comp) & 1u) != 0u;
}

static bool on_camera_side(const kc_term_t *t) { return t->frame >= KC_FRAME_CAMERA; }

static void put(kc_term_list_t *list, uint32_t k) { list->listed[list->n_listed++] = (uint16_t)k; }

/* Constant terms are summed here, once. A component to which another term adds is summed for each pose, in the order of
 * the terms: another order would round otherwise. */
static void fix_twists(kc_fixed_t *f)
{
    const kc_terms_t *terms = f->terms;
    memset(&f->tw, 0, sizeof f->tw);
    memset(f->varies, 0, sizeof f->varies);
    f->on_arm.n_listed = 0u;
    f->on_camera.n_listed = 0u;
    f->unloaded.n_listed = 0u;
    if (terms == NULL) { return; }
    find_varying(terms, f->coef, f->varies);
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        const kc_term_t *t = &terms->term[k];
        const double by = value_of(f->coef, t->coef);
        const bool moves = !kc_is_zero(by), on_camera = on_camera_side(t);
        if (!is_constant(t) || is_in(f->varies, t)) {
            put(on_camera ? &f->on_camera : &f->on_arm, k);
            if (moves && !on_camera && !needs_loads(t)) { put(&f->unloaded, k); }
        } else if (moves) {
            f->tw.of[t->frame][t->comp] += by * t->gain;
        }
    }
}

/* Add listed terms to the twists of a pose. weight: of each, by term; NULL: not wanted. */
static void add_listed(const kc_fixed_t *f, const kc_term_list_t *list, const kc_ctx_t *ctx,
                       const kc_loads_t *loads, kc_twists_t *own, double *weight)
{
    const kc_term_t *term = f->terms->term;
    for (uint32_t i = 0u; i < list->n_listed; i++) {
        const uint32_t k = list->listed[i];
        const kc_term_t *t = &term[k];
        const double by = value_of(f->coef, t->coef);
        const bool moves = !kc_is_zero(by);
        if (!moves && weight == NULL) { continue; }
        const double w = term_weight(t, ctx, loads);
        if (weight != NULL) { weight[k] = w; }
        if (moves) { own->of[t->frame][t->comp] += by * w; }
    }
}

/* Twists of a pose, in own where it has some of its own; on the camera side too if that is wanted. */
static const kc_twists_t *sum_twists(const kc_fixed_t *f, const kc_ctx_t *ctx, const kc_loads_t *loads,
                                     bool camera_side, kc_twists_t *own, double *weight)
{
    if (f->on_arm.n_listed + f->on_camera.n_listed == 0u) { return &f->tw; }
    *own = f->tw;
    add_listed(f, &f->on_arm, ctx, loads, own, weight);
    if (camera_side) { add_listed(f, &f->on_camera, ctx, loads, own, weight); }
    return own;
}

/* The same of a pose of which loads are not known yet: terms that depend on them count as zero. */
static const kc_twists_t *sum_unloaded(const kc_fixed_t *f, const kc_ctx_t *ctx, kc_twists_t *own)
{
    if (f->unloaded.n_listed == 0u) { return &f->tw; }
    *own = f->tw;
    add_listed(f, &f->unloaded, ctx, NULL, own, NULL);
    return own;
}

/* Whether a term depends on loads that has to be right: it moves the arm, or its derivative may be used. */
static bool loads_count(const kc_terms_t *terms, const double *coef)
{
    if (terms == NULL) { return false; }
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        const kc_term_t *t = &terms->term[k];
        if (!needs_loads(t)) { continue; }
        if (terms->coef[t->coef].enabled != 0u || !kc_is_zero(value_of(coef, t->coef))) { return true; }
    }
    return false;
}

/* A term that is constant takes a multiplication, another one two functions, and J a row of each. */
uint64_t kc_model_cost(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, bool want_J)
{
    const uint64_t n = arm->n_joints;
    uint64_t cost = 6000u + 1200u * n + (want_J ? 4000u + 500u * n : 0u), with_loads = 0u;
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        const uint64_t weight = is_constant(&terms->term[k]) ? 60u : 500u;
        cost += weight + (want_J ? 60u : 0u);
        with_loads += weight;
    }
    return cost + (loads_count(terms, coef) ? with_loads + 4000u + 1700u * n : 0u);
}

static void keep_line(const kc_pose_t *T, uint32_t axis, kc_line_t *line)
{
    kc_m3_col(T->R, axis, line->axis);
    kc_v3_copy(T->p_m, line->point_m);
}

/* T <- T E, E = Tx Rx Ty Ry Rz Tz: a screw on x, then y, then z. line: by axis, NULL: not wanted. */
static void apply_twist(kc_pose_t *T, const double tw[6], kc_line_t *line)
{
    for (uint32_t axis = 0u; axis < 3u; axis++) {
        if (line != NULL) { keep_line(T, axis, &line[axis]); }
        kc_pose_screw(T, axis, tw[axis], tw[3u + axis]);
    }
}

/* How a turn about the line moves p. */
static inline void moved_by_turn(const kc_line_t *line, const double p[3], double dp[3])
{
    double r[3];
    kc_v3_sub(p, line->point_m, r);
    kc_v3_cross(line->axis, r, dp);
}

/* Sum of m_k c_k and m_k beyond a frame, for moments about any point. */
typedef struct {
    double mass_kg;
    double first_kg_m[3];
} beyond_t;

static void add_mass(beyond_t *b, double mass_kg, const double c_m[3])
{
    b->mass_kg += mass_kg;
    kc_v3_add_scaled(b->first_kg_m, mass_kg, c_m, b->first_kg_m);
}

/* Moment about o: sum (c_k - o) x m_k g. */
static void moment_about(const beyond_t *b, const double o[3], const double g[3], double out[3])
{
    double arm[3];
    kc_v3_add_scaled(b->first_kg_m, -b->mass_kg, o, arm);
    kc_v3_cross(arm, g, out);
}

/* About axis z of frame T. */
static double moment_on_z(const beyond_t *b, const kc_pose_t *T, const double g[3])
{
    double z[3], m[3];
    kc_m3_col(T->R, 2u, z);
    moment_about(b, T->p_m, g, m);
    return kc_v3_dot(z, m);
}

static void link_mass(const kc_joint_t *joint, const kc_pose_t *T, beyond_t *b)
{
    double c[3];
    if (!joint->has_mass) { return; }
    kc_m3_mul_v3(T->R, joint->com_m, c);
    kc_v3_add_scaled(c, 1.0, T->p_m, c);
    add_mass(b, joint->mass_kg, c);
}

/* Of a frame: its origin, gravity in it, and gravity crossed with its axes. */
static void lever_parts(const kc_pose_t *T, const double g[3], uint32_t i, kc_loads_t *loads)
{
    kc_v3_copy(T->p_m, loads->origin_m[i]);
    kc_m3t_mul_v3(T->R, g, loads->g_link_m_s2[i]);
    for (uint32_t axis = 0u; axis < 3u; axis++) {
        double c[3];
        kc_m3_col(T->R, axis, c);
        kc_v3_cross(g, c, loads->g_cross_m_s2[i][axis]);
    }
}

/* Bits of a component along and of that about an axis. */
#define ON_X (1u << KC_TX | 1u << KC_RX)
#define ON_Y (1u << KC_TY | 1u << KC_RY)

static const kc_joint_t NO_JOINT; /* before frame 0 and after frame n */
static const double NO_TWIST[6];

static void set_screw(kc_screw_t *s, double shift_m, double angle_rad)
{
    s->shift_m = shift_m;
    s->angle_rad = angle_rad;
    s->sine = 0.0;
    s->cosine = 1.0;
    if (!kc_is_zero(angle_rad)) { kc_sincos(angle_rad, &s->sine, &s->cosine); }
}

/* One screw does what is on one line: the link before frame i and the twist about its x. */
static void set_x(const kc_arm_t *arm, uint32_t i, const double tw[6], kc_screw_t *x)
{
    const kc_joint_t *before = i > 0u ? &arm->joint[i - 1u] : &NO_JOINT;
    set_screw(x, tw[0] + before->a_m, tw[3] + before->alpha_rad);
}

static void set_twist(const double tw[6], uint32_t axis, kc_screw_t *s)
{
    set_screw(s, tw[axis], tw[3u + axis]);
}

/* The twist about z of frame i, and the joint after it with its offset. */
static void set_z(const kc_arm_t *arm, uint32_t i, const double tw[6], const double *q, kc_screw_t *z)
{
    const kc_joint_t *after = i < arm->n_joints ? &arm->joint[i] : &NO_JOINT;
    const double by = i < arm->n_joints ? q[i] : 0.0;
    const bool turns = after->type == KC_REVOLUTE;
    set_screw(z, tw[2] + after->d_m + (turns ? 0.0 : by), tw[5] + after->phi_rad + (turns ? by : 0.0));
}

static inline void apply_screw(const kc_screw_t *s, uint32_t axis, kc_pose_t *T)
{
    if (!kc_is_zero(s->shift_m)) { kc_pose_shift(T, axis, s->shift_m); }
    if (!kc_is_zero(s->angle_rad)) { kc_pose_turn(T, axis, s->sine, s->cosine); }
}

/* Screws of frame 0 .. n that a pose has for itself. */
typedef struct {
    kc_screw_t x[KC_JOINT_MAX + 1u], y[KC_JOINT_MAX + 1u], z[KC_JOINT_MAX + 1u];
} screws_t;

static void set_links(const kc_fixed_t *f, const kc_twists_t *tw, screws_t *own)
{
    for (uint32_t i = 0u; i <= f->arm->n_joints; i++) {
        if ((f->varies[i] & ON_X) != 0u) { set_x(f->arm, i, tw->of[i], &own->x[i]); }
        if ((f->varies[i] & ON_Y) != 0u) { set_twist(tw->of[i], 1u, &own->y[i]); }
    }
}

static inline const kc_screw_t *x_of(const kc_fixed_t *f, const screws_t *own, uint32_t i)
{
    return (f->varies[i] & ON_X) != 0u ? &own->x[i] : &f->x[i];
}

static inline const kc_screw_t *y_of(const kc_fixed_t *f, const screws_t *own, uint32_t i)
{
    return (f->varies[i] & ON_Y) != 0u ? &own->y[i] : &f->twist[i][1];
}

/* Along the link before frame i, and the twists about its x and y. */
static void turn_link(const kc_fixed_t *f, const screws_t *own, uint32_t i, kc_pose_t *T)
{
    apply_screw(x_of(f, own, i), 0u, T);
    apply_screw(y_of(f, own, i), 1u, T);
}

/* Pose of the tool, and the lines of z of frame 0 .. n; want_J: all lines on the arm. All sines and cosines are worked
 * out before the walk, where each step waits for the one before: so they overlap. */
static void walk_chain(const kc_fixed_t *f, const kc_ctx_t *ctx, const kc_twists_t *tw, bool want_J,
                       kc_eval_t *ev)
{
    const kc_arm_t *arm = f->arm;
    kc_pose_t T = f->base;
    screws_t own;
    set_links(f, tw, &own);
    for (uint32_t i = 0u; i <= arm->n_joints; i++) { set_z(arm, i, tw->of[i], ctx->q, &own.z[i]); }
    for (uint32_t i = 0u; i <= arm->n_joints; i++) {
        kc_line_t *line = ev->line[i];
        if (want_J) { keep_line(&T, 0u, &line[0]); }
        apply_screw(x_of(f, &own, i), 0u, &T);
        if (want_J) { keep_line(&T, 1u, &line[1]); }
        apply_screw(y_of(f, &own, i), 1u, &T);
        keep_line(&T, 2u, &line[2]);
        apply_screw(&own.z[i], 2u, &T);
    }
    kc_pose_mul(&T, &f->tool, &ev->T);
    apply_twist(&ev->T, tw->of[KC_FRAME_TOOL], want_J ? ev->line[KC_FRAME_TOOL] : NULL);
}

void kc_model_fix(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, kc_fixed_t *fixed)
{
    fixed->arm = arm;
    fixed->terms = terms;
    fixed->coef = coef;
    kc_pose_from_quat(arm->base_xyz_m, arm->base_quat_wxyz, &fixed->base);
    kc_pose_from_quat(arm->tool_xyz_m, arm->tool_quat_wxyz, &fixed->tool);
    fixed->loads_count = loads_count(terms, coef);
    fix_twists(fixed);
    for (uint32_t i = 0u; i <= arm->n_joints; i++) {
        set_x(arm, i, fixed->tw.of[i], &fixed->x[i]);
        set_x(arm, i, NO_TWIST, &fixed->link[i]);
        for (uint32_t axis = 0u; axis < 3u; axis++) {
            set_twist(fixed->tw.of[i], axis, &fixed->twist[i][axis]);
        }
    }
}

/* The part of the twist at frame i that is on an axis, by itself. */
static inline void turn_twist(const kc_fixed_t *f, const kc_twists_t *tw, uint32_t i, uint32_t axis,
                              kc_pose_t *T)
{
    if ((f->varies[i] & (ON_X << axis)) != 0u) {
        kc_pose_screw(T, axis, tw->of[i][axis], tw->of[i][3u + axis]);
    } else {
        apply_screw(&f->twist[i][axis], axis, T);
    }
}

/* Frames 0 .. n without corrections that depend on loads, and the tool. Joint, link and twist are apart: screws on one
 * line, taken together, would round otherwise. */
static void walk_unloaded(const kc_fixed_t *f, const kc_ctx_t *ctx, kc_pose_t *frame, kc_pose_t *tool)
{
    const kc_arm_t *arm = f->arm;
    kc_screw_t joint[KC_JOINT_MAX + 1u];
    kc_twists_t own;
    const kc_twists_t *tw = sum_unloaded(f, ctx, &own);
    kc_pose_t T = f->base;
    for (uint32_t i = 0u; i < arm->n_joints; i++) { set_z(arm, i, NO_TWIST, ctx->q, &joint[i]); }
    for (uint32_t i = 0u; i <= arm->n_joints; i++) {
        if (i > 0u) { apply_screw(&joint[i - 1u], 2u, &T); }
        apply_screw(&f->link[i], 0u, &T);
        turn_twist(f, tw, i, 0u, &T);
        turn_twist(f, tw, i, 1u, &T);
        turn_twist(f, tw, i, 2u, &T);
        frame[i] = T;
    }
    kc_pose_mul(&T, &f->tool, tool);
    apply_twist(tool, tw->of[KC_FRAME_TOOL], NULL);
}

/* Moments about frame 0 .. n, from the tool to the base, masses added up; and what they are about the joints' axes, or,
 * along one that slides, the force. */
static void sum_moments(const kc_arm_t *arm, const kc_pose_t *frame, const kc_ctx_t *ctx, kc_loads_t *loads)
{
    const double *g = ctx->g_m_s2, *tool_m = loads->origin_m[KC_FRAME_TOOL];
    const uint32_t n = arm->n_joints;
    beyond_t all = {0.0, {0.0, 0.0, 0.0}}, payload = all;
    add_mass(&payload, ctx->payload_kg, tool_m);
    add_mass(&all, ctx->payload_kg, tool_m);
    for (uint32_t i = n + 1u; i-- > 0u;) {
        const kc_pose_t *T = &frame[i];
        double m[3];
        moment_about(&all, T->p_m, g, m);
        kc_m3t_mul_v3(T->R, m, loads->moment[i]);
        if (i < n) {
            const bool slides = arm->joint[i].type == KC_PRISMATIC;
            const double along = loads->g_link_m_s2[i][2]; /* gravity on the joint's axis */
            loads->tau[i] = slides ? all.mass_kg * along : loads->moment[i][2];
            loads->tau_payload[i] = slides ? payload.mass_kg * along : moment_on_z(&payload, T, g);
        }
        if (i > 0u) { link_mass(&arm->joint[i - 1u], T, &all); }
    }
}

void kc_fixed_loads(const kc_fixed_t *fixed, const kc_ctx_t *ctx, kc_loads_t *loads)
{
    const kc_arm_t *arm = fixed->arm;
    kc_pose_t frame[KC_JOINT_MAX + 1u], tool;
    memset(loads, 0, sizeof *loads);
    walk_unloaded(fixed, ctx, frame, &tool);
    for (uint32_t i = 0u; i <= arm->n_joints; i++) { lever_parts(&frame[i], ctx->g_m_s2, i, loads); }
    kc_v3_copy(tool.p_m, loads->origin_m[KC_FRAME_TOOL]);
    sum_moments(arm, frame, ctx, loads);
}

const kc_loads_t *kc_fixed_needed_loads(const kc_fixed_t *fixed, const kc_ctx_t *ctx, kc_loads_t *work)
{
    static const kc_loads_t none;
    if (!fixed->loads_count) { return &none; }
    kc_fixed_loads(fixed, ctx, work);
    return work;
}

void kc_model_loads(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                    kc_loads_t *loads)
{
    kc_fixed_t f;
    kc_model_fix(arm, terms, coef, &f);
    kc_fixed_loads(&f, ctx, loads);
}

void kc_model_needed_loads(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                           const kc_ctx_t *ctx, kc_loads_t *loads)
{
    if (loads_count(terms, coef)) {
        kc_model_loads(arm, terms, coef, ctx, loads);
    } else {
        memset(loads, 0, sizeof *loads);
    }
}

/* Links and twists about x and y are screws of walk_chain; about z a body stands between twist and offset. */
void kc_fixed_frames(const kc_fixed_t *fixed, const kc_ctx_t *ctx, const kc_loads_t *loads, kc_pose_t *frame,
                     double *along_m, double *across_m)
{
    const kc_arm_t *arm = fixed->arm;
    kc_twists_t own;
    screws_t screws;
    kc_pose_t T = fixed->base;
    const kc_twists_t *tw = sum_twists(fixed, ctx, loads, false, &own, NULL);
    set_links(fixed, tw, &screws);
    turn_link(fixed, &screws, 0u, &T);
    for (uint32_t i = 1u; i <= arm->n_joints; i++) {
        const kc_joint_t *joint = &arm->joint[i - 1u];
        const double *before = tw->of[i - 1u], q = ctx->q[i - 1u];
        const bool slides = joint->type == KC_PRISMATIC;
        along_m[i] = before[2];
        across_m[i] = tw->of[i][0];
        kc_pose_screw(&T, 2u, before[2] + (slides ? q : 0.0),
                      before[5] + joint->phi_rad + (slides ? 0.0 : q));
        frame[i] = T;
        kc_pose_screw(&T, 2u, joint->d_m, 0.0);
        turn_link(fixed, &screws, i, &T);
    }
    kc_pose_screw(&T, 2u, tw->of[arm->n_joints][2], tw->of[arm->n_joints][5]);
    along_m[0] = 0.0;
    across_m[0] = 0.0;
    kc_pose_mul(&T, &fixed->tool, &frame[0]);
    apply_twist(&frame[0], tw->of[KC_FRAME_TOOL], NULL);
}

void kc_model_frames(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                     const kc_loads_t *loads, kc_pose_t *frame, double *along_m, double *across_m)
{
    kc_fixed_t f;
    kc_model_fix(arm, terms, coef, &f);
    kc_fixed_frames(&f, ctx, loads, frame, along_m, across_m);
}

/* A joint moves on the line of z of the frame before it. */
static void set_joint_rows(const kc_arm_t *arm, kc_eval_t *ev)
{
    for (uint32_t j = 0u; j < arm->n_joints; j++) {
        const kc_line_t *line = &ev->line[j][2];
        double *row = ev->Jq[j];
        if (arm->joint[j].type == KC_PRISMATIC) {
            kc_v3_copy(line->axis, row);
            memset(row + 3, 0, 3u * sizeof(double));
        } else {
            moved_by_turn(line, ev->T.p_m, row);
            kc_v3_copy(line->axis, row + 3);
        }
    }
}

void kc_model_twist(const kc_eval_t *ev, uint32_t frame, uint32_t comp, double row[6])
{
    const bool camera_side = frame >= KC_FRAME_CAMERA;
    memset(row, 0, 6u * sizeof(double));
    if (camera_side && !ev->has_measured) { return; }
    if (comp < KC_RX) {
        kc_v3_copy(ev->line[frame][comp].axis, row);
    } else {
        const kc_line_t *line = &ev->line[frame][comp - KC_RX];
        moved_by_turn(line, camera_side ? ev->measured_m : ev->T.p_m, row);
        kc_v3_copy(line->axis, row + 3);
    }
}

/* J[c] += weight x what the component moves (kc_model_twist), for the terms on the arm or on the camera side. weight: of
 * terms that are not constant. */
static void add_coef_rows(const kc_terms_t *terms, const double *weight, bool camera_side, kc_eval_t *ev)
{
    const double *p = camera_side ? ev->measured_m : ev->T.p_m;
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        const kc_term_t *t = &terms->term[k];
        if (on_camera_side(t) != camera_side) { continue; }
        /* What is not constant is listed, so add_listed has set its weight.
         * NOLINTNEXTLINE(clang-analyzer-core.uninitialized.Assign) */
        const double w = is_constant(t) ? t->gain : weight[k];
        double *row = ev->J[t->coef];
        if (kc_is_zero(w)) { continue; }
        if (t->comp < (uint8_t)KC_RX) {
            kc_v3_add_scaled(row, w, ev->line[t->frame][t->comp].axis, row);
        } else {
            const kc_line_t *line = &ev->line[t->frame][t->comp - (uint8_t)KC_RX];
            double dp[3];
            moved_by_turn(line, p, dp);
            kc_v3_add_scaled(row, w, dp, row);
            kc_v3_add_scaled(row + 3, w, line->axis, row + 3);
        }
    }
}

/* With J of the arm's side if weights are given. */
static void eval_with(const kc_fixed_t *f, const kc_twists_t *tw, const kc_ctx_t *ctx, const double *weight,
                      kc_eval_t *ev)
{
    walk_chain(f, ctx, tw, weight != NULL, ev);
    set_joint_rows(f->arm, ev);
    ev->has_measured = false;
    if (weight == NULL) { return; }
    memset(ev->J, 0, f->terms->n_coef * sizeof ev->J[0]);
    add_coef_rows(f->terms, weight, false, ev);
}

void kc_fixed_eval(const kc_fixed_t *fixed, const kc_ctx_t *ctx, const kc_loads_t *loads, bool want_J,
                   kc_eval_t *ev)
{
    kc_twists_t own;
    double weight[KC_TERM_MAX];
    const kc_twists_t *tw = sum_twists(fixed, ctx, loads, false, &own, want_J ? weight : NULL);
    eval_with(fixed, tw, ctx, want_J ? weight : NULL, ev);
}

void kc_model_eval(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                   const kc_loads_t *loads, bool want_J, kc_eval_t *ev)
{
    kc_fixed_t f;
    kc_model_fix(arm, terms, coef, &f);
    kc_fixed_eval(&f, ctx, loads, want_J, ev);
}

/* Measured pose with the camera-side corrections. line: those of camera and measurement, NULL: not wanted. */
static void correct_measured(const kc_obs_t *obs, const kc_twists_t *tw, kc_pose_t *M, kc_line_t (*line)[3])
{
    kc_pose_t C, measured;
    kc_pose_from_quat(obs->p_cam_m, obs->q_cam_wxyz, &C);
    kc_pose_inv(&C, &measured);
    kc_pose_mul(&measured, M, &measured); /* T_cam_tool as measured */
    apply_twist(&C, tw->of[KC_FRAME_CAMERA], line != NULL ? line[0] : NULL);
    kc_pose_mul(&C, &measured, M);
    apply_twist(M, tw->of[KC_FRAME_MEAS], line != NULL ? line[1] : NULL);
}

/* Lines that move what was measured move the residual the other way. */
static void add_camera_side(const kc_terms_t *terms, const double *weight, const kc_pose_t *M, kc_eval_t *ev)
{
    kc_v3_copy(M->p_m, ev->measured_m);
    ev->has_measured = true;
    for (uint32_t frame = KC_FRAME_CAMERA; frame <= KC_FRAME_MEAS; frame++) {
        for (uint32_t axis = 0u; axis < 3u; axis++) {
            double *along = ev->line[frame][axis].axis;
            for (uint32_t i = 0u; i < 3u; i++) { along[i] = -along[i]; }
        }
    }
    add_coef_rows(terms, weight, true, ev);
}

/* The pose that the observation says. */
static void observed(const kc_obs_t *obs, const kc_eval_t *ev, kc_pose_t *M)
{
    if (obs->has_rot) {
        kc_pose_from_quat(obs->p_m, obs->q_wxyz, M);
    } else {
        *M = ev->T;
        kc_v3_copy(obs->p_m, M->p_m);
    }
}

static uint32_t difference(const kc_obs_t *obs, const kc_pose_t *M, const kc_eval_t *ev, double r[6])
{
    kc_pose_residual(M, &ev->T, r);
    if (obs->has_rot) { return 6u; }
    memset(r + 3, 0, 3u * sizeof(double));
    return 3u;
}

uint32_t kc_fixed_residual(const kc_fixed_t *fixed, const kc_obs_t *obs, const kc_loads_t *loads, double r[6],
                           kc_eval_t *ev)
{
    kc_twists_t own;
    double weight[KC_TERM_MAX];
    kc_pose_t M;
    const kc_twists_t *tw = sum_twists(fixed, &obs->ctx, loads, obs->has_cam != 0u, &own, weight);
    eval_with(fixed, tw, &obs->ctx, weight, ev);
    observed(obs, ev, &M);
    if (obs->has_cam) {
        correct_measured(obs, tw, &M, &ev->line[KC_FRAME_CAMERA]);
        add_camera_side(fixed->terms, weight, &M, ev);
    }
    return difference(obs, &M, ev, r);
}

uint32_t kc_model_residual(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                           const kc_obs_t *obs, const kc_loads_t *loads, double r[6], kc_eval_t *ev)
{
    kc_fixed_t f;
    kc_model_fix(arm, terms, coef, &f);
    return kc_fixed_residual(&f, obs, loads, r, ev);
}

uint32_t kc_fixed_miss(const kc_fixed_t *fixed, const kc_obs_t *obs, const kc_loads_t *loads, double r[6],
                       kc_eval_t *ev)
{
    kc_twists_t own;
    kc_pose_t M;
    const kc_twists_t *tw = sum_twists(fixed, &obs->ctx, loads, obs->has_cam != 0u, &own, NULL);
    eval_with(fixed, tw, &obs->ctx, NULL, ev);
    observed(obs, ev, &M);
    if (obs->has_cam) { correct_measured(obs, tw, &M, NULL); }
    return difference(obs, &M, ev, r);
}

uint32_t kc_model_miss(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_obs_t *obs,
                       const kc_loads_t *loads, double r[6], kc_eval_t *ev)
{
    kc_fixed_t f;
    kc_model_fix(arm, terms, coef, &f);
    return kc_fixed_miss(&f, obs, loads, r, ev);
}
