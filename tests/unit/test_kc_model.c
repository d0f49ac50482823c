/* kc_model.c: what the contract says; numbers against other libraries are in tests/oracle. */
#include <math.h>
#include <string.h>

#include "given_dense.h"
#include "given_small_arm.h"
#include "kc_model.h"
#include "unity.h"

static kc_arm_t s_arm;
static kc_terms_t s_t;
static kc_ctx_t s_ctx;
static kc_loads_t s_loads;
static kc_eval_t s_ev, s_ev2;
static double s_coef[KC_COEF_MAX];

static void add_term(uint8_t frame, uint8_t comp, uint8_t var, uint8_t index)
{
    kc_coef_t *coef = &s_t.coef[s_t.n_coef];
    kc_term_t *term = &s_t.term[s_t.n_term];
    memcpy(coef->name, "c", 2);
    coef->scale = 1.0;
    term->coef = (uint16_t)s_t.n_coef;
    term->frame = frame;
    term->comp = comp;
    term->gain = 1.0;
    term->basis[0].var = var;
    term->basis[0].index = index;
    term->basis[0].c1 = 1.0;
    s_t.n_coef++;
    s_t.n_term++;
}

void setUp(void)
{
    given_small_arm(&s_arm);
    memset(&s_t, 0, sizeof s_t);
    memset(&s_ctx, 0, sizeof s_ctx);
    memset(s_coef, 0, sizeof s_coef);
    s_ctx.q[0] = 0.4;
    s_ctx.q[1] = -0.2;
    s_ctx.q[2] = 0.9;
    s_ctx.g_m_s2[2] = -9.81;
}

void test_without_corrections_it_is_the_nominal_arm(void)
{
    kc_pose_t T;
    add_term(1u, KC_RZ, KC_VAR_ONE, 0u);
    kc_arm_fk(&s_arm, s_ctx.q, &T);
    kc_model_loads(&s_arm, &s_t, NULL, &s_ctx, &s_loads);
    kc_model_eval(&s_arm, &s_t, NULL, &s_ctx, &s_loads, true, &s_ev);
    expect_doubles(T.p_m, s_ev.T.p_m, 3, 1e-15);
    expect_doubles(T.R, s_ev.T.R, 9, 1e-15);
}

void test_without_want_J_the_pose_is_the_same_and_the_rows_are_zero(void)
{
    static const kc_eval_t zero;
    add_term(1u, KC_RZ, KC_VAR_Q, 2u);
    s_coef[0] = 0.3;
    kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &s_loads);
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, true, &s_ev);
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, false, &s_ev2);
    TEST_ASSERT_EQUAL_MEMORY(&s_ev.T, &s_ev2.T, sizeof s_ev.T);
    TEST_ASSERT_EQUAL_MEMORY(s_ev.Jq, s_ev2.Jq, sizeof s_ev.Jq);
    for (uint32_t frame = 0u; frame < KC_FRAME_COUNT; frame++) { /* of z: joints need it */
        TEST_ASSERT_EQUAL_MEMORY(zero.line, s_ev2.line[frame], 2u * sizeof zero.line[0][0]);
    }
    TEST_ASSERT_EQUAL_MEMORY(zero.J, s_ev2.J, sizeof zero.J);
    TEST_ASSERT_TRUE(s_ev.J[0][3] != 0.0 || s_ev.J[0][4] != 0.0 || s_ev.J[0][5] != 0.0);
}

void test_terms_of_one_coefficient_add_up(void)
{
    double sum[6], rx[6], ty[6];
    add_term(1u, KC_RX, KC_VAR_Q, 3u);
    add_term(2u, KC_TY, KC_VAR_ONE, 0u);
    s_t.term[1].coef = 0u;
    s_t.term[1].gain = -2.0;
    s_t.n_coef = 1u;
    kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &s_loads);
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, true, &s_ev);
    kc_model_twist(&s_ev, 1u, KC_RX, rx);
    kc_model_twist(&s_ev, 2u, KC_TY, ty);
    for (int i = 0; i < 6; i++) { sum[i] = 0.9 * rx[i] - 2.0 * ty[i]; }
    expect_doubles(sum, s_ev.J[0], 6, 1e-15);
}

void test_links_without_mass_weigh_nothing(void)
{
    for (uint32_t j = 0u; j < 3u; j++) { s_arm.joint[j].has_mass = 0u; }
    kc_model_loads(&s_arm, &s_t, NULL, &s_ctx, &s_loads);
    for (uint32_t j = 0u; j < 3u; j++) {
        TEST_ASSERT_EQUAL_DOUBLE(0.0, s_loads.tau[j]);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, s_loads.tau_payload[j]);
    }
    s_ctx.payload_kg = 2.0;
    kc_model_loads(&s_arm, &s_t, NULL, &s_ctx, &s_loads);
    for (uint32_t j = 0u; j < 3u; j++) { TEST_ASSERT_EQUAL_DOUBLE(s_loads.tau_payload[j], s_loads.tau[j]); }
}

