/* kc_servo.c: steps toward the goal with a model that is wrong, inside limits and bound. */
#include <math.h>
#include <string.h>

#include "given_tables.h"
#include "kc_dls.h"
#include "kc_servo.h"
#include "kc_vec.h"
#include "unity.h"

static kc_arm_t s_arm, s_true;
static kc_terms_t s_terms;
static kc_eval_t s_work;
static kc_servo_opt_t s_opt;
static kc_servo_mem_t s_mem;
static double s_q[KC_JOINT_MAX], s_seed[KC_JOINT_MAX], s_cmd[KC_JOINT_MAX], s_bound[KC_JOINT_MAX];
static kc_pose_t s_seen, s_goal;
static const double s_zero[KC_COEF_MAX];

void setUp(void)
{
    static const double q[KC_JOINT_MAX] = {0.3, 0.4, -0.2, 1.2, -1.0, 0.3, 0.5};
    given_arm(&s_arm);
    s_true = s_arm;
    given_terms(&s_terms);
    kc_servo_forget(&s_mem);
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { s_bound[j] = 10.0; }
    memcpy(s_q, q, sizeof s_q);
    memcpy(s_seed, q, sizeof s_seed);
    kc_arm_fk(&s_arm, q, &s_goal);
    s_seen = s_goal;
    s_opt.gain = 0.8;
    s_opt.damping = 0.02;
    s_opt.step_max = 0.5;
    s_opt.bound = 2.0;
    s_opt.tol_pos_m = 0.005;
    s_opt.tol_rot_rad = 0.02;
    s_opt.margin = 0.02;
}

static kc_servo_result_t step(kc_servo_mem_t *mem)
{
    return kc_servo_step(&s_arm, &s_terms, s_zero, &s_seen, &s_goal, s_q, s_seed, s_bound, &s_opt, s_cmd,
                         &s_work, mem);
}

/* Observe, step, move the true arm; THERE within n steps? */
static kc_servo_result_t follow(kc_servo_mem_t *mem, uint32_t n)
{
    kc_servo_result_t r = KC_SERVO_MOVE;
    for (uint32_t k = 0u; k <= n && r == KC_SERVO_MOVE; k++) {
        kc_arm_fk(&s_true, s_q, &s_seen);
        r = step(mem);
        memcpy(s_q, s_cmd, sizeof s_q);
    }
    return r;
}

static void expect_not_moved(void) { TEST_ASSERT_EQUAL_MEMORY(s_q, s_cmd, 7u * sizeof s_q[0]); }

void test_inside_the_tolerances_it_is_there(void)
{
    s_seen.p_m[0] += 0.004;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_THERE, step(&s_mem));
    expect_not_moved();
}

void test_a_turn_alone_can_be_too_much(void)
{
    const double turn[3] = {0.0, 0.021, 0.0};
    double R[9], Rg[9];
    kc_R_exp(turn, R);
    memcpy(Rg, s_goal.R, sizeof Rg);
    for (uint32_t i = 0u; i < 3u; i++) {
        for (uint32_t j = 0u; j < 3u; j++) {
            s_seen.R[3u * i + j] = R[3u * i] * Rg[j] + R[3u * i + 1u] * Rg[3u + j] +
                                   R[3u * i + 2u] * Rg[6u + j];
        }
    }
    TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, step(&s_mem));
}

/* Every axis of the position, every axis of the turn, each with its own tolerance. */
void test_every_axis_counts_in_the_tolerances(void)
{
    s_opt.tol_pos_m = 0.02;
    s_opt.tol_rot_rad = 0.01;
    kc_arm_fk(&s_arm, s_q, &s_seen);
    for (uint32_t k = 0u; k < 6u; k++) {
        for (uint32_t beyond = 0u; beyond < 2u; beyond++) {
            const double by = (beyond == 1u ? 1.01 : 0.99) * (k < 3u ? 0.02 : 0.01);
            double w[3] = {0.0}, E[9];
            s_goal = s_seen;
            if (k < 3u) {
                s_goal.p_m[k] += by;
            } else {
                w[k - 3u] = by;
                kc_R_exp(w, E);
                kc_m3_mul(E, s_seen.R, s_goal.R);
            }
            TEST_ASSERT_EQUAL_INT(beyond == 0u, step(NULL) == KC_SERVO_THERE);
        }
    }
}

void test_a_good_model_is_there_after_few_steps(void)
{
    for (uint32_t j = 0u; j < 7u; j++) { s_q[j] += j % 2u == 0u ? 0.15 : -0.15; }
    TEST_ASSERT_EQUAL_INT(KC_SERVO_THERE, follow(NULL, 4u));
}

