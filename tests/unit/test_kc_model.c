/* kc_model.c: what the contract says; numbers against other libraries are in tests/oracle. */
#include <math.h>
#include <string.h>

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

void setUp(void);
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

static void assert_doubles(const double *want, const double *got, int n, double tol)
{
    for (int i = 0; i < n; i++) { TEST_ASSERT_DOUBLE_WITHIN(tol, want[i], got[i]); }
}

void test_without_corrections_it_is_the_nominal_arm(void)
{
    kc_pose_t T;
    add_term(1u, KC_RZ, KC_VAR_ONE, 0u);
    kc_arm_fk(&s_arm, s_ctx.q, &T);
    kc_model_loads(&s_arm, &s_t, NULL, &s_ctx, &s_loads);
    kc_model_eval(&s_arm, &s_t, NULL, &s_ctx, &s_loads, true, &s_ev);
    assert_doubles(T.p_m, s_ev.T.p_m, 3, 1e-15);
    assert_doubles(T.R, s_ev.T.R, 9, 1e-15);
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
    TEST_ASSERT_EQUAL_MEMORY(zero.twist, s_ev2.twist, sizeof zero.twist);
    TEST_ASSERT_EQUAL_MEMORY(zero.J, s_ev2.J, sizeof zero.J);
    TEST_ASSERT_TRUE(s_ev.J[0][3] != 0.0 || s_ev.J[0][4] != 0.0 || s_ev.J[0][5] != 0.0);
}

void test_terms_of_one_coefficient_add_up(void)
{
    double sum[6];
    add_term(1u, KC_RX, KC_VAR_Q, 3u);
    add_term(2u, KC_TY, KC_VAR_ONE, 0u);
    s_t.term[1].coef = 0u;
    s_t.term[1].gain = -2.0;
    s_t.n_coef = 1u;
    kc_model_loads(&s_arm, &s_t, s_coef, &s_ctx, &s_loads);
    kc_model_eval(&s_arm, &s_t, s_coef, &s_ctx, &s_loads, true, &s_ev);
    for (int i = 0; i < 6; i++) { sum[i] = 0.9 * s_ev.twist[6 + KC_RX][i] - 2.0 * s_ev.twist[12 + KC_TY][i]; }
    assert_doubles(sum, s_ev.J[0], 6, 1e-15);
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
    assert_doubles(zero, r, 6, 1e-15);
}

void test_a_camera_that_stands_further_along_moves_what_it_saw(void)
{
    double r[6];
    const double want_r[6] = {0.02, 0.0, 0.0, 0.0, 0.0, 0.0}, want_J[6] = {-1.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    const kc_obs_t obs = given_observation();
    add_term(KC_FRAME_CAMERA, KC_TX, KC_VAR_ONE, 0u);
    s_coef[0] = 0.02;
    (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
    assert_doubles(want_r, r, 6, 1e-15);
    assert_doubles(want_J, s_ev.J[0], 6, 1e-15);
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
    assert_doubles(zero, s_ev.J[0], 6, 0.0);
    assert_doubles(zero, s_ev.J[1], 6, 0.0);
    obs.has_cam = 0u;
    (void)kc_model_residual(&s_arm, &s_t, s_coef, &obs, &s_loads, r, &s_ev);
    assert_doubles(zero, r, 6, 1e-15);
    assert_doubles(zero, s_ev.J[0], 6, 0.0);
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
    assert_doubles(want, r, 6, 1e-15);
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
        assert_doubles(T.p_m, frame[j + 1u].p_m, 3, 1e-15);
        assert_doubles(T.R, frame[j + 1u].R, 9, 1e-15);
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
    assert_doubles(s_ev.T.p_m, frame[0].p_m, 3, 0.0);
    assert_doubles(s_ev.T.R, frame[0].R, 9, 0.0);
    assert_doubles(before[1].R, frame[1].R, 9, 0.0); /* the correction is beyond joint 1 */
    TEST_ASSERT_TRUE(fabs(frame[3].p_m[0] - before[3].p_m[0]) > 1e-3);
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

/* Levers against the torque that flight works out itself from a mass: 1 kg at the tool is a payload of 1 kg. */
void test_the_lever_of_the_tool_is_the_torque_of_a_payload_of_one_kilogram(void)
{
    add_term(1u, KC_RZ, KC_VAR_ONE, 0u);
    s_ctx.payload_kg = 1.0;
    s_ctx.g_m_s2[0] = 2.0;
    kc_model_loads(&s_arm, &s_t, NULL, &s_ctx, &s_loads);
    for (uint32_t joint = 1u; joint <= s_arm.n_joints; joint++) {
        if (s_arm.joint[joint - 1u].type == KC_PRISMATIC) { continue; }
        const kc_basis_t b = {KC_FN_LIN, KC_VAR_LEVZ, (uint8_t)KC_LEVER_INDEX(joint - 1u, KC_LEVER_TOOL), 0.0,
                              1.0};
        TEST_ASSERT_DOUBLE_WITHIN(1e-13, s_loads.tau_payload[joint - 1u],
                                  kc_basis_eval(&b, &s_ctx, &s_loads));
    }
}

void test_gravity_along_a_sliding_joint_is_the_force_of_one_kilogram(void)
{
    add_term(1u, KC_RZ, KC_VAR_ONE, 0u);
    s_ctx.payload_kg = 1.0;
    s_ctx.g_m_s2[0] = 2.0;
    kc_model_loads(&s_arm, &s_t, NULL, &s_ctx, &s_loads);
    for (uint32_t joint = 1u; joint <= s_arm.n_joints; joint++) {
        if (s_arm.joint[joint - 1u].type != KC_PRISMATIC) { continue; }
        TEST_ASSERT_DOUBLE_WITHIN(1e-14, s_loads.tau_payload[joint - 1u], s_loads.g_link_m_s2[joint - 1u][2]);
    }
}
