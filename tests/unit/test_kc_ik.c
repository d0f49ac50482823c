/* kc_ik.c: the planar two-link arm has its answer in closed form; the WAM must come back to itself. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_ik.h"
#include "kc_vec.h"
#include "unity.h"

static kc_arm_t s_arm;
static kc_terms_t s_terms;
static kc_eval_t s_work;
static uint32_t s_evals;
static kc_ik_opt_t s_opt;
static double s_q[KC_JOINT_MAX];

void setUp(void)
{
    given_arm(&s_arm);
    given_terms(&s_terms);
    memset(s_q, 0, sizeof s_q);
    s_opt.iter_max = 100u;
    s_opt.tol_pos_m = 1e-7;
    s_opt.tol_rot_rad = 1e-7;
    s_opt.margin = 0.02;
    s_opt.step_max = 0.5;
}

/* Links of 0.4 m and 0.3 m turning about z. */
static void given_planar_arm(void)
{
    for (uint32_t j = 0u; j < 7u; j++) { memset(&s_arm.joint[j], 0, sizeof s_arm.joint[j]); }
    s_arm.n_joints = 2u;
    s_arm.joint[0].a_m = 0.4;
    s_arm.joint[1].a_m = 0.3;
    for (uint32_t j = 0u; j < 2u; j++) {
        s_arm.joint[j].q_min = -2.5;
        s_arm.joint[j].q_max = 2.5;
    }
    memset(s_arm.base_xyz_m, 0, sizeof s_arm.base_xyz_m);
    memset(s_arm.tool_xyz_m, 0, sizeof s_arm.tool_xyz_m);
}

static kc_pose_t planar_goal(double q1, double q2)
{
    kc_pose_t T;
    kc_pose_identity(&T);
    T.p_m[0] = 0.4 * cos(q1) + 0.3 * cos(q1 + q2);
    T.p_m[1] = 0.4 * sin(q1) + 0.3 * sin(q1 + q2);
    T.R[0] = T.R[4] = cos(q1 + q2);
    T.R[1] = -sin(q1 + q2);
    T.R[3] = sin(q1 + q2);
    return T;
}

static kc_status_t solve(const kc_pose_t *goal, const double *coef)
{
    return kc_ik_solve(&s_arm, &s_terms, coef, goal, &s_opt, s_q, &s_work, &s_evals);
}

void test_the_nominal_arm_needs_no_table_of_terms(void)
{
    double q[KC_JOINT_MAX] = {0.0};
    given_planar_arm();
    kc_pose_t goal = planar_goal(0.3, 0.9);
    s_q[1] = 0.5;
    TEST_ASSERT_EQUAL_INT(KC_OK, solve(&goal, NULL));
    q[1] = 0.5;
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_ik_solve(&s_arm, NULL, NULL, &goal, &s_opt, q, &s_work, NULL));
    TEST_ASSERT_EQUAL_DOUBLE_ARRAY(s_q, q, KC_JOINT_MAX);
}

void test_the_planar_arm_finds_its_closed_form(void)
{
    kc_pose_t goal = planar_goal(0.7, -1.1);
    given_planar_arm();
    TEST_ASSERT_EQUAL_INT(KC_OK, solve(&goal, NULL));
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, 0.7, s_q[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-5, -1.1, s_q[1]);
}

void test_a_start_at_the_goal_stays_there(void)
{
    kc_pose_t goal = planar_goal(0.7, -1.1);
    given_planar_arm();
    s_q[0] = 0.7;
    s_q[1] = -1.1;
    TEST_ASSERT_EQUAL_INT(KC_OK, solve(&goal, NULL));
    TEST_ASSERT_EQUAL_DOUBLE(0.7, s_q[0]);
    TEST_ASSERT_EQUAL_DOUBLE(-1.1, s_q[1]);
}

void test_a_goal_beyond_the_limits_ends_at_the_margin(void)
{
    kc_pose_t goal = planar_goal(0.0, 1.5);
    given_planar_arm();
    s_arm.joint[1].q_max = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, solve(&goal, NULL));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.98, s_q[1]);
    TEST_ASSERT_TRUE(fabs(s_q[0]) <= 2.48);
}