void test_the_papers_errors_are_overcome(void)
{
    s_true.joint[6].phi_rad += 1.3;
    s_true.joint[1].alpha_rad += 0.4;
    s_true.joint[2].a_m += 0.01;
    s_true.joint[2].d_m += 0.15;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_THERE, follow(NULL, 12u));
    setUp();
    s_true.joint[6].phi_rad += 1.3;
    s_true.joint[1].alpha_rad += 0.4;
    s_true.joint[2].a_m += 0.01;
    s_true.joint[2].d_m += 0.15;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_THERE, follow(&s_mem, 12u));
}

void test_memory_overcomes_what_the_model_alone_does_not(void)
{
    s_opt.bound = 9.0;
    s_true.joint[2].phi_rad += 1.3;
    TEST_ASSERT_NOT_EQUAL(KC_SERVO_THERE, follow(NULL, 30u));
    setUp();
    s_opt.bound = 9.0;
    s_true.joint[2].phi_rad += 1.3;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_THERE, follow(&s_mem, 30u));
}

void test_no_joint_moves_further_than_a_step(void)
{
    s_seen.p_m[0] += 0.3;
    s_seen.p_m[1] -= 0.3;
    s_opt.step_max = 0.1;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, step(&s_mem));
    for (uint32_t j = 0u; j < 7u; j++) { TEST_ASSERT_TRUE(fabs(s_cmd[j] - s_q[j]) <= 0.1 + 1e-12); }
}

void test_no_joint_leaves_its_servo_bound_or_its_limits(void)
{
    s_true.joint[6].phi_rad += 1.3;
    s_opt.bound = 0.6;
    s_arm.joint[3].q_max = 1.3;
    for (uint32_t k = 0u; k < 15u; k++) {
        kc_arm_fk(&s_true, s_q, &s_seen);
        TEST_ASSERT_NOT_EQUAL(KC_SERVO_THERE, step(&s_mem));
        memcpy(s_q, s_cmd, sizeof s_q);
        for (uint32_t j = 0u; j < 7u; j++) { TEST_ASSERT_TRUE(fabs(s_q[j] - s_seed[j]) <= 0.6 + 1e-9); }
        TEST_ASSERT_TRUE(s_q[3] <= 1.28 + 1e-9);
    }
}

/* 1.3 rad in joint 7: turned back by joint 7 alone, if its bound is long enough. */
static kc_servo_result_t follow_on_bounds(double first_six, double last)
{
    kc_servo_result_t r = KC_SERVO_MOVE;
    s_true.joint[6].phi_rad += 1.3;
    for (uint32_t j = 0u; j < 7u; j++) { s_bound[j] = j < 6u ? first_six : last; }
    for (uint32_t k = 0u; k < 12u && r == KC_SERVO_MOVE; k++) {
        kc_arm_fk(&s_true, s_q, &s_seen);
        r = step(&s_mem);
        memcpy(s_q, s_cmd, sizeof s_q);
        for (uint32_t j = 0u; j < 7u; j++) {
            TEST_ASSERT_TRUE(fabs(s_q[j] - s_seed[j]) <= s_bound[j] + 1e-9);
        }
    }
    return r;
}

void test_every_joint_has_its_own_servo_bound(void)
{
    TEST_ASSERT_EQUAL_INT(KC_SERVO_THERE, follow_on_bounds(0.2, 1.6));
    setUp();
    TEST_ASSERT_NOT_EQUAL(KC_SERVO_THERE, follow_on_bounds(0.2, 0.4));
}

void test_without_room_to_move_it_is_stuck(void)
{
    s_opt.bound = 1e-6;
    s_seen.p_m[0] += 0.2;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_STUCK, step(&s_mem));
    expect_not_moved();
}

void test_an_observation_that_is_not_finite_moves_nothing(void)
{
    s_seen.p_m[1] = NAN;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_STUCK, step(&s_mem));
    expect_not_moved();
    TEST_ASSERT_EQUAL_UINT8(0u, s_mem.has_last);
}

void test_joints_that_are_not_finite_move_nothing(void)
{
    s_seen.p_m[1] += 0.1;
    s_q[2] = NAN;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_STUCK, step(NULL));
}

void test_a_small_move_teaches_nothing(void)
{
    s_seen.p_m[0] += 0.1;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, step(&s_mem));
    s_q[0] += 0.01;
    s_seen.p_m[0] -= 0.05; /* more than the move explains */
    TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, step(&s_mem));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_mem.B[0][0]);
    TEST_ASSERT_EQUAL_UINT8(1u, s_mem.has_last);
}