void test_the_torque_of_a_turning_joint_is_the_moment_about_its_axis(void)
{
    s_ctx.payload_kg = 1.5;
    kc_model_loads(&s_arm, &s_t, NULL, &s_ctx, &s_loads);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, s_loads.moment[0][2], s_loads.tau[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-14, s_loads.moment[2][2], s_loads.tau[2]);
    TEST_ASSERT_TRUE(fabs(s_loads.moment[1][2] - s_loads.tau[1]) > 1e-3); /* prismatic: a force */
}

void test_terms_that_depend_on_loads_do_not_change_the_loads(void)
{
    static kc_loads_t plain;
    static const uint8_t var[5] = {KC_VAR_TAU, KC_VAR_MX, KC_VAR_MY, KC_VAR_MZ, KC_VAR_TAU_PAYLOAD};
    kc_model_loads(&s_arm, &s_t, NULL, &s_ctx, &plain);
    for (int k = 0; k < 5; k++) {
        add_term(1u, KC_RZ, var[k], 1u);
        s_coef[k] = 0.1;
    }
    s_t.term[0].basis[1] = s_t.term[0].basis[0]; /* as second factor too */
    s_t.term[0].basis[0].var = KC_VAR_ONE;
    kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &s_loads);
    TEST_ASSERT_EQUAL_MEMORY(&plain, &s_loads, sizeof plain);
    add_term(1u, KC_RZ, KC_VAR_ONE, 0u);
    s_coef[5] = 0.1;
    kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &s_loads);
    TEST_ASSERT_TRUE(fabs(plain.tau[0] - s_loads.tau[0]) > 1e-6);
}

/* Loads count where a term that depends on them moves the arm or is estimated; else they are zero, and the pose is that
 * of any loads. */
void test_loads_are_computed_where_a_term_needs_them(void)
{
    static kc_loads_t full, needed;
    static const kc_loads_t none;
    static const struct {
        uint8_t first, second, enabled;
        double coef;
        bool needed;
    } row[] = {
        {KC_VAR_ONE, KC_VAR_ONE, 1u, 0.1, false}, {KC_VAR_Q, KC_VAR_ONE, 1u, 0.1, false},
        {KC_VAR_ONE, KC_VAR_Q, 1u, 0.1, false},   {KC_VAR_TAU, KC_VAR_ONE, 0u, 0.0, false},
        {KC_VAR_TAU, KC_VAR_ONE, 1u, 0.0, true},  {KC_VAR_TAU, KC_VAR_ONE, 0u, 0.1, true},
        {KC_VAR_TAU, KC_VAR_ONE, 0u, NAN, true},  {KC_VAR_ONE, KC_VAR_LEVZ, 0u, -0.1, true},
        {KC_VAR_Q, KC_VAR_GX, 1u, 0.0, true},
    };
    for (size_t k = 0u; k < sizeof row / sizeof row[0]; k++) {
        s_t.n_coef = s_t.n_term = 0u;
        add_term(1u, KC_RZ, row[k].first, 1u);
        s_t.coef[0].enabled = row[k].enabled;
        s_t.term[0].basis[1].var = row[k].second;
        s_t.term[0].basis[1].c1 = 1.0;
        s_coef[0] = row[k].coef;
        kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &full);
        memset(&needed, 0x7f, sizeof needed);
        kc_model_needed_loads(&s_arm, &s_t, s_coef, &s_ctx, &needed);
        TEST_ASSERT_TRUE(full.tau[0] != 0.0 || full.tau[1] != 0.0);
        TEST_ASSERT_EQUAL_MEMORY(row[k].needed ? &full : &none, &needed, sizeof needed);
        if (row[k].needed) { continue; }
        kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &full, false, &s_ev);
        kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &needed, false, &s_ev2);
        TEST_ASSERT_EQUAL_MEMORY(&s_ev.T, &s_ev2.T, sizeof s_ev.T);
    }
    s_t.coef[0].enabled = 0u;
    kc_model_needed_loads(&s_arm, &s_t, NULL, &s_ctx, &needed);
    TEST_ASSERT_EQUAL_MEMORY(&none, &needed, sizeof needed);
    s_t.coef[0].enabled = 1u;
    kc_model_needed_loads(&s_arm, &s_t, NULL, &s_ctx, &needed);
    TEST_ASSERT_EQUAL_DOUBLE(full.tau[1], needed.tau[1]);
}

/* Observation of the arm with its coefficients, from a camera. */
static kc_obs_t given_observation(void)
{
    kc_obs_t obs;
    memset(&obs, 0, sizeof obs);
    obs.ctx = s_ctx;
    kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &s_loads);
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, false, &s_ev);
    memcpy(obs.p_m, s_ev.T.p_m, sizeof obs.p_m);
    kc_R_to_quat(s_ev.T.R, obs.q_wxyz);
    obs.p_cam_m[0] = -1.0;
    obs.q_cam_wxyz[0] = 1.0;
    obs.has_rot = obs.has_cam = 1u;
    return obs;
}

void test_a_perfect_observation_has_no_residual(void)
{
    static const double zero[6];
    double r[6];
    add_term(2u, KC_TX, KC_VAR_ONE, 0u);
    s_coef[0] = 0.05;
    const kc_obs_t obs = given_observation();
    TEST_ASSERT_EQUAL_UINT32(6u, kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev));
    expect_doubles(zero, r, 6, 1e-15);
}

