/* kc_states.c: every state can be left, and only as the table says. */
#include "kc_states.h"
#include "unity.h"

void setUp(void) {}

static void expect(kc_state_t from, kc_outcome_id_t outcome, kc_state_t to, bool same_step)
{
    kc_next_t next = kc_states_next(from, outcome);
    TEST_ASSERT_EQUAL_INT(to, next.state);
    TEST_ASSERT_EQUAL_INT(same_step, next.same_step);
}

void test_an_abort_leads_from_every_state_to_safe(void)
{
    for (uint32_t s = 0u; s < KC_ST_COUNT; s++) { expect((kc_state_t)s, KC_OC_ABORT, KC_ST_SAFE, false); }
}

void test_a_budget_ends_every_state_of_a_calibration_and_no_other(void)
{
    for (uint32_t s = 0u; s < KC_ST_COUNT; s++) {
        bool calibrating = kc_states_calibrating((kc_state_t)s);
        expect((kc_state_t)s, KC_OC_FINISH, calibrating ? KC_ST_PROPOSE : (kc_state_t)s, calibrating);
    }
}

void test_only_idle_review_armed_safe_and_store_are_outside_a_calibration(void)
{
    uint32_t outside = 0u;
    for (uint32_t s = 0u; s < KC_ST_COUNT; s++) { outside += kc_states_calibrating((kc_state_t)s) ? 0u : 1u; }
    TEST_ASSERT_EQUAL_UINT32(5u, outside);
    TEST_ASSERT_FALSE(kc_states_calibrating(KC_ST_IDLE));
    TEST_ASSERT_FALSE(kc_states_calibrating(KC_ST_REVIEW));
    TEST_ASSERT_FALSE(kc_states_calibrating(KC_ST_ARMED));
    TEST_ASSERT_FALSE(kc_states_calibrating(KC_ST_SAFE));
    TEST_ASSERT_FALSE(kc_states_calibrating(KC_ST_STORE));
}

void test_the_states_of_the_estimate_and_the_proposal_wait_for_no_budget(void)
{
    static const kc_state_t estimating[] = {KC_ST_UPDATE, KC_ST_REFINE, KC_ST_LEARN, KC_ST_REPORT,
                                            KC_ST_PROPOSE};
    uint32_t n = 0u;
    for (uint32_t i = 0u; i < 5u; i++) { TEST_ASSERT_TRUE(kc_states_estimating(estimating[i])); }
    for (uint32_t s = 0u; s < KC_ST_COUNT; s++) { n += kc_states_estimating((kc_state_t)s) ? 1u : 0u; }
    TEST_ASSERT_EQUAL_UINT32(5u, n);
}

void test_a_calibration_starts_from_idle_and_safe_alone(void)
{
    for (uint32_t s = 0u; s < KC_ST_COUNT; s++) {
        bool starts = s == KC_ST_IDLE || s == KC_ST_SAFE;
        expect((kc_state_t)s, KC_OC_START, starts ? KC_ST_SELECT : (kc_state_t)s, starts);
    }
}

void test_an_outcome_that_a_state_does_not_have_leaves_it(void)
{
    expect(KC_ST_IDLE, KC_OC_DONE, KC_ST_IDLE, false);
    expect(KC_ST_AIM, KC_OC_SKIP, KC_ST_AIM, false);
    expect(KC_ST_REVIEW, KC_OC_EXPIRE, KC_ST_REVIEW, false); /* not without the first step */
}

void test_a_pose_goes_from_selection_to_report(void)
{
    static const kc_state_t poses[] = {KC_ST_SELECT, KC_ST_MOVE, KC_ST_AIM, KC_ST_SETTLE, KC_ST_OBSERVE};
    static const kc_state_t after[] = {KC_ST_MEASURE, KC_ST_UPDATE, KC_ST_REFINE,
                                       KC_ST_LEARN,   KC_ST_REPORT, KC_ST_SELECT};
    for (uint32_t i = 0u; i + 1u < sizeof poses / sizeof poses[0]; i++) {
        TEST_ASSERT_EQUAL_INT(poses[i + 1u], kc_states_next(poses[i], KC_OC_DONE).state);
    }
    expect(KC_ST_OBSERVE, KC_OC_MEASURE, KC_ST_MEASURE, true);
    for (uint32_t i = 0u; i + 1u < sizeof after / sizeof after[0]; i++) {
        expect(after[i], KC_OC_DONE, after[i + 1u], false);
    }
}

void test_an_outcome_carries_its_cause(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, kc_abort_for(KC_CAUSE_CAMERA).id);
    TEST_ASSERT_EQUAL_INT(KC_CAUSE_CAMERA, kc_abort_for(KC_CAUSE_CAMERA).cause);
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, kc_outcome(KC_OC_DONE).id);
}
