/* kc_plan.c: how many poses, and which, from the SPACE table alone. */
#include <string.h>

#include "given_tables.h"
#include "kc_plan.h"
#include "unity.h"

static kc_space_t s_space;
static kc_plan_t s_plan;
static kc_config_t s_config;

/* Initial poses: n_local local ones, candidates 10, 11 ..., the last n_reserve in reserve; then 0, 1, 2. */
static void given(uint32_t n_local, uint32_t n_reserve, uint32_t n_goal)
{
    given_config(&s_config);
    given_space(&s_space, 20u, 1u);
    s_space.n_initial = n_local + 3u;
    for (uint32_t i = 0u; i < n_local; i++) {
        s_space.initial[i] = (uint16_t)(10u + i);
        s_space.cand[10u + i].why = (uint16_t)(i < n_local - n_reserve ? KC_CAND_LOCAL
                                                                       : KC_CAND_LOCAL | KC_CAND_RESERVE);
    }
    for (uint32_t i = 0u; i < 3u; i++) { s_space.initial[n_local + i] = (uint16_t)i; }
    kc_plan_start(&s_plan, &s_space, &s_config, n_goal);
}

void setUp(void) { given(0u, 0u, 5u); }

static uint32_t next(void)
{
    uint32_t cand = 999u;
    return kc_plan_next(&s_plan, &s_space, 0u, false, &cand) ? cand : 999u;
}

static void measure(uint32_t cand) { kc_plan_measured(&s_plan, &s_space, cand); }

void test_initial_poses_come_in_their_order_and_then_it_is_the_acquisitions_turn(void)
{
    for (uint32_t i = 0u; i < 3u; i++) { TEST_ASSERT_EQUAL_UINT32(i, next()); }
    TEST_ASSERT_EQUAL_UINT32(999u, next());
}

void test_an_initial_pose_that_was_skipped_is_passed_over(void)
{
    kc_plan_skipped(&s_plan, 1u);
    TEST_ASSERT_EQUAL_UINT32(0u, next());
    TEST_ASSERT_EQUAL_UINT32(2u, next());
}

void test_the_acquisition_may_choose_all_but_local_measured_and_skipped_candidates(void)
{
    given(2u, 0u, 5u);
    TEST_ASSERT_EQUAL_UINT8(1u, s_plan.usable[3]);
    TEST_ASSERT_EQUAL_UINT8(0u, s_plan.usable[10]);
    measure(3u);
    kc_plan_skipped(&s_plan, 4u);
    TEST_ASSERT_EQUAL_UINT8(0u, s_plan.usable[3]);
    TEST_ASSERT_EQUAL_UINT8(0u, s_plan.usable[4]);
}

void test_local_initial_poses_come_on_top_of_the_requested_ones(void)
{
    given(4u, 0u, 5u);
    TEST_ASSERT_EQUAL_UINT32(9u, s_plan.n_goal);
    given(4u, 2u, 5u); /* a reserve pose counts when it is taken */
    TEST_ASSERT_EQUAL_UINT32(7u, s_plan.n_goal);
    given(4u, 0u, 1u); /* who asks for fewer gets three */
    TEST_ASSERT_EQUAL_UINT32(7u, s_plan.n_goal);
    given(4u, 0u, KC_MEAS_MAX); /* but never more than are held */
    TEST_ASSERT_EQUAL_UINT32(KC_MEAS_MAX, s_plan.n_goal);
    given(0u, 0u, 1u); /* without any, one is one */
    TEST_ASSERT_EQUAL_UINT32(1u, s_plan.n_goal);
}

void test_a_reserve_pose_is_taken_only_while_tags_are_detected_at_few(void)
{
    given(4u, 2u, 5u);
    TEST_ASSERT_EQUAL_UINT32(10u, next());
    TEST_ASSERT_EQUAL_UINT32(11u, next());
    measure(10u); /* one of two: half of them is enough */
    TEST_ASSERT_EQUAL_UINT32(0u, next());
    given(4u, 2u, 5u);
    (void)next();
    (void)next(); /* no tag at either */
    TEST_ASSERT_EQUAL_UINT32(12u, next());
}