void test_a_camera_that_stands_further_along_moves_what_it_saw(void)
{
    double r[6];
    const double want_r[6] = {0.02, 0.0, 0.0, 0.0, 0.0, 0.0}, want_J[6] = {-1.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    const kc_obs_t obs = given_observation();
    add_term(KC_FRAME_CAMERA, KC_TX, KC_VAR_ONE, 0u);
    s_coef[0] = 0.02;
    (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
    expect_doubles(want_r, r, 6, 1e-15);
    expect_doubles(want_J, s_ev.J[0], 6, 1e-15);
}

void test_twists_of_the_camera_side_are_what_its_coefficients_move(void)
{
    static const uint8_t comp[2] = {KC_TY, KC_RX};
    double r[6], row[6];
    const kc_obs_t obs = given_observation();
    for (uint32_t k = 0u; k < 2u; k++) { add_term(KC_FRAME_CAMERA, comp[k], KC_VAR_ONE, 0u); }
    (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
    for (uint32_t k = 0u; k < 2u; k++) {
        kc_model_twist(&s_ev, KC_FRAME_CAMERA, comp[k], row);
        expect_doubles(s_ev.J[k], row, 6, 1e-15);
        TEST_ASSERT_TRUE(kc_v3_norm(row) > 0.1);
    }
}

void test_the_arm_side_does_not_see_camera_terms(void)
{
    static const double zero[6];
    add_term(KC_FRAME_CAMERA, KC_RX, KC_VAR_ONE, 0u);
    add_term(KC_FRAME_MEAS, KC_TX, KC_VAR_ONE, 0u);
    s_coef[0] = s_coef[1] = 0.1;
    kc_obs_t obs = given_observation();
    double r[6];
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, true, &s_ev);
    expect_doubles(zero, s_ev.J[0], 6, 0.0);
    expect_doubles(zero, s_ev.J[1], 6, 0.0);
    obs.has_cam = 0u;
    (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
    expect_doubles(zero, r, 6, 1e-15);
    expect_doubles(zero, s_ev.J[0], 6, 0.0);
}

/* As many terms that are not constant on the arm as on the camera side. */
void test_terms_that_vary_move_the_arm_and_the_camera_side(void)
{
    add_term(1u, KC_RZ, KC_VAR_Q, 1u);
    add_term(KC_FRAME_CAMERA, KC_TX, KC_VAR_Q, 1u);
    kc_obs_t obs = given_observation();
    double r[6];
    kc_pose_t nominal = s_ev.T;
    s_coef[0] = s_coef[1] = 0.1;
    (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
    TEST_ASSERT_TRUE(fabs(s_ev.T.p_m[0] - nominal.p_m[0]) > 1e-3);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.1 * s_ctx.q[0], s_ev.measured_m[0] - nominal.p_m[0]);
}

/* Whatever the evaluation before has left there. */
void test_without_a_camera_pose_nothing_of_the_measurement_moves_the_residual(void)
{
    static const double zero[6];
    kc_obs_t obs = given_observation();
    double r[6];
    obs.has_cam = 0u;
    memset(&s_ev, 0x3f, sizeof s_ev);
    (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
    for (uint32_t i = 6u * KC_FRAME_CAMERA; i < 6u * KC_FRAME_COUNT; i++) {
        double row[6];
        kc_model_twist(&s_ev, i / 6u, i % 6u, row);
        expect_doubles(zero, row, 6, 0.0);
    }
}

void test_position_only_has_three_rows_and_no_rotation_part(void)
{
    const double want[6] = {0.01, 0.0, -0.02, 0.0, 0.0, 0.0};
    kc_obs_t obs = given_observation();
    double r[6];
    obs.has_rot = 0u;
    obs.has_cam = 0u;
    obs.p_m[0] += 0.01;
    obs.p_m[2] -= 0.02;
    memset(obs.q_wxyz, 0x7f, sizeof obs.q_wxyz);
    TEST_ASSERT_EQUAL_UINT32(3u, kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev));
    expect_doubles(want, r, 6, 1e-15);
}

/* Nothing is known of the turn of what was measured: it has that of the model. */
void test_a_position_is_corrected_along_the_axes_that_the_model_has_there(void)
{
    double r[6];
    add_term(KC_FRAME_MEAS, KC_TY, KC_VAR_ONE, 0u);
    kc_obs_t obs = given_observation();
    obs.has_rot = 0u;
    memset(obs.q_wxyz, 0x7f, sizeof obs.q_wxyz);
    s_coef[0] = 0.02;
    TEST_ASSERT_EQUAL_UINT32(3u, kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev));
    for (uint32_t k = 0u; k < 3u; k++) {
        const double axis = s_ev.T.R[3u * k + 1u];
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.02 * axis, r[k]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, -axis, s_ev.J[0][k]);
        TEST_ASSERT_EQUAL_DOUBLE(0.0, r[3u + k]);
    }
    for (uint8_t comp = KC_RX; comp <= KC_RZ; comp++) { /* a turn of what was measured says nothing */
        add_term(KC_FRAME_MEAS, comp, KC_VAR_ONE, 0u);
        s_coef[s_t.n_coef - 1u] = 0.1;
    }
    (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
    for (uint32_t k = 3u; k < 6u; k++) { TEST_ASSERT_EQUAL_DOUBLE(0.0, r[k]); }
}

/* What was seen stands off by known amounts: those come back, with and without rotation and camera; what would be the
 * Jacobian is left as it is. */
void test_the_miss_is_what_was_seen_less_the_model_without_a_jacobian(void)
{
    const double off[3] = {0.01, -0.03, 0.02};
    add_term(2u, KC_TX, KC_VAR_ONE, 0u);
    add_term(KC_FRAME_CAMERA, KC_TY, KC_VAR_ONE, 0u);
    add_term(KC_FRAME_MEAS, KC_TZ, KC_VAR_Q, 0u);
    s_coef[0] = 0.05;
    for (uint8_t kind = 0u; kind < 4u; kind++) {
        double r[6], same[6];
        s_coef[1] = s_coef[2] = 0.0;
        kc_obs_t obs = given_observation();
        obs.has_rot = kind & 1u;
        obs.has_cam = kind >> 1u;
        for (uint32_t i = 0u; i < 3u; i++) { obs.p_m[i] += off[i]; }
        s_coef[1] = 0.02;
        memset(&s_ev, 0, sizeof s_ev);
        s_ev.J[0][0] = s_ev.line[1][1].axis[0] = 7.0;
        TEST_ASSERT_EQUAL_UINT32(obs.has_rot ? 6u : 3u,
                                 kc_model_miss(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev));
        for (uint32_t i = 0u; i < 3u; i++) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-15, off[i] + (obs.has_cam && i == 1u ? 0.02 : 0.0), r[i]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.0, r[3u + i]);
        }
        TEST_ASSERT_EQUAL_DOUBLE(7.0, s_ev.J[0][0]);
        TEST_ASSERT_EQUAL_DOUBLE(7.0, s_ev.line[1][1].axis[0]);
        s_coef[2] = 0.1;
        (void)kc_model_miss(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
        (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, same, &s_ev2);
        TEST_ASSERT_EQUAL_MEMORY(same, r, sizeof r);
        TEST_ASSERT_EQUAL_MEMORY(&s_ev2.T, &s_ev.T, sizeof s_ev.T);
        TEST_ASSERT_EQUAL_MEMORY(s_ev2.Jq, s_ev.Jq, sizeof s_ev.Jq);
    }
}

/* ---- frames ---- */

/* Across the link alone, its joint standing at zero, and then the next joint's own turn or slide. */
static void next_frame(kc_pose_t *T, uint32_t j)
{
    kc_joint_t link = s_arm.joint[j - 1u], next = s_arm.joint[j];
    link.phi_rad = 0.0;
    kc_arm_link(&link, 0.0, T);
    next.alpha_rad = next.a_m = next.d_m = 0.0;
    kc_arm_link(&next, s_ctx.q[j], T);
}

void test_frames_stand_on_the_axes_and_turn_or_slide_with_their_joint(void)
{
    kc_pose_t frame[KC_JOINT_MAX + 1u], T;
    double along_m[KC_JOINT_MAX + 1u], across_m[KC_JOINT_MAX + 1u];
    kc_model_frames(&s_arm, &s_t, NULL, &s_ctx, NULL, frame, along_m, across_m);
    for (uint32_t j = 1u; j < s_arm.n_joints; j++) {
        T = frame[j];
        next_frame(&T, j);
        expect_doubles(T.p_m, frame[j + 1u].p_m, 3, 1e-15);
        expect_doubles(T.R, frame[j + 1u].R, 9, 1e-15);
    }
}

void test_the_tool_frame_is_the_corrected_tool(void)
{
    kc_pose_t frame[KC_JOINT_MAX + 1u], before[KC_JOINT_MAX + 1u];
    double along_m[KC_JOINT_MAX + 1u], across_m[KC_JOINT_MAX + 1u];
    add_term(1u, KC_RZ, KC_VAR_ONE, 0u);
    add_term(KC_FRAME_TOOL, KC_TX, KC_VAR_ONE, 0u);
    kc_model_frames(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, before, along_m, across_m);
    s_coef[0] = 0.2;
    s_coef[1] = 0.03;
    kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &s_loads);
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, false, &s_ev);
    kc_model_frames(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, frame, along_m, across_m);
    expect_doubles(s_ev.T.p_m, frame[0].p_m, 3, 0.0);
    expect_doubles(s_ev.T.R, frame[0].R, 9, 0.0);
    expect_doubles(before[1].R, frame[1].R, 9, 0.0); /* the correction is beyond joint 1 */
    TEST_ASSERT_TRUE(fabs(frame[3].p_m[0] - before[3].p_m[0]) > 1e-3);
}