void test_a_goal_out_of_reach_gives_the_closest_found(void)
{
    kc_pose_t goal;
    given_planar_arm();
    kc_pose_identity(&goal);
    goal.p_m[0] = 2.0; /* straight ahead, too far */
    s_q[0] = 0.5;
    s_q[1] = 0.5;
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, solve(&goal, NULL));
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, 0.0, s_q[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-3, 0.0, s_q[1]);
}

void test_an_iteration_evaluates_the_model_once_also_when_its_step_is_refused(void)
{
    kc_pose_t goal;
    given_planar_arm();
    kc_pose_identity(&goal);
    goal.p_m[0] = 2.0; /* out of reach: steps that do not help end the search */
    s_q[0] = 0.5;
    s_q[1] = 0.5;
    s_opt.iter_max = 7u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, solve(&goal, NULL));
    TEST_ASSERT_EQUAL_UINT32(8u, s_evals);
}

void test_a_start_outside_the_limits_is_brought_inside(void)
{
    kc_pose_t goal = planar_goal(0.7, -1.1);
    given_planar_arm();
    s_q[0] = 30.0;
    s_q[1] = -30.0;
    s_opt.iter_max = 0u;
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, solve(&goal, NULL));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 2.48, s_q[0]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, -2.48, s_q[1]);
}

void test_margins_wider_than_the_range_leave_the_middle(void)
{
    kc_pose_t goal = planar_goal(0.7, -1.1);
    given_planar_arm();
    s_arm.joint[0].q_min = 0.1;
    s_arm.joint[0].q_max = 0.3;
    s_opt.margin = 1.0;
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, solve(&goal, NULL));
    TEST_ASSERT_TRUE(s_q[0] >= 0.1 && s_q[0] <= 0.3);
}

void test_a_goal_that_is_not_finite_is_not_reached_and_moves_nothing(void)
{
    kc_pose_t goal = planar_goal(0.7, -1.1);
    given_planar_arm();
    goal.p_m[1] = NAN;
    s_q[0] = 0.1;
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, solve(&goal, NULL));
    TEST_ASSERT_EQUAL_DOUBLE(0.1, s_q[0]);
}

void test_one_step_moves_no_joint_further_than_allowed(void)
{
    kc_pose_t goal = planar_goal(2.0, -1.0);
    given_planar_arm();
    s_opt.iter_max = 1u;
    s_opt.step_max = 0.05;
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, solve(&goal, NULL));
    TEST_ASSERT_TRUE(fabs(s_q[0]) <= 0.05 + 1e-12 && fabs(s_q[1]) <= 0.05 + 1e-12);
    TEST_ASSERT_TRUE(fabs(s_q[0]) > 0.01);
}

/* 40 joint vectors inside the middle of the limits; start 0.2 rad away in every joint. */
static void expect_all_reached(const double *coef)
{
    static kc_space_t space;
    given_space(&space, 40u, 1u);
    for (uint32_t c = 0u; c < 40u; c++) {
        kc_ctx_t ctx;
        kc_loads_t loads;
        kc_pose_t goal;
        double r[6];
        memset(&ctx, 0, sizeof ctx);
        memcpy(ctx.g_m_s2, s_arm.gravity_m_s2, sizeof ctx.g_m_s2);
        kc_path_joints(&space, KC_HUB_MAX + c, ctx.q);
        kc_model_loads(&s_arm, &s_terms, coef, &ctx, &loads);
        kc_model_eval(&s_arm, &s_terms, coef, &ctx, &loads, false, &s_work);
        goal = s_work.T;
        for (uint32_t j = 0u; j < 7u; j++) { s_q[j] = ctx.q[j] + ((j + c) % 2u == 0u ? 0.2 : -0.2); }
        TEST_ASSERT_EQUAL_INT(KC_OK, solve(&goal, coef));
        memcpy(ctx.q, s_q, sizeof ctx.q);
        kc_model_loads(&s_arm, &s_terms, coef, &ctx, &loads);
        kc_model_eval(&s_arm, &s_terms, coef, &ctx, &loads, false, &s_work);
        kc_pose_residual(&goal, &s_work.T, r);
        for (uint32_t k = 0u; k < 6u; k++) { TEST_ASSERT_DOUBLE_WITHIN(1e-6, 0.0, r[k]); }
        for (uint32_t j = 0u; j < 7u; j++) {
            TEST_ASSERT_TRUE(s_q[j] >= s_arm.joint[j].q_min + 0.0199 &&
                             s_q[j] <= s_arm.joint[j].q_max - 0.0199);
        }
    }
}