void test_the_last_reserve_poses_are_taken_while_a_coefficient_is_undetermined(void)
{
    uint32_t cand = 999u;
    given(3u, 1u, 5u);
    measure(next());
    measure(next());
    TEST_ASSERT_TRUE(kc_plan_next(&s_plan, &s_space, 0u, true, &cand));
    TEST_ASSERT_EQUAL_UINT32(12u, cand);
    given(4u, 2u, 5u); /* the first of two, too */
    measure(next());
    measure(next());
    TEST_ASSERT_TRUE(kc_plan_next(&s_plan, &s_space, 0u, true, &cand));
    TEST_ASSERT_EQUAL_UINT32(12u, cand);
}

void test_a_reserve_pose_under_way_counts(void)
{
    given(3u, 1u, 5u);
    TEST_ASSERT_EQUAL_UINT32(0u, kc_plan_choose(&s_plan, &s_space, 0u));
    TEST_ASSERT_EQUAL_UINT32(7u, s_plan.n_goal);
    (void)next();
    (void)next();
    (void)next();
    TEST_ASSERT_EQUAL_UINT32(0u, kc_plan_choose(&s_plan, &s_space, 12u));
    TEST_ASSERT_EQUAL_UINT32(6u, s_plan.n_goal); /* two showed no tag, the third is under way */
}

void test_replicates_repeat_the_first_poses_one_after_every_so_many(void)
{
    uint32_t cand = 999u;
    for (uint32_t i = 0u; i < 3u; i++) { measure(next()); }
    TEST_ASSERT_FALSE(kc_plan_next(&s_plan, &s_space, 2u, false, &cand)); /* three are no multiple of two */
    measure(7u);
    TEST_ASSERT_TRUE(kc_plan_next(&s_plan, &s_space, 2u, false, &cand));
    TEST_ASSERT_EQUAL_UINT32(0u, cand);
    TEST_ASSERT_EQUAL_UINT32(1u, kc_plan_choose(&s_plan, &s_space, cand));
    TEST_ASSERT_FALSE(kc_plan_next(&s_plan, &s_space, 2u, false, &cand)); /* once */
    measure(cand);
    measure(8u);
    TEST_ASSERT_TRUE(kc_plan_next(&s_plan, &s_space, 2u, false, &cand));
    TEST_ASSERT_EQUAL_UINT32(1u, cand); /* the second one next */
}

void test_it_is_complete_when_the_requested_poses_are_measured(void)
{
    for (uint32_t i = 0u; i < 5u; i++) {
        TEST_ASSERT_FALSE(kc_plan_complete(&s_plan, &s_space));
        measure(i);
    }
    TEST_ASSERT_TRUE(kc_plan_complete(&s_plan, &s_space));
}

void test_two_poses_may_come_beyond_those_requested(void)
{
    for (uint32_t i = 0u; i < 5u; i++) { measure(i); }
    for (uint32_t i = 5u; i < 7u; i++) {
        TEST_ASSERT_TRUE(kc_plan_more(&s_plan));
        TEST_ASSERT_FALSE(kc_plan_complete(&s_plan, &s_space));
        (void)kc_plan_choose(&s_plan, &s_space, i);
        TEST_ASSERT_EQUAL_UINT32(i + 1u, s_plan.n_goal);
        measure(i);
        TEST_ASSERT_TRUE(kc_plan_complete(&s_plan, &s_space));
    }
    TEST_ASSERT_FALSE(kc_plan_more(&s_plan));
    TEST_ASSERT_TRUE(kc_plan_complete(&s_plan, &s_space));
    kc_plan_by_table(&s_plan, &s_space, &s_config); /* from the beginning: as many as requested */
    TEST_ASSERT_EQUAL_UINT32(5u, s_plan.n_own);
    TEST_ASSERT_TRUE(kc_plan_more(&s_plan));
}