/* Every correction that can be, at the base, at each link and at the tool. */
void test_the_tool_frame_has_every_correction(void)
{
    static const uint8_t at[] = {0u, 1u, 2u, 3u, KC_FRAME_TOOL};
    kc_pose_t frame[KC_JOINT_MAX + 1u];
    double along_m[KC_JOINT_MAX + 1u], across_m[KC_JOINT_MAX + 1u];
    for (uint8_t k = 0u; k < 30u; k++) { add_term(at[k / 6u], k % 6u, KC_VAR_ONE, 0u); }
    for (uint32_t k = 0u; k <= 30u; k++) { /* each alone, then all of them */
        for (uint32_t c = 0u; c < 30u; c++) { s_coef[c] = k == 30u || c == k ? 0.02 + 0.003 * c : 0.0; }
        kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &s_loads);
        kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, false, &s_ev);
        kc_model_frames(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, frame, along_m, across_m);
        expect_doubles(s_ev.T.p_m, frame[0].p_m, 3, 1e-14);
        expect_doubles(s_ev.T.R, frame[0].R, 9, 1e-14);
        TEST_ASSERT_TRUE(isfinite(along_m[0]) && isfinite(across_m[0]));
    }
}

void test_frames_say_how_far_corrections_move_them_along_and_across_their_axis(void)
{
    kc_pose_t frame[KC_JOINT_MAX + 1u], before[KC_JOINT_MAX + 1u];
    double along_m[KC_JOINT_MAX + 1u], across_m[KC_JOINT_MAX + 1u];
    add_term(1u, KC_TZ, KC_VAR_ONE, 0u);
    add_term(1u, KC_TX, KC_VAR_ONE, 1u);
    add_term(KC_FRAME_TOOL, KC_TZ, KC_VAR_ONE, 2u);
    memset(s_coef, 0, sizeof s_coef);
    kc_model_frames(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, before, along_m, across_m);
    for (uint32_t j = 0u; j <= s_arm.n_joints; j++) { TEST_ASSERT_EQUAL_DOUBLE(0.0, along_m[j]); }
    s_coef[0] = 0.03;
    kc_model_frames(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, frame, along_m, across_m);
    TEST_ASSERT_EQUAL_DOUBLE(0.03, along_m[2]); /* what turns with joint 2 stands beyond link 1 */
    for (uint32_t i = 0u; i < 3u; i++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-15, before[2].p_m[i], frame[2].p_m[i] - 0.03 * frame[2].R[3u * i + 2u]);
    }
    s_coef[0] = 0.0;
    s_coef[1] = s_coef[2] = 0.05; /* across the axis, and of the tool: not along a joint's axis */
    kc_model_frames(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, frame, along_m, across_m);
    for (uint32_t j = 0u; j <= s_arm.n_joints; j++) {
        TEST_ASSERT_EQUAL_DOUBLE(0.0, along_m[j]);
        TEST_ASSERT_EQUAL_DOUBLE(j == 1u ? 0.05 : 0.0, across_m[j]); /* of link 1 */
    }
}

