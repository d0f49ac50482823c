/* kc_cost.c: what a candidate costs, by hand: the path from the park pose, hub 0, over hub 1 to candidate 5, two servo
 * steps there, and three frames. */
#include "kc_cost.h"

#include <math.h>

#include "given_parts.h"
#include "unity.h"

#define CAND 5u
#define SPEED 0.4 /* of each joint: 0.8 rad/s, half as fast */

static kc_config_t *s_config;
static kc_cand_t *s_cand;

void setUp(void)
{
    given_parts();
    s_config = &parts.tables.active.config;
    s_cand = &parts.tables.active.space.cand[CAND];
    s_config->speed_scale = 0.5;
    s_config->settle_us = 300000u;
    s_config->frames_per_meas = 3u;
    s_config->frame_s = 0.25;
    parts.servo_steps = 2u;
}

#define REST_S (3.0 * 0.3 + 5.0 * 0.25)

/* At the seed of CAND but for joint 2, which is off by so much. */
static double cost(double off_rad)
{
    double q[KC_JOINT_MAX];
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { q[j] = (double)s_cand->q_seed[j]; }
    q[1] += off_rad;
    return kc_cost_candidate(&parts.view, CAND, q);
}

static double leg_s(const float *from, const float *to)
{
    double longest = 0.0;
    for (uint32_t j = 0u; j < 7u; j++) { longest = fmax(longest, fabs((double)to[j] - (double)from[j])); }
    return longest / SPEED;
}

static double path_s(void)
{
    const kc_space_t *s = &parts.tables.active.space;
    TEST_ASSERT_EQUAL_UINT32(1u, s_cand->hub);
    return leg_s(s->hub_q[0], s->hub_q[1]) + leg_s(s->hub_q[1], s_cand->q_seed);
}

void test_a_candidate_costs_the_time_of_its_path_and_its_stay(void)
{
    TEST_ASSERT_TRUE(path_s() > 0.1);
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, path_s() + REST_S, cost(0.0));
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, path_s() + 0.2 / SPEED + REST_S, cost(0.2)); /* from the seed on */
}

void test_the_slowest_joint_sets_the_time_of_a_leg(void)
{
    const kc_space_t *s = &parts.tables.active.space;
    parts.tables.active.arm.joint[6].speed_max = 1e-3;
    double slow_s = fabs((double)s_cand->q_seed[6] - (double)s->hub_q[1][6]) / 0.5e-3;
    TEST_ASSERT_DOUBLE_WITHIN(1e-6, leg_s(s->hub_q[0], s->hub_q[1]) + slow_s + REST_S, cost(0.0));
}

void test_energy_is_counted_where_config_asks_for_it(void)
{
    s_config->rate_cost = KC_COST_ENERGY;
    s_config->power_move_w = 60.0;
    s_config->power_idle_w = 15.0;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 60.0 * path_s() + 15.0 * REST_S, cost(0.0));
    s_config->power_move_w = s_config->power_idle_w = 0.0;
    TEST_ASSERT_EQUAL_DOUBLE(1e-3, cost(0.0)); /* never nothing */
}

void test_it_counts_from_the_candidate_of_before_and_where_the_arm_is(void)
{
    parts.cal.candidate = (int32_t)CAND;
    for (uint32_t j = 0u; j < KC_JOINT_MAX; j++) { parts.telemetry.arm.q[j] = (double)s_cand->q_seed[j]; }
    parts.telemetry.arm.q[3] += 0.1;
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.1 / SPEED + REST_S, cost(0.0));
}
