/* kc_approach.c: the side from which every joint comes before a pose is measured. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)
#define BY 0.05

void setUp(void);
void setUp(void)
{
    given_world();
    world.config.approach_rad = BY;
}

static uint32_t s_n_backs;
static double s_back[KC_MEAS_MAX][KC_JOINT_MAX], s_goal[KC_MEAS_MAX][KC_JOINT_MAX];

/* A calibration; what was commanded last before each measurement, and the command before that. */
static void record_every_step(void)
{
    double before[KC_JOINT_MAX] = {0.0}, newest[KC_JOINT_MAX] = {0.0};
    s_n_backs = 0u;
    world_started();
    for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) {
        if (world.out.has_arm_cmd) {
            memcpy(before, newest, sizeof before);
            memcpy(newest, world.arm_cmd.q, sizeof newest);
        }
        if (world.out.has_meas) {
            memcpy(s_back[s_n_backs], before, sizeof before);
            memcpy(s_goal[s_n_backs++], newest, sizeof newest);
        }
        world_tick();
    }
}

void test_every_joint_comes_from_the_side_that_was_commanded(void)
{
    record_every_step();
    TEST_ASSERT_EQUAL_UINT32(6u, s_n_backs);
    for (uint32_t k = 0u; k < s_n_backs; k++) {
        for (uint32_t j = 0u; j < 7u; j++) {
            double by = s_goal[k][j] - s_back[k][j];
            TEST_ASSERT_DOUBLE_WITHIN(1e-12, BY, fabs(by));
            TEST_ASSERT_EQUAL_DOUBLE(by > 0.0 ? 1.0 : -1.0, world.meas[k].arm.dir[j]);
            TEST_ASSERT_EQUAL_DOUBLE(by > 0.0 ? 1.0 : -1.0, world.meas[k].obs.ctx.dir[j]);
            TEST_ASSERT_DOUBLE_WITHIN(world.config.arrive_tol, s_goal[k][j], world.meas[k].arm.q[j]);
        }
    }
}

static uint32_t sides_of(uint32_t pose)
{
    uint32_t mask = 0u;
    for (uint32_t j = 0u; j < 7u; j++) { mask |= (world.meas[pose].arm.dir[j] > 0.0 ? 1u : 0u) << j; }
    return mask;
}

void test_sides_are_sampled_for_every_pose_and_repeat_with_the_seed(void)
{
    uint32_t first[6], up = 0u, same = 0u;
    world.config.replicate_every = 2u; /* replicates too */
    record_every_step();
    for (uint32_t k = 0u; k < 6u; k++) {
        first[k] = sides_of(k);
        for (uint32_t j = 0u; j < 7u; j++) { up += first[k] >> j & 1u; }
        for (uint32_t i = 0u; i < k; i++) { same += first[i] == first[k]; }
    }
    TEST_ASSERT_TRUE(up >= 10u && up <= 32u); /* of 42: mean 21, sigma 3.2 */
    TEST_ASSERT_TRUE(same <= 2u);
    TEST_ASSERT_EQUAL_INT(1, world.meas[4].replicate);
    setUp();
    world.config.replicate_every = 2u;
    record_every_step();
    for (uint32_t k = 0u; k < 6u; k++) { TEST_ASSERT_EQUAL_UINT32(first[k], sides_of(k)); }
}

void test_it_never_leaves_limits_or_the_box_around_the_seed(void)
{
    double lo[KC_JOINT_MAX], hi[KC_JOINT_MAX];
    world.config.servo.bound = 0.03; /* less than it would draw back */
    world.truth.joint[6].phi_rad = 0.2;
    world_started();
    for (uint32_t i = 0u; i < 4000u && world_calibrating(); i++) {
        if (world.out.has_arm_cmd && kc_app_state(APP) == KC_ST_SERVO) {
            kc_move_box(kc_app_active(APP), (uint32_t)APP->cal.candidate, lo, hi);
            for (uint32_t j = 0u; j < 7u; j++) {
                TEST_ASSERT_TRUE(world.arm_cmd.q[j] >= lo[j] - 1e-12 && world.arm_cmd.q[j] <= hi[j] + 1e-12);
            }
        }
        world_tick();
    }
    TEST_ASSERT_EQUAL_UINT32(6u, world.n_meas);
}

void test_a_joint_without_room_on_one_side_comes_from_the_other(void)
{
    world.config.servo.bound = 0.06;
    world.truth.joint[6].phi_rad = 0.2; /* the servo goes to the end of the bound */
    record_every_step();
    uint32_t at_end = 0u;
    for (uint32_t k = 0u; k < s_n_backs; k++) {
        double seed[KC_JOINT_MAX];
        kc_path_joints(&kc_app_active(APP)->space, KC_HUB_MAX + (uint32_t)world.meas[k].candidate, seed);
        double off = s_goal[k][6] - seed[6];
        if (fabs(off) < 0.06 - BY) { continue; }
        at_end++;
        TEST_ASSERT_TRUE(off * (s_goal[k][6] - s_back[k][6]) > 0.0); /* came from the seed's side */
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, BY, fabs(s_goal[k][6] - s_back[k][6]));
    }
    TEST_ASSERT_TRUE(at_end >= 1u);
}

void test_without_it_nothing_is_added(void)
{
    world.config.approach_rad = 0.0;
    record_every_step();
    uint32_t to_measure = (uint32_t)APP->move.seq;
    setUp();
    record_every_step();
    TEST_ASSERT_EQUAL_UINT32(to_measure + 12u, (uint32_t)APP->move.seq); /* two more a pose */
}

void test_an_arm_that_does_not_draw_back_ends_it(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_WITHDRAW, 400u));
    world.arm_frozen = true;
    TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 700u));
    TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_ARM_LATE, world.last[KC_EVT_CAL_ABORTED].got);
}