/* Levers against the torque that flight works out itself from a mass: 1 kg at the tool is a payload of 1 kg; along a
 * sliding joint gravity is its force. */
void test_the_lever_of_the_tool_is_the_torque_of_a_payload_of_one_kilogram(void)
{
    add_term(1u, KC_RZ, KC_VAR_ONE, 0u);
    s_ctx.payload_kg = 1.0;
    s_ctx.g_m_s2[0] = 2.0;
    kc_model_loads(&s_arm, &s_t, NULL, &s_ctx, &s_loads);
    for (uint32_t joint = 1u; joint <= s_arm.n_joints; joint++) {
        if (s_arm.joint[joint - 1u].type == KC_PRISMATIC) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-14, s_loads.tau_payload[joint - 1u],
                                      s_loads.g_link_m_s2[joint - 1u][2]);
            continue;
        }
        const kc_basis_t b = {KC_FN_LIN, KC_VAR_LEVZ, (uint8_t)KC_LEVER_INDEX(joint - 1u, KC_LEVER_TOOL), 0.0,
                              1.0};
        TEST_ASSERT_DOUBLE_WITHIN(1e-13, s_loads.tau_payload[joint - 1u],
                                  kc_basis_eval(&b, &s_ctx, &s_loads));
    }
}

/* ---- against differences ---- */

/* A coefficient for each component of each frame, none of them zero. */
static void given_a_correction_everywhere(void)
{
    static const uint8_t frame[] = {0u, 1u, 2u, 3u, KC_FRAME_TOOL, KC_FRAME_CAMERA, KC_FRAME_MEAS};
    for (uint32_t f = 0u; f < sizeof frame; f++) {
        for (uint8_t comp = KC_TX; comp <= KC_RZ; comp++) {
            s_coef[s_t.n_coef] = 0.02 * sin(1.0 + 1.7 * (double)s_t.n_coef);
            add_term(frame[f], comp, KC_VAR_ONE, 0u);
        }
    }
}

static void residual_at(const kc_obs_t *obs, uint32_t c, double step, double r[6])
{
    const double old = s_coef[c];
    s_coef[c] = old + step;
    (void)kc_model_residual(&s_arm, &s_t, s_coef, obs, &s_loads, r, &s_ev2);
    s_coef[c] = old;
}