void test_no_pose_more_comes_than_can_be_held(void)
{
    s_plan.n_meas = KC_MEAS_MAX;
    TEST_ASSERT_FALSE(kc_plan_more(&s_plan));
    s_plan.n_meas = KC_MEAS_MAX - 1u;
    s_plan.n_obs = KC_MEAS_MAX;
    TEST_ASSERT_FALSE(kc_plan_more(&s_plan));
    s_plan.n_obs = KC_MEAS_MAX - 1u;
    TEST_ASSERT_TRUE(kc_plan_more(&s_plan));
}

void test_local_initial_poses_alone_are_never_enough(void)
{
    TEST_ASSERT_FALSE(kc_plan_enough(&s_plan));
    measure(0u);
    TEST_ASSERT_TRUE(kc_plan_enough(&s_plan));
    given(4u, 0u, 5u);
    for (uint32_t i = 0u; i < 4u; i++) { measure(10u + i); }
    TEST_ASSERT_FALSE(kc_plan_enough(&s_plan));
    for (uint32_t i = 0u; i < 3u; i++) {
        TEST_ASSERT_FALSE(kc_plan_enough(&s_plan));
        measure(i);
    }
    TEST_ASSERT_TRUE(kc_plan_enough(&s_plan));
}

void test_six_local_poses_without_tags_end_it_and_so_does_less_than_a_third_of_all(void)
{
    given(9u, 0u, 5u);
    for (uint32_t i = 0u; i < 6u; i++) {
        TEST_ASSERT_FALSE(kc_plan_no_tags(&s_plan, &s_space, &s_config));
        (void)next();
    }
    TEST_ASSERT_TRUE(kc_plan_no_tags(&s_plan, &s_space, &s_config));
    measure(10u);
    TEST_ASSERT_FALSE(kc_plan_no_tags(&s_plan, &s_space, &s_config)); /* there are more to come */
    for (uint32_t i = 0u; i < 3u; i++) { (void)next(); }
    TEST_ASSERT_TRUE(kc_plan_no_tags(&s_plan, &s_space, &s_config)); /* one of nine */
    measure(11u);
    measure(12u);
    TEST_ASSERT_FALSE(kc_plan_no_tags(&s_plan, &s_space, &s_config)); /* a third */
}

void test_a_pose_in_reserve_is_still_to_come(void)
{
    given(4u, 1u, 5u);
    for (uint32_t i = 0u; i < 3u; i++) { (void)next(); }
    TEST_ASSERT_FALSE(
        kc_plan_no_tags(&s_plan, &s_space, &s_config)); /* none of three, and a fourth is left */
    (void)next();
    TEST_ASSERT_TRUE(kc_plan_no_tags(&s_plan, &s_space, &s_config));
}

void test_a_local_initial_pose_is_measured_again_once_and_counts(void)
{
    given(4u, 0u, 5u);
    measure(next());
    measure(next());
    kc_plan_again(&s_plan, 0u);
    TEST_ASSERT_EQUAL_UINT32(10u, next());
    TEST_ASSERT_EQUAL_UINT32(3u, s_plan.n_tried);
    TEST_ASSERT_EQUAL_UINT32(1u, kc_plan_choose(&s_plan, &s_space, 10u));
    TEST_ASSERT_EQUAL_UINT32(10u, s_plan.n_goal); /* on top, as all local initial poses */
    measure(10u);
    kc_plan_again(&s_plan, 0u); /* it was */
    TEST_ASSERT_EQUAL_UINT32(12u, next());
}

void test_before_a_pose_is_measured_there_is_nothing_to_repeat(void)
{
    uint32_t cand = 999u;
    for (uint32_t i = 0u; i < 3u; i++) { kc_plan_skipped(&s_plan, i); }
    TEST_ASSERT_FALSE(kc_plan_next(&s_plan, &s_space, 1u, false, &cand));
}