void test_after_learning_the_last_move_is_explained(void)
{
    kc_pose_t first;
    double dx[6], mid[KC_JOINT_MAX];
    static kc_eval_t at_mid;
    kc_ctx_t ctx;
    kc_loads_t loads;
    s_true.joint[2].phi_rad += 1.3;
    kc_arm_fk(&s_true, s_q, &s_seen);
    first = s_seen;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, step(&s_mem));
    memcpy(s_seed, s_q, sizeof s_seed);
    memcpy(s_q, s_cmd, sizeof s_q);
    kc_arm_fk(&s_true, s_q, &s_seen);
    (void)step(&s_mem);
    /* secant condition: (J + B) s = dx, J halfway */
    kc_pose_residual(&s_seen, &first, dx);
    memset(&ctx, 0, sizeof ctx);
    for (uint32_t j = 0u; j < 7u; j++) {
        mid[j] = 0.5 * (s_q[j] + s_seed[j]);
        ctx.q[j] = mid[j];
    }
    kc_model_loads(&s_arm, &s_terms, s_zero, &ctx, &loads);
    kc_model_eval(&s_arm, &s_terms, s_zero, &ctx, &loads, false, &at_mid);
    for (uint32_t r = 0u; r < 6u; r++) {
        for (uint32_t j = 0u; j < 7u; j++) {
            dx[r] -= (at_mid.Jq[j][r] + s_mem.B[j][r]) * (s_q[j] - s_seed[j]);
        }
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, dx[r]);
    }
}

void test_a_turn_the_joints_cannot_have_made_is_forgotten(void)
{
    double flipped[9];
    s_true.joint[2].phi_rad += 1.3;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, (kc_arm_fk(&s_true, s_q, &s_seen), step(&s_mem)));
    memcpy(s_q, s_cmd, sizeof s_q);
    kc_arm_fk(&s_true, s_q, &s_seen);
    (void)step(&s_mem);
    TEST_ASSERT_NOT_EQUAL(0, s_mem.B[0][0] != 0.0);
    memcpy(flipped, s_seen.R, sizeof flipped);
    for (uint32_t i = 0u; i < 3u; i++) { /* half a turn about the tool's z */
        flipped[3u * i] = -flipped[3u * i];
        flipped[3u * i + 1u] = -flipped[3u * i + 1u];
    }
    memcpy(s_seen.R, flipped, sizeof flipped);
    s_q[0] += 0.05;
    (void)step(&s_mem);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_mem.B[0][0]);
    TEST_ASSERT_EQUAL_UINT8(1u, s_mem.has_last);
}

void test_a_later_observation_that_is_not_finite_leaves_what_was_learned(void)
{
    static kc_servo_mem_t before;
    s_seen.p_m[0] += 0.1;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, step(&s_mem));
    memcpy(s_q, s_cmd, sizeof s_q);
    s_seen.p_m[0] = NAN;
    before = s_mem;
    TEST_ASSERT_EQUAL_INT(KC_SERVO_STUCK, step(&s_mem));
    expect_not_moved();
    TEST_ASSERT_EQUAL_MEMORY(&before, &s_mem, sizeof before);
}

/* ---- one joint turning a link of 1 m, in closed form ---- */

#define LEN2 (KC_DLS_LEN_M * KC_DLS_LEN_M)

static void given_one_joint(void)
{
    memset(&s_arm.joint[0], 0, sizeof s_arm.joint[0]);
    s_arm.n_joints = 1u;
    s_arm.joint[0].a_m = 1.0;
    s_arm.joint[0].q_min = -2.0;
    s_arm.joint[0].q_max = 2.0;
    memset(s_arm.base_xyz_m, 0, sizeof s_arm.base_xyz_m);
    memset(s_arm.tool_xyz_m, 0, sizeof s_arm.tool_xyz_m);
    s_q[0] = s_seed[0] = 0.0;
    kc_arm_fk(&s_arm, s_q, &s_seen);
    s_goal = s_seen;
}

/* The tool as the joint at `angle` has it, seen this much farther along y. */
static void seen_at(double angle, double along_y)
{
    kc_arm_fk(&s_arm, &angle, &s_seen);
    s_seen.p_m[1] += along_y;
}

void test_a_step_is_the_damped_least_squares_times_the_gain(void)
{
    const double at = 0.1;
    given_one_joint();
    kc_arm_fk(&s_arm, &at, &s_goal);
    TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, step(NULL));
    /* along y by sin 0.1, turned by 0.1; both by one unit a radian */
    double dq = (sin(0.1) + LEN2 * 0.1) / (1.0 + LEN2 + 0.02 * 0.02);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.8 * dq, s_cmd[0]);
    s_opt.step_max = 0.05; /* of what is commanded */
    TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, step(NULL));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.05, s_cmd[0]);
}