void test_the_jacobian_of_every_coefficient_is_that_of_differences(void)
{
    const double step = 1e-6;
    double r[6], plus[6], minus[6];
    kc_obs_t obs = given_observation(); /* of the arm without corrections: residuals are small, not zero */
    given_a_correction_everywhere();
    obs.q_cam_wxyz[0] = 0.8;
    obs.q_cam_wxyz[1] = 0.6;
    (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
    for (uint32_t c = 0u; c < s_t.n_coef; c++) {
        residual_at(&obs, c, step, plus);
        residual_at(&obs, c, -step, minus);
        TEST_ASSERT_TRUE(kc_v3_norm(s_ev.J[c]) + kc_v3_norm(&s_ev.J[c][3]) > 0.5);
        for (uint32_t k = 0u; k < 6u; k++) {
            /* of rotations to first order in the residual, which is below 0.1 rad */
            TEST_ASSERT_DOUBLE_WITHIN(k < 3u ? 1e-9 : 0.1, (minus[k] - plus[k]) / (2.0 * step), s_ev.J[c][k]);
        }
    }
}

/* The same at a residual of zero, where rotations are exact too. */
void test_the_jacobian_of_rotations_is_exact_where_nothing_is_left(void)
{
    const double step = 1e-6;
    double r[6], plus[6], minus[6];
    given_a_correction_everywhere();
    for (uint32_t c = 30u; c < 42u; c++) {
        s_coef[c] = 0.0;
    } /* camera side: the observation is made without */
    const kc_obs_t obs = given_observation();
    (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
    for (uint32_t c = 0u; c < s_t.n_coef; c++) {
        residual_at(&obs, c, step, plus);
        residual_at(&obs, c, -step, minus);
        for (uint32_t k = 0u; k < 6u; k++) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-9, (minus[k] - plus[k]) / (2.0 * step), s_ev.J[c][k]);
        }
    }
}

void test_the_joint_rows_are_those_of_differences(void)
{
    const double step = 1e-6;
    given_a_correction_everywhere();
    kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &s_loads);
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, false, &s_ev);
    for (uint32_t j = 0u; j < s_arm.n_joints; j++) {
        const double q = s_ctx.q[j];
        double moved[6];
        s_ctx.q[j] = q + step;
        kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, false, &s_ev2);
        s_ctx.q[j] = q;
        kc_pose_residual(&s_ev2.T, &s_ev.T, moved);
        for (uint32_t k = 0u; k < 6u; k++) {
            TEST_ASSERT_DOUBLE_WITHIN(1e-6, moved[k] / step, s_ev.Jq[j][k]);
        }
    }
}

/* ---- coefficients of many poses ---- */

/* On each component a constant term, and on ten of them two others, constant or not: sums that round otherwise in
 * another order. */
static void given_terms_of_every_kind(bool with_loads)
{
    static const uint8_t frame[] = {0u, 1u, 2u, 3u, KC_FRAME_TOOL, KC_FRAME_CAMERA, KC_FRAME_MEAS};
    s_t.n_coef = s_t.n_term = 0u;
    for (uint32_t k = 0u; k < 42u; k++) {
        s_coef[k] = k % 5u == 4u ? 0.0 : 0.02 * sin(1.0 + 1.7 * (double)k);
        add_term(frame[k / 6u], (uint8_t)(k % 6u), KC_VAR_ONE, 0u);
    }
    for (uint32_t k = 0u; k < 20u; k++) {
        s_coef[42u + k] = k % 4u == 3u ? 0.0 : 1e-3 * cos(1.0 + 2.3 * (double)k);
        const uint8_t var = k % 3u == 0u ? KC_VAR_Q : k % 3u == 1u && with_loads ? KC_VAR_TAU : KC_VAR_ONE;
        add_term(frame[k % 10u % 7u], (uint8_t)(k % 10u % 6u), var, (uint8_t)(1u + k % 3u)); /* twice */
    }
    s_ctx.payload_kg = 1.5;
}

/* All terms, but those that are constant become functions of a temperature, and are 1 there. */
static void given_no_term_that_is_constant(kc_terms_t *terms)
{
    *terms = s_t;
    for (uint32_t k = 0u; k < terms->n_term; k++) {
        kc_basis_t *basis = terms->term[k].basis;
        if (basis[0].var == KC_VAR_ONE && k % 7u != 0u) { /* some stay: sums of both kinds */
            basis[1] = (kc_basis_t){.fn = KC_FN_LIN, .var = KC_VAR_TEMP, .c0 = 20.0, .c1 = 1.0};
        }
    }
    s_ctx.temp_c = 21.0;
}