void test_a_reserve_pose_is_not_taken_while_others_may_still_determine_the_coefficient(void)
{
    uint32_t cand = 999u;
    given(3u, 0u, 5u);
    s_space.cand[11].why |= KC_CAND_RESERVE; /* the second of three */
    measure(next());
    TEST_ASSERT_TRUE(kc_plan_next(&s_plan, &s_space, 0u, true, &cand));
    TEST_ASSERT_EQUAL_UINT32(12u, cand);
}

/* One local initial pose is enough that as many others are needed as CONFIG says. */
void test_with_any_local_initial_pose_the_least_number_of_others_counts(void)
{
    for (uint32_t n_local = 0u; n_local < 4u; n_local++) {
        given(n_local, 0u, 5u);
        for (uint32_t i = 0u; i < n_local; i++) { measure(10u + i); }
        for (uint32_t n = 0u; n < 5u; n++) {
            TEST_ASSERT_EQUAL_INT(n >= (n_local > 0u ? 3u : 1u), kc_plan_enough(&s_plan));
            measure(n);
        }
    }
}

/* What stands in the table behind its initial poses is none of them. */
void test_initial_poses_beyond_their_number_are_not_looked_at(void)
{
    static uint8_t eligible[KC_CAND_MAX];
    given(4u, 0u, 5u);
    s_space.n_initial = 2u; /* of four local ones */
    s_config.initial_design = KC_INITIAL_INFORMATION;
    kc_plan_start(&s_plan, &s_space, &s_config, 5u);
    measure(next());
    TEST_ASSERT_TRUE(kc_plan_local(&s_plan, &s_space, eligible));
    TEST_ASSERT_EQUAL_UINT8(1u, eligible[11]);
    TEST_ASSERT_EQUAL_UINT8(0u, eligible[12]);
    kc_plan_begin(&s_plan, &s_space, 12u);
    kc_plan_leave(&s_plan, &s_space, false);
    TEST_ASSERT_EQUAL_HEX32(0x3u, s_plan.begun);
    s_config.initial_design = KC_INITIAL_TABLE;
    kc_plan_start(&s_plan, &s_space, &s_config, 5u);
    TEST_ASSERT_EQUAL_UINT32(7u, s_plan.n_goal);
    TEST_ASSERT_EQUAL_UINT32(10u, next());
    TEST_ASSERT_EQUAL_UINT32(11u, next());
    TEST_ASSERT_TRUE(kc_plan_no_tags(&s_plan, &s_space, &s_config)); /* none is left */
    TEST_ASSERT_EQUAL_UINT32(999u, next());
    kc_plan_after_local(&s_plan, &s_space, true, eligible);
    for (uint32_t c = 0u; c < KC_CAND_MAX; c++) { TEST_ASSERT_EQUAL_UINT8(0u, eligible[c]); }
}

/* ---- initial design by information ---- */

static uint8_t s_eligible[KC_CAND_MAX];

static uint32_t count_eligible(void)
{
    uint32_t n = 0u;
    for (uint32_t c = 0u; c < KC_CAND_MAX; c++) { n += s_eligible[c] != 0u ? 1u : 0u; }
    return n;
}

static void given_informed(uint32_t n_local, uint32_t n_reserve)
{
    given(n_local, n_reserve, 5u);
    s_config.initial_design = KC_INITIAL_INFORMATION;
    kc_plan_start(&s_plan, &s_space, &s_config, 5u);
}