void test_the_wam_reaches_its_own_poses(void)
{
    const double zero[KC_COEF_MAX] = {0.0};
    expect_all_reached(zero);
}

void test_the_corrected_wam_reaches_its_own_poses(void)
{
    double coef[KC_COEF_MAX] = {0.0};
    coef[24] = 1.3;  /* J7.phi_rad */
    coef[5] = 0.4;   /* J2.alpha_rad */
    coef[10] = 0.01; /* J3.a_m */
    coef[11] = 0.15; /* J3.d_m */
    expect_all_reached(coef);
}

void test_the_same_question_gives_the_same_bits(void)
{
    const double zero[KC_COEF_MAX] = {0.0};
    double first[KC_JOINT_MAX];
    kc_pose_t goal;
    const double q[KC_JOINT_MAX] = {0.3, 0.4, -0.2, 1.2, -1.0, 0.3, 0.5};
    kc_arm_fk(&s_arm, q, &goal);
    TEST_ASSERT_EQUAL_INT(KC_OK, solve(&goal, zero));
    memcpy(first, s_q, sizeof first);
    memset(s_q, 0, sizeof s_q);
    memset(&s_work, 0x5a, sizeof s_work);
    TEST_ASSERT_EQUAL_INT(KC_OK, solve(&goal, zero));
    TEST_ASSERT_EQUAL_MEMORY(first, s_q, sizeof first);
}

void test_more_iterations_than_there_may_be_are_not_done(void)
{
    kc_pose_t goal;
    kc_pose_identity(&goal);
    goal.p_m[0] = 30.0;
    s_opt.iter_max = 1000000u;
    s_opt.step_max = 1e-6; /* never there, and every step an improvement */
    TEST_ASSERT_EQUAL_INT(KC_ERR_REACH, solve(&goal, NULL));
    TEST_ASSERT_EQUAL_UINT32(200u + 1u, s_evals);
}

void test_the_number_of_evaluations_is_optional(void)
{
    kc_pose_t goal;
    kc_arm_fk(&s_arm, s_q, &goal);
    TEST_ASSERT_EQUAL_INT(KC_OK, kc_ik_solve(&s_arm, &s_terms, NULL, &goal, &s_opt, s_q, &s_work, NULL));
}

/* Within both tolerances it is there: every axis of the position, every axis of the turn. */
void test_every_axis_counts_in_the_tolerances(void)
{
    kc_pose_t at, goal;
    s_opt.iter_max = 0u;
    s_opt.tol_pos_m = 0.02;
    s_opt.tol_rot_rad = 0.01;
    s_q[1] = 0.4;
    s_q[3] = 0.9;
    kc_arm_fk(&s_arm, s_q, &at);
    for (uint32_t k = 0u; k < 6u; k++) {
        for (uint32_t beyond = 0u; beyond < 2u; beyond++) {
            const double by = (beyond == 1u ? 1.01 : 0.99) * (k < 3u ? 0.02 : 0.01);
            double w[3] = {0.0}, E[9];
            goal = at;
            if (k < 3u) {
                goal.p_m[k] += by;
            } else {
                w[k - 3u] = by;
                kc_R_exp(w, E);
                kc_m3_mul(E, at.R, goal.R);
            }
            TEST_ASSERT_EQUAL_INT(beyond == 1u ? KC_ERR_REACH : KC_OK, solve(&goal, NULL));
        }
    }
}