static void assert_same_poses(const kc_fixed_t *fixed, const kc_terms_t *terms, const kc_obs_t *obs)
{
    static kc_eval_t one, other;
    kc_loads_t loads, fixed_loads;
    kc_pose_t frame[2][KC_JOINT_MAX + 1u];
    double r[2][6], along_m[2][KC_JOINT_MAX + 1u], across_m[2][KC_JOINT_MAX + 1u];
    kc_model_loads(&s_arm, terms, s_coef, &obs->ctx, &loads);
    kc_fixed_loads(fixed, &obs->ctx, &fixed_loads);
    TEST_ASSERT_EQUAL_MEMORY(&loads, &fixed_loads, sizeof loads);
    (void)kc_model_residual(&s_arm, terms, s_coef, obs, &loads, r[0], &one);
    (void)kc_fixed_residual(fixed, obs, &loads, r[1], &other);
    TEST_ASSERT_EQUAL_MEMORY(r[0], r[1], sizeof r[0]);
    TEST_ASSERT_EQUAL_MEMORY(&one.T, &other.T, sizeof one.T);
    TEST_ASSERT_EQUAL_MEMORY(one.Jq, other.Jq, s_arm.n_joints * sizeof one.Jq[0]);
    TEST_ASSERT_EQUAL_MEMORY(one.J, other.J, s_t.n_coef * sizeof one.J[0]);
    (void)kc_fixed_miss(fixed, obs, &loads, r[1], &other);
    TEST_ASSERT_EQUAL_MEMORY(r[0], r[1], sizeof r[0]);
    kc_fixed_eval(fixed, &obs->ctx, &loads, false, &other);
    TEST_ASSERT_EQUAL_MEMORY(&one.T, &other.T, sizeof one.T);
    kc_model_frames(&s_arm, terms, s_coef, &obs->ctx, &loads, frame[0], along_m[0], across_m[0]);
    kc_fixed_frames(fixed, &obs->ctx, &loads, frame[1], along_m[1], across_m[1]);
    TEST_ASSERT_EQUAL_MEMORY(frame[0], frame[1], (s_arm.n_joints + 1u) * sizeof frame[0][0]);
    TEST_ASSERT_EQUAL_MEMORY(along_m[0], along_m[1], (s_arm.n_joints + 1u) * sizeof along_m[0][0]);
    TEST_ASSERT_EQUAL_MEMORY(across_m[0], across_m[1], (s_arm.n_joints + 1u) * sizeof across_m[0][0]);
}

/* One kc_fixed_t for all poses, against one for each pose of terms that nothing is fixed of. */
void test_poses_of_fixed_coefficients_have_the_bits_of_each_alone(void)
{
    static kc_terms_t varying;
    static kc_fixed_t fixed;
    for (uint32_t with_loads = 0u; with_loads < 2u; with_loads++) {
        given_terms_of_every_kind(with_loads != 0u);
        given_no_term_that_is_constant(&varying);
        kc_obs_t obs = given_observation();
        obs.q_cam_wxyz[0] = 0.8;
        obs.q_cam_wxyz[1] = 0.6;
        memset(&fixed, 0x7f, sizeof fixed);
        kc_model_fix(&s_arm, &s_t, s_coef, &fixed);
        for (uint32_t k = 0u; k < 8u; k++) {
            for (uint32_t j = 0u; j < s_arm.n_joints; j++) { obs.ctx.q[j] = sin(3.0 * k + j); }
            assert_same_poses(&fixed, &varying, &obs);
        }
    }
}

void test_fixed_coefficients_that_no_load_moves_need_none(void)
{
    static kc_fixed_t fixed;
    kc_loads_t work, full;
    static const kc_loads_t none;
    given_terms_of_every_kind(false);
    kc_model_fix(&s_arm, &s_t, s_coef, &fixed);
    TEST_ASSERT_EQUAL_MEMORY(&none, kc_fixed_needed_loads(&fixed, &s_ctx, &work), sizeof none);
    given_terms_of_every_kind(true);
    kc_model_fix(&s_arm, &s_t, s_coef, &fixed);
    kc_fixed_loads(&fixed, &s_ctx, &full);
    TEST_ASSERT_EQUAL_PTR(&work, kc_fixed_needed_loads(&fixed, &s_ctx, &work));
    TEST_ASSERT_EQUAL_MEMORY(&full, &work, sizeof full);
    TEST_ASSERT_TRUE(full.tau[0] != 0.0 || full.tau[1] != 0.0);
}

/* Frame i of the corrected arm: the tool of the arm cut off there. */
static void frame_of(uint32_t i, kc_pose_t *T)
{
    static kc_eval_t ev;
    static kc_terms_t terms;
    kc_arm_t arm = s_arm;
    arm.n_joints = i;
    memset(arm.tool_xyz_m, 0, sizeof arm.tool_xyz_m);
    memset(arm.tool_quat_wxyz, 0, sizeof arm.tool_quat_wxyz);
    arm.tool_quat_wxyz[0] = 1.0;
    terms = s_t;
    for (uint32_t k = 0u; k < terms.n_term; k++) {
        if (terms.term[k].frame > i) { terms.term[k].gain = 0.0; }
    }
    kc_model_eval(&arm, &terms, s_coef, &s_ctx, &s_loads, false, &ev);
    *T = ev.T;
}

/* Work that gravity does: sum of m g . c over the links that have a mass, and the payload at the tool. */
static double work_of_gravity(bool payload_only)
{
    double sum = 0.0;
    for (uint32_t i = 1u; i <= s_arm.n_joints && !payload_only; i++) {
        const kc_joint_t *joint = &s_arm.joint[i - 1u];
        kc_pose_t T;
        frame_of(i, &T);
        for (uint32_t k = 0u; k < 3u && joint->has_mass; k++) {
            double c = T.p_m[k];
            for (uint32_t l = 0u; l < 3u; l++) { c += T.R[3u * k + l] * joint->com_m[l]; }
            sum += joint->mass_kg * s_ctx.g_m_s2[k] * c;
        }
    }
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, false, &s_ev2);
    for (uint32_t k = 0u; k < 3u; k++) { sum += s_ctx.payload_kg * s_ctx.g_m_s2[k] * s_ev2.T.p_m[k]; }
    return sum;
}

