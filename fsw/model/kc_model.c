#include "kc_model.h"

#include <string.h>

#include "kc_vec.h"

/* What coefficient c is; NULL: all are 0. */
static double value_of(const double *coef, uint32_t c) { return coef != NULL ? coef[c] : 0.0; }

/* Twists of all frames: component sums of the correction terms. */
typedef double twists_t[KC_FRAME_COUNT][6];

static bool is_constant(const kc_term_t *t)
{
    return (t->basis[0].var | t->basis[1].var) == (uint32_t)KC_VAR_ONE; /* which is 0 */
}

/* A basis that is 1 costs no call. */
static double term_weight(const kc_term_t *t, const kc_ctx_t *ctx, const kc_loads_t *loads)
{
    double weight = t->gain;
    if (is_constant(t)) { return weight; }
    for (uint32_t b = 0u; b < 2u; b++) {
        if (t->basis[b].var != (uint8_t)KC_VAR_ONE) { weight *= kc_basis_eval(&t->basis[b], ctx, loads); }
    }
    return weight;
}

static bool needs_loads(const kc_term_t *t)
{
    return !is_constant(t) && (kc_basis_needs_loads(&t->basis[0]) || kc_basis_needs_loads(&t->basis[1]));
}

/* loads NULL: terms that depend on loads count as zero. weight: of every term, NULL: not wanted. */
static void sum_twists(const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                       const kc_loads_t *loads, twists_t tw, double *weight)
{
    memset(tw, 0, sizeof(twists_t));
    if (coef == NULL && weight == NULL) { return; } /* terms may be NULL then */
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        const kc_term_t *t = &terms->term[k];
        const double by = value_of(coef, t->coef);
        const bool moves = !kc_is_zero(by);
        if ((!moves && weight == NULL) || (loads == NULL && needs_loads(t))) { continue; }
        const double w = term_weight(t, ctx, loads);
        if (weight != NULL) { weight[k] = w; }
        if (moves) { tw[t->frame][t->comp] += by * w; }
    }
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