void test_local_poses_are_chosen_once_one_of_them_is_measured(void)
{
    given_informed(4u, 1u);
    TEST_ASSERT_FALSE(kc_plan_local(&s_plan, &s_space, s_eligible));
    measure(next());
    TEST_ASSERT_TRUE(kc_plan_local(&s_plan, &s_space, s_eligible));
    TEST_ASSERT_EQUAL_UINT32(2u, count_eligible()); /* but for the one begun and the reserve */
    TEST_ASSERT_EQUAL_UINT8(1u, s_eligible[11]);
    TEST_ASSERT_EQUAL_UINT8(1u, s_eligible[12]);
    kc_plan_begin(&s_plan, &s_space, 12u);
    TEST_ASSERT_EQUAL_UINT32(2u, s_plan.n_tried);
    TEST_ASSERT_TRUE(kc_plan_local(&s_plan, &s_space, s_eligible));
    TEST_ASSERT_EQUAL_UINT32(1u, count_eligible());
    TEST_ASSERT_EQUAL_UINT32(11u, next()); /* in the order of the table: what is left */
    TEST_ASSERT_FALSE(kc_plan_local(&s_plan, &s_space, s_eligible));
}

void test_no_local_pose_is_chosen_after_another_pose_or_while_one_is_to_be_repeated(void)
{
    given_informed(4u, 0u);
    measure(next());
    kc_plan_again(&s_plan, 0u);
    TEST_ASSERT_FALSE(kc_plan_local(&s_plan, &s_space, s_eligible));
    (void)next();
    TEST_ASSERT_TRUE(kc_plan_local(&s_plan, &s_space, s_eligible));
    measure(1u);
    TEST_ASSERT_FALSE(kc_plan_local(&s_plan, &s_space, s_eligible));
    given(4u, 0u, 5u); /* in the order of the table */
    measure(next());
    TEST_ASSERT_FALSE(kc_plan_local(&s_plan, &s_space, s_eligible));
}

void test_begun_again_all_initial_poses_come_in_the_order_of_the_table(void)
{
    given_informed(4u, 1u);
    measure(next());
    kc_plan_begin(&s_plan, &s_space, 12u);
    measure(12u);
    kc_plan_by_table(&s_plan, &s_space, &s_config);
    TEST_ASSERT_EQUAL_UINT32(0u, s_plan.n_meas);
    TEST_ASSERT_EQUAL_UINT32(0u, s_plan.n_obs);
    TEST_ASSERT_EQUAL_UINT32(8u, s_plan.n_goal); /* five requested, three local and a reserve */
    for (uint32_t i = 0u; i < 3u; i++) {
        TEST_ASSERT_FALSE(kc_plan_local(&s_plan, &s_space, s_eligible));
        TEST_ASSERT_EQUAL_UINT32(10u + i, next());
        measure(10u + i);
    }
}

void test_local_poses_that_may_not_be_needed_are_not_counted_before(void)
{
    given_informed(4u, 0u);
    TEST_ASSERT_EQUAL_UINT32(5u, s_plan.n_goal);
    measure(next());
    TEST_ASSERT_EQUAL_UINT32(0u, kc_plan_choose(&s_plan, &s_space, 12u));
    TEST_ASSERT_EQUAL_UINT32(7u, s_plan.n_goal);
}

void test_after_local_poses_comes_any_candidate_or_the_next_initial_pose(void)
{
    given_informed(4u, 0u);
    kc_plan_after_local(&s_plan, &s_space, false, s_eligible);
    TEST_ASSERT_EQUAL_UINT32(16u, count_eligible());
    kc_plan_after_local(&s_plan, &s_space, true, s_eligible);
    TEST_ASSERT_EQUAL_UINT32(1u, count_eligible());
    TEST_ASSERT_EQUAL_UINT8(1u, s_eligible[0]);
    kc_plan_skipped(&s_plan, 0u);
    kc_plan_begin(&s_plan, &s_space, 1u);
    kc_plan_after_local(&s_plan, &s_space, true, s_eligible);
    TEST_ASSERT_EQUAL_UINT8(1u, s_eligible[2]);
    kc_plan_skipped(&s_plan, 2u);
    kc_plan_after_local(&s_plan, &s_space, true, s_eligible);
    TEST_ASSERT_EQUAL_UINT32(0u, count_eligible());
}

