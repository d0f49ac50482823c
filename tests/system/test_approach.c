/* kc_approach.c: the side from which every joint comes before a pose is measured. */
#include <math.h>
#include <string.h>

#include "given_world.h"
#include "unity.h"

#define APP (&kc_app_instance)
#define BY 0.05

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

void test_an_arm_that_does_not_draw_back_ends_it(void)
{
    world_started();
    TEST_ASSERT_TRUE(world_until(KC_ST_WITHDRAW, 400u));
    world.arm_frozen = true;
    TEST_ASSERT_TRUE(world_until(KC_ST_SAFE, 700u));
    TEST_ASSERT_EQUAL_DOUBLE((double)KC_CAUSE_ARM_LATE, world.last[KC_EVT_CAL_ABORTED].got);
}