static void given_a_loaded_arm(void)
{
    given_a_correction_everywhere();
    s_ctx.g_m_s2[0] = 1.5;
    s_ctx.g_m_s2[1] = -0.7;
    s_ctx.payload_kg = 1.3;
    for (uint32_t j = 0u; j < s_arm.n_joints; j++) {
        s_arm.joint[j].has_mass = 1u;
        s_arm.joint[j].mass_kg = 2.0 + (double)j;
        for (uint32_t k = 0u; k < 3u; k++) { s_arm.joint[j].com_m[k] = 0.03 * (double)(1u + j + 2u * k); }
    }
    kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &s_loads);
}

void test_torques_do_the_work_of_gravity(void)
{
    static kc_loads_t loads;
    const double step = 1e-5;
    given_a_loaded_arm();
    loads = s_loads;
    for (uint32_t j = 0u; j < s_arm.n_joints; j++) {
        const double q = s_ctx.q[j];
        double work[2][2];
        for (uint32_t side = 0u; side < 2u; side++) {
            s_ctx.q[j] = side == 0u ? q - step : q + step;
            for (uint32_t only = 0u; only < 2u; only++) { work[side][only] = work_of_gravity(only == 1u); }
        }
        s_ctx.q[j] = q;
        TEST_ASSERT_DOUBLE_WITHIN(1e-7, (work[1][0] - work[0][0]) / (2.0 * step), loads.tau[j]);
        TEST_ASSERT_DOUBLE_WITHIN(1e-7, (work[1][1] - work[0][1]) / (2.0 * step), loads.tau_payload[j]);
    }
}

/* A body of mass m at c pulls a frame's origin o with (c - o) x m g. */
static void add_pull(const double c[3], double mass, const double o[3], double M[3])
{
    const double *g = s_ctx.g_m_s2;
    for (uint32_t k = 0u; k < 3u; k++) {
        uint32_t u = (k + 1u) % 3u, v = (k + 2u) % 3u;
        M[k] += mass * ((c[u] - o[u]) * g[v] - (c[v] - o[v]) * g[u]);
    }
}

void test_the_moment_of_a_frame_is_that_of_all_bodies_beyond_it(void)
{
    kc_pose_t at[KC_JOINT_MAX + 1u];
    given_a_loaded_arm();
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, false, &s_ev);
    for (uint32_t i = 0u; i <= s_arm.n_joints; i++) { frame_of(i, &at[i]); }
    for (uint32_t i = 0u; i <= s_arm.n_joints; i++) {
        double M[3] = {0.0, 0.0, 0.0};
        add_pull(s_ev.T.p_m, s_ctx.payload_kg, at[i].p_m, M);
        for (uint32_t b = i + 1u; b <= s_arm.n_joints; b++) {
            double c[3];
            for (uint32_t k = 0u; k < 3u; k++) {
                c[k] = at[b].p_m[k];
                for (uint32_t l = 0u; l < 3u; l++) {
                    c[k] += at[b].R[3u * k + l] * s_arm.joint[b - 1u].com_m[l];
                }
            }
            add_pull(c, s_arm.joint[b - 1u].mass_kg, at[i].p_m, M);
        }
        for (uint32_t k = 0u; k < 3u; k++) {
            double in_frame = 0.0, g = 0.0;
            for (uint32_t l = 0u; l < 3u; l++) {
                in_frame += at[i].R[3u * l + k] * M[l];
                g += at[i].R[3u * l + k] * s_ctx.g_m_s2[l];
            }
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, in_frame, s_loads.moment[i][k]);
            TEST_ASSERT_DOUBLE_WITHIN(1e-13, g, s_loads.g_link_m_s2[i][k]);
        }
    }
}

/* The lever about each axis of a link, of 1 kg at a body: a pull in that link's frame. */
void test_levers_are_the_pull_of_one_kilogram_at_a_body(void)
{
    kc_pose_t at[KC_JOINT_MAX + 1u];
    given_a_loaded_arm();
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, false, &s_ev);
    for (uint32_t i = 0u; i <= s_arm.n_joints; i++) { frame_of(i, &at[i]); }
    for (uint32_t link = 0u; link < s_arm.n_joints; link++) {
        for (uint32_t body = link + 1u; body <= s_arm.n_joints + 1u; body++) {
            bool tool = body > s_arm.n_joints;
            double M[3] = {0.0, 0.0, 0.0};
            add_pull(tool ? s_ev.T.p_m : at[body].p_m, 1.0, at[link].p_m, M);
            for (uint8_t axis = 0u; axis < 3u; axis++) {
                const uint8_t index = (uint8_t)KC_LEVER_INDEX(link, tool ? KC_LEVER_TOOL : body);
                const kc_basis_t b = {KC_FN_LIN, (uint8_t)(KC_VAR_LEVX + axis), index, 0.0, 1.0};
                double want = 0.0;
                for (uint32_t l = 0u; l < 3u; l++) { want += at[link].R[3u * l + axis] * M[l]; }
                TEST_ASSERT_DOUBLE_WITHIN(1e-12, want, kc_basis_eval(&b, &s_ctx, &s_loads));
            }
        }
    }
}