void test_an_arm_that_leaves_measures_no_local_pose_any_more(void)
{
    given_informed(4u, 2u);
    measure(next());
    kc_plan_leave(&s_plan, &s_space, true);
    kc_plan_begin(&s_plan, &s_space, 0u);
    TEST_ASSERT_FALSE(kc_plan_local(&s_plan, &s_space, s_eligible));
    TEST_ASSERT_FALSE(kc_plan_no_tags(&s_plan, &s_space, &s_config));
    TEST_ASSERT_EQUAL_UINT32(1u, s_plan.n_tried); /* a candidate is no local pose */
    TEST_ASSERT_EQUAL_UINT32(1u, next());
    given_informed(4u, 2u);
    measure(next());
    kc_plan_leave(&s_plan, &s_space, false);
    TEST_ASSERT_EQUAL_UINT32(999u, next()); /* the acquisition's turn */
}

/* ---- observations on the way ---- */

void test_extra_observations_are_no_poses_but_are_held_in_order(void)
{
    given(1u, 0u, 5u);
    measure(10u);
    TEST_ASSERT_TRUE(kc_plan_only_local(&s_plan));
    kc_plan_extra(&s_plan, KC_AT_ARRIVAL);
    TEST_ASSERT_FALSE(kc_plan_only_local(&s_plan));
    kc_plan_extra(&s_plan, KC_AT_SERVO_STEP);
    measure(0u);
    measure(1u);
    TEST_ASSERT_EQUAL_UINT32(3u, s_plan.n_meas);
    TEST_ASSERT_EQUAL_UINT32(5u, s_plan.n_obs);
    const uint8_t obs_of[] = {0u, 3u, 4u}, pose_of[] = {1u, 2u, 2u, 2u, 3u};
    const uint8_t taken_at[] = {KC_AT_CANDIDATE, KC_AT_ARRIVAL, KC_AT_SERVO_STEP, KC_AT_CANDIDATE,
                                KC_AT_CANDIDATE};
    TEST_ASSERT_EQUAL_UINT8_ARRAY(obs_of, s_plan.obs_of, 3u);
    TEST_ASSERT_EQUAL_UINT8_ARRAY(pose_of, s_plan.pose_of, 5u);
    TEST_ASSERT_EQUAL_UINT8_ARRAY(taken_at, s_plan.taken_at, 5u);
}

/* Five poses requested, one local initial pose: every pose still to come keeps its place. */
void test_there_is_room_for_more_while_all_poses_to_come_can_be_held(void)
{
    given(1u, 0u, 5u);
    measure(10u);
    uint32_t n = 0u;
    while (kc_plan_has_room(&s_plan)) {
        kc_plan_extra(&s_plan, KC_AT_ARRIVAL);
        n++;
    }
    TEST_ASSERT_EQUAL_UINT32(KC_MEAS_MAX - 6u - KC_PLAN_MORE_MAX, n);
    for (uint32_t i = 0u; i < 5u + KC_PLAN_MORE_MAX; i++) {
        if (i >= 5u) { TEST_ASSERT_TRUE(kc_plan_more(&s_plan)); }
        TEST_ASSERT_FALSE(kc_plan_complete(&s_plan, &s_space));
        (void)kc_plan_choose(&s_plan, &s_space, i);
        measure(i);
        TEST_ASSERT_FALSE(kc_plan_has_room(&s_plan));
    }
    TEST_ASSERT_TRUE(kc_plan_complete(&s_plan, &s_space));
    TEST_ASSERT_EQUAL_UINT32(KC_MEAS_MAX, s_plan.n_obs);
}

/* Local initial poses that were not foreseen may have taken the room of others. */
void test_it_is_complete_when_nothing_more_can_be_held(void)
{
    given(0u, 0u, 5u);
    for (uint32_t i = 0u; i < KC_MEAS_MAX - 1u; i++) { kc_plan_extra(&s_plan, KC_AT_ARRIVAL); }
    TEST_ASSERT_FALSE(kc_plan_complete(&s_plan, &s_space));
    measure(0u);
    TEST_ASSERT_TRUE(kc_plan_complete(&s_plan, &s_space));
}