void kc_model_needed_loads(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                           const kc_ctx_t *ctx, kc_loads_t *loads)
{
    if (loads_count(terms, coef)) {
        kc_model_loads(arm, terms, coef, ctx, loads);
    } else {
        memset(loads, 0, sizeof *loads);
    }
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

/* What gravity does about joint axis z of frame T: torque, or force along it. */
static double joint_load(const kc_joint_t *joint, const kc_pose_t *T, const beyond_t *b, const double g[3])
{
    double z[3], m[3];
    kc_m3_col(T->R, 2u, z);
    if (joint->type == KC_PRISMATIC) { return b->mass_kg * kc_v3_dot(z, g); }
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

void kc_model_loads(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                    kc_loads_t *loads)
{
    const uint32_t n = arm->n_joints;
    twists_t tw;
    kc_pose_t frame[KC_JOINT_MAX + 1u], T, tool;
    beyond_t all = {0.0, {0.0, 0.0, 0.0}}, payload = {0.0, {0.0, 0.0, 0.0}};

    memset(loads, 0, sizeof *loads);
    sum_twists(terms, coef, ctx, NULL, tw, NULL);
    kc_pose_from_quat(arm->base_xyz_m, arm->base_quat_wxyz, &T);
    for (uint32_t i = 0u; i <= n; i++) {
        if (i > 0u) { kc_arm_link(&arm->joint[i - 1u], ctx->q[i - 1u], &T); }
        apply_twist(&T, tw[i], NULL);
        frame[i] = T;
        lever_parts(&T, ctx->g_m_s2, i, loads);
    }
    kc_pose_from_quat(arm->tool_xyz_m, arm->tool_quat_wxyz, &tool);
    kc_pose_mul(&T, &tool, &T);
    apply_twist(&T, tw[KC_FRAME_TOOL], NULL);
    kc_v3_copy(T.p_m, loads->origin_m[KC_FRAME_TOOL]);

    add_mass(&payload, ctx->payload_kg, T.p_m);
    add_mass(&all, ctx->payload_kg, T.p_m);
    for (uint32_t i = n + 1u; i-- > 0u;) { /* from the tool to the base, masses added up */
        double m[3];
        moment_about(&all, frame[i].p_m, ctx->g_m_s2, m);
        kc_m3t_mul_v3(frame[i].R, m, loads->moment[i]);
        if (i < n) {
            loads->tau[i] = joint_load(&arm->joint[i], &frame[i], &all, ctx->g_m_s2);
            loads->tau_payload[i] = joint_load(&arm->joint[i], &frame[i], &payload, ctx->g_m_s2);
        }
        if (i > 0u) { link_mass(&arm->joint[i - 1u], &frame[i], &all); }
    }
}

/* A motion along an axis and about it, with sine and cosine of its angle. */
typedef struct {
    double shift_m, angle_rad, sine, cosine;
} screw_t;

static void set_screw(screw_t *s, double shift_m, double angle_rad)
{
    s->shift_m = shift_m;
    s->angle_rad = angle_rad;
    if (!kc_is_zero(angle_rad)) { kc_sincos(angle_rad, &s->sine, &s->cosine); }
}

/* Screws at frame i. x: the link before it and the twist (no link before frame 0); y: the twist; z: twist, joint and
 * offset after it (no joint after the last frame). One screw does what is on one line. */
typedef struct {
    screw_t x[KC_JOINT_MAX + 1u], y[KC_JOINT_MAX + 1u], z[KC_JOINT_MAX + 1u];
} screws_t;

static const kc_joint_t NO_JOINT; /* beyond the ends of the chain */

/* All sines and cosines are worked out before the walk, where one depends on the other: so they overlap. */
static void set_screws(const kc_arm_t *arm, const kc_ctx_t *ctx, const twists_t tw, screws_t *screws)
{
    for (uint32_t i = 0u; i <= arm->n_joints; i++) {
        const kc_joint_t *before = i > 0u ? &arm->joint[i - 1u] : &NO_JOINT;
        const kc_joint_t *after = i < arm->n_joints ? &arm->joint[i] : &NO_JOINT;
        const double q = i < arm->n_joints ? ctx->q[i] : 0.0;
        const bool turns = after->type == KC_REVOLUTE;
        set_screw(&screws->x[i], tw[i][0] + before->a_m, tw[i][3] + before->alpha_rad);
        set_screw(&screws->y[i], tw[i][1], tw[i][4]);
        set_screw(&screws->z[i], tw[i][2] + after->d_m + (turns ? 0.0 : q),
                  tw[i][5] + after->phi_rad + (turns ? q : 0.0));
    }
}

static inline void apply_screw(const screw_t *s, uint32_t axis, kc_pose_t *T)
{
    if (!kc_is_zero(s->shift_m)) { kc_pose_shift(T, axis, s->shift_m); }
    if (!kc_is_zero(s->angle_rad)) { kc_pose_turn(T, axis, s->sine, s->cosine); }
}

/* Pose of the tool, and the lines of z of frame 0 .. n; want_J: all lines on the arm. */
static void walk_chain(const kc_arm_t *arm, const kc_ctx_t *ctx, const twists_t tw, bool want_J,
                       kc_eval_t *ev)
{
    kc_pose_t T, tool;
    screws_t screws;
    set_screws(arm, ctx, tw, &screws);
    kc_pose_from_quat(arm->base_xyz_m, arm->base_quat_wxyz, &T);
    for (uint32_t i = 0u; i <= arm->n_joints; i++) {
        kc_line_t *line = ev->line[i];
        if (want_J) { keep_line(&T, 0u, &line[0]); }
        apply_screw(&screws.x[i], 0u, &T);
        if (want_J) { keep_line(&T, 1u, &line[1]); }
        apply_screw(&screws.y[i], 1u, &T);
        keep_line(&T, 2u, &line[2]);
        apply_screw(&screws.z[i], 2u, &T);
    }
    kc_pose_from_quat(arm->tool_xyz_m, arm->tool_quat_wxyz, &tool);
    kc_pose_mul(&T, &tool, &ev->T);
    apply_twist(&ev->T, tw[KC_FRAME_TOOL], want_J ? ev->line[KC_FRAME_TOOL] : NULL);
}

/* Along the link and through the twists about x and y of the frame at its end; joint NULL: frame 0 has no link. */
static void link_screws(const kc_joint_t *joint, const double tw[6], kc_pose_t *T)
{
    kc_pose_screw(T, 0u, tw[0] + (joint != NULL ? joint->a_m : 0.0),
                  tw[3] + (joint != NULL ? joint->alpha_rad : 0.0));
    kc_pose_screw(T, 1u, tw[1], tw[4]);
}

void kc_model_frames(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                     const kc_loads_t *loads, kc_pose_t *frame, double *along_m, double *across_m)
{
    twists_t tw;
    kc_pose_t T, tool;
    sum_twists(terms, coef, ctx, loads, tw, NULL);
    kc_pose_from_quat(arm->base_xyz_m, arm->base_quat_wxyz, &T);
    link_screws(NULL, tw[0], &T);
    for (uint32_t i = 1u; i <= arm->n_joints; i++) {
        const kc_joint_t *joint = &arm->joint[i - 1u];
        const bool slides = joint->type == KC_PRISMATIC;
        along_m[i] = tw[i - 1u][2];
        across_m[i] = tw[i][0];
        kc_pose_screw(&T, 2u, tw[i - 1u][2] + (slides ? ctx->q[i - 1u] : 0.0),
                      tw[i - 1u][5] + joint->phi_rad + (slides ? 0.0 : ctx->q[i - 1u]));
        frame[i] = T;
        kc_pose_screw(&T, 2u, joint->d_m, 0.0);
        link_screws(joint, tw[i], &T);
    }
    kc_pose_screw(&T, 2u, tw[arm->n_joints][2], tw[arm->n_joints][5]);
    along_m[0] = 0.0;
    across_m[0] = 0.0;
    kc_pose_from_quat(arm->tool_xyz_m, arm->tool_quat_wxyz, &tool);
    kc_pose_mul(&T, &tool, &frame[0]);
    apply_twist(&frame[0], tw[KC_FRAME_TOOL], NULL);
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

/* What the lines of a frame move. */
static const double *moved_point(const kc_eval_t *ev, uint32_t frame)
{
    return frame >= KC_FRAME_CAMERA ? ev->measured_m : ev->T.p_m;
}

void kc_model_twist(const kc_eval_t *ev, uint32_t frame, uint32_t comp, double row[6])
{
    if (comp < KC_RX) {
        kc_v3_copy(ev->line[frame][comp].axis, row);
        memset(row + 3, 0, 3u * sizeof(double));
    } else {
        const kc_line_t *line = &ev->line[frame][comp - KC_RX];
        moved_by_turn(line, moved_point(ev, frame), row);
        kc_v3_copy(line->axis, row + 3);
    }
}

/* J[c] += weight x what the component moves (kc_model_twist), for the terms on the arm or on the camera side. */
static void add_coef_rows(const kc_terms_t *terms, const double *weight, bool camera_side, kc_eval_t *ev)
{
    const double *p = camera_side ? ev->measured_m : ev->T.p_m;
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        const kc_term_t *t = &terms->term[k];
        const double w = weight[k];
        double *row = ev->J[t->coef];
        if ((t->frame >= KC_FRAME_CAMERA) != camera_side || kc_is_zero(w)) { continue; }
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

/* Nothing of the measurement moves the residual: lines of length 0. */
static void forget_camera_side(kc_eval_t *ev)
{
    memset(ev->measured_m, 0, sizeof ev->measured_m);
    memset(ev->line[KC_FRAME_CAMERA], 0, 2u * sizeof ev->line[0]);
}

/* With J of the arm's side if weights are given. */
static void eval_with(const kc_arm_t *arm, const kc_terms_t *terms, const twists_t tw, const kc_ctx_t *ctx,
                      const double *weight, kc_eval_t *ev)
{
    walk_chain(arm, ctx, tw, weight != NULL, ev);
    set_joint_rows(arm, ev);
    if (weight == NULL) { return; }
    memset(ev->J, 0, terms->n_coef * sizeof ev->J[0]);
    add_coef_rows(terms, weight, false, ev);
}

void kc_model_eval(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_ctx_t *ctx,
                   const kc_loads_t *loads, bool want_J, kc_eval_t *ev)
{
    twists_t tw;
    double weight[KC_TERM_MAX];
    sum_twists(terms, coef, ctx, loads, tw, want_J ? weight : NULL);
    eval_with(arm, terms, tw, ctx, want_J ? weight : NULL, ev);
    if (want_J) { forget_camera_side(ev); }
}

/* Measured pose with the camera-side corrections. line: those of camera and measurement, NULL: not wanted. */
static void correct_measured(const kc_obs_t *obs, const twists_t tw, kc_pose_t *M, kc_line_t (*line)[3])
{
    kc_pose_t C, measured;
    kc_pose_from_quat(obs->p_cam_m, obs->q_cam_wxyz, &C);
    kc_pose_inv(&C, &measured);
    kc_pose_mul(&measured, M, &measured); /* T_cam_tool as measured */
    apply_twist(&C, tw[KC_FRAME_CAMERA], line != NULL ? line[0] : NULL);
    kc_pose_mul(&C, &measured, M);
    apply_twist(M, tw[KC_FRAME_MEAS], line != NULL ? line[1] : NULL);
}

/* Lines that move what was measured move the residual the other way. */
static void add_camera_side(const kc_terms_t *terms, const double *weight, const kc_pose_t *M, kc_eval_t *ev)
{
    kc_v3_copy(M->p_m, ev->measured_m);
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

uint32_t kc_model_residual(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef,
                           const kc_obs_t *obs, const kc_loads_t *loads, double r[6], kc_eval_t *ev)
{
    twists_t tw;
    double weight[KC_TERM_MAX];
    kc_pose_t M;
    sum_twists(terms, coef, &obs->ctx, loads, tw, weight);
    eval_with(arm, terms, tw, &obs->ctx, weight, ev);
    observed(obs, ev, &M);
    if (obs->has_cam) {
        correct_measured(obs, tw, &M, &ev->line[KC_FRAME_CAMERA]);
        add_camera_side(terms, weight, &M, ev);
    } else {
        forget_camera_side(ev);
    }
    return difference(obs, &M, ev, r);
}

uint32_t kc_model_miss(const kc_arm_t *arm, const kc_terms_t *terms, const double *coef, const kc_obs_t *obs,
                       const kc_loads_t *loads, double r[6], kc_eval_t *ev)
{
    twists_t tw;
    kc_pose_t M;
    sum_twists(terms, coef, &obs->ctx, loads, tw, NULL);
    eval_with(arm, terms, tw, &obs->ctx, NULL, ev);
    observed(obs, ev, &M);
    if (obs->has_cam) { correct_measured(obs, tw, &M, NULL); }
    return difference(obs, &M, ev, r);
}
