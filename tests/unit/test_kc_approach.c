/* kc_approach.c: where the arm draws back to before a pose is measured. How far a joint may: test_kc_reach.c. */
#include "kc_approach.h"

#include <math.h>

#include "given_parts.h"
#include "kc_move.h"
#include "unity.h"

#define BY_RAD 0.05

void setUp(void)
{
    given_parts();
    parts.tables.active.config.approach_rad = BY_RAD;
    parts.cal.candidate = 2;
}

void test_it_is_wanted_where_config_enables_it_but_not_at_local_initial_poses(void)
{
    TEST_ASSERT_TRUE(kc_approach_wanted(&parts.view));
    parts.tables.active.space.cand[2].why = KC_CAND_LOCAL;
    TEST_ASSERT_FALSE(kc_approach_wanted(&parts.view));
    parts.cal.candidate = 3;
    parts.tables.active.config.approach_rad = 0.0;
    TEST_ASSERT_FALSE(kc_approach_wanted(&parts.view));
}

/* Joints below where they measure, a bit each. */
static uint32_t drawn_back(uint64_t *rng, double by_rad)
{
    double q_meas[KC_JOINT_MAX], q[KC_JOINT_MAX];
    uint32_t below = 0u;
    kc_view_seed(&parts.view, q_meas);
    kc_approach_start(&parts.view, rng, q_meas, q);
    for (uint32_t j = 0u; j < 7u; j++) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, by_rad, fabs(q[j] - q_meas[j]));
        below |= (q[j] < q_meas[j] ? 1u : 0u) << j;
    }
    return below;
}

void test_each_joint_draws_back_to_a_side_by_chance_that_the_seed_repeats(void)
{
    uint64_t rng = 7u, same = 7u;
    uint32_t n_below = 0u, n_alike = 0u;
    for (uint32_t i = 0u, last = 0u; i < 20u; i++) {
        uint32_t below = drawn_back(&rng, BY_RAD);
        TEST_ASSERT_EQUAL_HEX32(below, drawn_back(&same, BY_RAD));
        for (uint32_t j = 0u; j < 7u; j++) { n_below += below >> j & 1u; }
        n_alike += below == last;
        last = below;
    }
    TEST_ASSERT_TRUE(n_below > 50u && n_below < 90u); /* of 140: mean 70, sigma 5.9 */
    TEST_ASSERT_TRUE(n_alike <= 2u);
}

void test_no_joint_leaves_the_servo_bound(void)
{
    uint64_t rng = 7u;
    parts.tables.active.config.servo.bound = 0.03;
    (void)drawn_back(&rng, 0.03);
}
