/* kc_leave_out.c: the search for one bad detection, from costs alone. */
#include <string.h>

#include "given_tables.h"
#include "kc_leave_out.h"
#include "unity.h"

static kc_config_t s_config;
static kc_plan_t s_plan;
static kc_obs_t s_obs[KC_MEAS_MAX];
static kc_leave_out_t s_search;
static uint32_t s_without;

/* n measurements of different candidates, at one place. */
static void given(uint32_t n)
{
    given_config(&s_config);
    memset(&s_plan, 0, sizeof s_plan);
    memset(s_obs, 0, sizeof s_obs);
    memset(&s_search, 0, sizeof s_search);
    s_without = 0u;
    s_plan.n_meas = n;
    for (uint32_t i = 0u; i < n; i++) {
        s_plan.cand_of[i] = (uint16_t)i;
        s_obs[i].q_wxyz[0] = 1.0;
    }
}

void setUp(void) { given(4u); }

static kc_leave_out_answer_t answer_to(bool fits, double cost)
{
    return kc_leave_out_next(&s_search, &s_config, &s_plan, s_obs, fits, cost, &s_without);
}

/* Answers estimates until the search ends; without observation i (from 0) the cost is cost[i], below 0: the others do
 * not fit. */
static kc_leave_out_answer_t searched(const double *cost)
{
    kc_leave_out_answer_t answer = KC_LEAVE_OUT_AGAIN;
    uint32_t n = 0u;
    while (answer == KC_LEAVE_OUT_AGAIN) {
        bool fits = s_without > 0u && cost[s_without - 1u] >= 0.0;
        answer = answer_to(fits, s_without > 0u ? cost[s_without - 1u] : 100.0);
        TEST_ASSERT_TRUE(++n <= s_plan.n_meas + 2u);
    }
    TEST_ASSERT_EQUAL_UINT32(0u, s_search.trial + s_search.best + (s_search.decided ? 1u : 0u));
    return answer;
}

void test_an_estimate_that_explains_everything_is_used_at_once(void)
{
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_DONE, answer_to(true, 1.0));
    TEST_ASSERT_EQUAL_UINT32(0u, s_without);
}

void test_the_observation_without_which_the_others_fit_best_is_left_out(void)
{
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_DONE, searched((double[]){-1.0, 7.0, 3.0, 9.0}));
    TEST_ASSERT_EQUAL_UINT32(3u, s_without);
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_DONE, answer_to(true, 3.0)); /* and stays so with the next pose */
    TEST_ASSERT_EQUAL_UINT32(3u, s_without);
}

void test_of_equal_costs_the_first_is_left_out(void)
{
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_DONE, searched((double[]){-1.0, 7.0, 7.0, 7.0}));
    TEST_ASSERT_EQUAL_UINT32(2u, s_without);
}

void test_nothing_is_left_out_where_the_others_never_fit(void)
{
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_NONE, searched((double[]){-1.0, -1.0, -1.0, -1.0}));
    TEST_ASSERT_EQUAL_UINT32(0u, s_without);
}

void test_every_observation_is_tried_the_first_and_the_last_too(void)
{
    for (uint32_t bad = 0u; bad < 4u; bad++) {
        double cost[4] = {-1.0, -1.0, -1.0, -1.0};
        given(4u);
        cost[bad] = 2.0;
        TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_DONE, searched(cost));
        TEST_ASSERT_EQUAL_UINT32(bad + 1u, s_without);
    }
}

void test_another_observation_takes_the_place_of_the_one_left_out(void)
{
    s_without = 2u; /* the newest pose does not fit without it either */
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_AGAIN, answer_to(false, 50.0));
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_DONE, searched((double[]){4.0, -1.0, -1.0, -1.0}));
    TEST_ASSERT_EQUAL_UINT32(1u, s_without);
}

void test_measurements_of_a_pose_agree_within_the_jump_limits(void)
{
    s_plan.cand_of[3] = 1u;
    TEST_ASSERT_TRUE(kc_leave_out_repeated(&s_config, &s_plan, s_obs, 1u));
    TEST_ASSERT_TRUE(kc_leave_out_repeated(&s_config, &s_plan, s_obs, 3u));
    TEST_ASSERT_FALSE(kc_leave_out_repeated(&s_config, &s_plan, s_obs, 0u)); /* measured once */
    s_obs[3].p_m[2] = 1.001 * s_config.jump_pos_m;
    TEST_ASSERT_FALSE(kc_leave_out_repeated(&s_config, &s_plan, s_obs, 1u));
    s_obs[3].p_m[2] = 0.0;
    kc_R_to_quat((const double[9]){1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0}, s_obs[3].q_wxyz);
    TEST_ASSERT_FALSE(kc_leave_out_repeated(&s_config, &s_plan, s_obs, 1u));
}

void test_an_observation_that_was_repeated_is_never_left_out(void)
{
    s_plan.cand_of[3] = 1u;
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_DONE, searched((double[]){5.0, 1.0, 9.0, 1.0}));
    TEST_ASSERT_EQUAL_UINT32(1u, s_without);
    for (uint32_t i = 0u; i < 4u; i++) { s_plan.cand_of[i] = 7u; }
    s_without = 0u;
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_NONE, searched((double[]){1.0, 1.0, 1.0, 1.0}));
}

void test_what_was_left_out_and_is_then_repeated_comes_back(void)
{
    s_plan.cand_of[3] = 1u; /* the newest pose repeats the one left out, and the estimate without it fits */
    s_without = 2u;
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_AGAIN, answer_to(true, 1.0));
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_NONE, searched((double[]){-1.0, 1.0, -1.0, 1.0}));
    TEST_ASSERT_EQUAL_UINT32(0u, s_without);
}

/* Whichever two of four are of one candidate. */
void test_any_two_measurements_of_a_pose_repeat_each_other(void)
{
    for (uint32_t a = 0u; a < 4u; a++) {
        for (uint32_t b = 0u; b < a; b++) {
            given(4u);
            s_plan.cand_of[4] = s_plan.cand_of[a] = s_plan.cand_of[b] = 9u; /* a fifth that was not made */
            for (uint32_t i = 0u; i < 4u; i++) {
                TEST_ASSERT_EQUAL_INT(i == a || i == b, kc_leave_out_repeated(&s_config, &s_plan, s_obs, i));
            }
            s_plan.cand_of[b] = (uint16_t)b;
            TEST_ASSERT_FALSE(kc_leave_out_repeated(&s_config, &s_plan, s_obs, a));
        }
    }
}

/* The trial without the first one fits; the others are tried all the same, and a better one wins. */
void test_a_search_goes_on_after_the_first_one_that_fits(void)
{
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_DONE, searched((double[]){5.0, -1.0, -1.0, 4.0}));
    TEST_ASSERT_EQUAL_UINT32(4u, s_without);
    given(4u);
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_DONE, searched((double[]){5.0, 6.0, -1.0, 7.0}));
    TEST_ASSERT_EQUAL_UINT32(1u, s_without);
    given(4u);
    for (uint32_t i = 0u; i < 5u; i++) { /* the whole set, then each by itself */
        TEST_ASSERT_EQUAL_UINT32(i, s_without);
        TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_AGAIN, answer_to(i > 0u, 1.0));
    }
    TEST_ASSERT_EQUAL_UINT32(1u, s_without);
    TEST_ASSERT_EQUAL_INT(KC_LEAVE_OUT_DONE, answer_to(true, 1.0));
}