/* 1 m in z that no joint can reach, and so much along y that its best part is `share` of all. */
static kc_servo_result_t with_use(double share)
{
    double y2 = share * (1.0 + LEN2) / (1.0 - share * (1.0 + LEN2));
    given_one_joint();
    s_opt.damping = 1e-6;
    s_goal.p_m[2] += 1.0;
    s_goal.p_m[1] += sqrt(y2);
    return step(NULL);
}

void test_a_step_that_removes_less_than_a_fiftieth_is_none(void)
{
    TEST_ASSERT_EQUAL_INT(KC_SERVO_STUCK, with_use(0.0195));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, s_cmd[0]);
    TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, with_use(0.0205));
}

/* The joint moves by `angle`, the tool is seen to move `times` as far along y: is something learned of it? */
static double learned(double angle, double times)
{
    given_one_joint();
    kc_servo_forget(&s_mem);
    s_goal.p_m[1] += 3.0;
    (void)step(&s_mem);
    s_q[0] = angle;
    seen_at(angle, (times - 1.0) * sin(angle));
    (void)step(&s_mem);
    return s_mem.B[0][1];
}

void test_of_moves_shorter_than_thirty_milliradians_nothing_is_learned(void)
{
    TEST_ASSERT_EQUAL_DOUBLE(0.0, learned(0.0295, 4.0));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, learned(-0.0295, 4.0));
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 3.0, learned(0.0305, 4.0));
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 3.0, learned(-0.0305, 4.0));
}

/* Of the weighted size of a move of c m a radian, sqrt(c^2 + 0.3^2), the model leaves c - 1: a half at c = 2.02. */
void test_a_model_that_explains_half_of_a_move_is_left_alone(void)
{
    /* 0.75 c^2 - 2 c + 1 - LEN2 / 4 = 0 */
    double c = (2.0 + sqrt(4.0 - 3.0 * (1.0 - 0.25 * LEN2))) / 1.5;
    TEST_ASSERT_DOUBLE_WITHIN(0.05, 2.0, c);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, learned(0.05, c - 0.02));
    TEST_ASSERT_DOUBLE_WITHIN(0.05, c - 1.0, learned(0.05, c + 0.02));
}

/* 0.2 rad of joints explain a turn of 1.1 x 0.2 + 0.05 = 0.27 rad. */
void test_a_turn_just_beyond_gains_and_noise_is_forgotten(void)
{
    const double extra[2] = {0.068, 0.072};
    for (uint32_t i = 0u; i < 2u; i++) {
        const double turn[3] = {0.0, 0.0, extra[i]};
        double R[9], seen[9];
        given_one_joint();
        kc_servo_forget(&s_mem);
        s_goal.p_m[1] += 3.0;
        (void)step(&s_mem);
        s_mem.B[0][2] = 0.25; /* learned before */
        s_q[0] = -0.2;
        seen_at(-0.2, 0.0);
        kc_R_exp(turn, R);
        memcpy(seen, s_seen.R, sizeof seen);
        for (uint32_t k = 0u; k < 9u; k++) {
            s_seen.R[k] = 0.0;
            for (uint32_t l = 0u; l < 3u; l++) { s_seen.R[k] += R[3u * l + k / 3u] * seen[3u * l + k % 3u]; }
        }
        (void)step(&s_mem);
        TEST_ASSERT_EQUAL(i == 0u, s_mem.B[0][2] != 0.0);
        TEST_ASSERT_EQUAL_UINT8(1u, s_mem.has_last);
    }
}

/* J of the joint is one along y and one turn about z; e is what the goal is off. */
void test_what_was_learned_is_added_to_every_row(void)
{
    const double at = 0.1, e[6] = {cos(0.1) - 1.0, sin(0.1), 0.0, 0.0, 0.0, 0.1};
    for (uint32_t row = 0u; row < 6u; row++) {
        double J[6] = {0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, Je = 0.0, JJ = 0.02 * 0.02;
        given_one_joint();
        kc_servo_forget(&s_mem);
        kc_arm_fk(&s_arm, &at, &s_goal);
        s_mem.B[0][row] = 0.5;
        J[row] += 0.5;
        for (uint32_t k = 0u; k < 6u; k++) {
            Je += (k < 3u ? 1.0 : LEN2) * J[k] * e[k];
            JJ += (k < 3u ? 1.0 : LEN2) * J[k] * J[k];
        }
        TEST_ASSERT_EQUAL_INT(KC_SERVO_MOVE, step(&s_mem));
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.8 * Je / JJ, s_cmd[0]);
    }
}
