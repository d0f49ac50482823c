/* kc_rest.c: how long everything has to stand still, and how long it may take. */
#include "kc_rest.h"

#include <string.h>

#include "given_parts.h"
#include "kc_input_fields.h"
#include "unity.h"

#define SETTLE_US 1000000u
#define MOVE_US 5000000u

static kc_rest_t s_rest;

void setUp(void)
{
    given_parts();
    parts.tables.active.config.settle_us = SETTLE_US;
    parts.tables.active.config.move_timeout_us = MOVE_US;
    s_rest = (kc_rest_t){true, 0u}; /* of the candidate before */
    parts.place.since_us = 7000000u;
    kc_rest_begin(&s_rest);
}

/* So long after the state began, with what moves. */
static kc_outcome_t at(uint64_t us, uint8_t arm_moves, uint8_t pantilt_moves)
{
    parts.clock.now_us = parts.place.since_us + us;
    parts.telemetry.arm.moving = arm_moves;
    parts.telemetry.pantilt.moving = pantilt_moves;
    return kc_rest_run(&s_rest, &parts.view, &parts.out);
}

void test_it_is_done_when_all_has_stood_still_for_the_time_of_config(void)
{
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(0u, 0, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(SETTLE_US - 1u, 0, 0).id);
    TEST_ASSERT_EQUAL_INT(KC_OC_DONE, at(SETTLE_US, 0, 0).id);
}

void test_whatever_moves_begins_the_time_again(void)
{
    for (uint8_t arm = 0u; arm < 2u; arm++) {
        kc_rest_begin(&s_rest);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(0u, 0, 0).id);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(900000u, arm, !arm).id);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(1500000u, 0, 0).id);
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(2499999u, 0, 0).id);
        TEST_ASSERT_EQUAL_INT(KC_OC_DONE, at(2500000u, 0, 0).id);
    }
}

void test_what_moves_too_long_is_named(void)
{
    static const int32_t input[] = {KC_INPUT_ARM, KC_INPUT_PANTILT};
    static const kc_cause_t cause[] = {KC_CAUSE_ARM_LATE, KC_CAUSE_PANTILT_LATE};
    for (uint8_t k = 0u; k < 2u; k++) {
        TEST_ASSERT_EQUAL_INT(KC_OC_STAY, at(SETTLE_US + MOVE_US, !k, k).id);
        TEST_ASSERT_EQUAL_UINT32(0u, parts.out.events.n);
        kc_outcome_t end = at(SETTLE_US + MOVE_US + 1u, !k, k);
        TEST_ASSERT_EQUAL_INT(KC_OC_ABORT, end.id);
        TEST_ASSERT_EQUAL_INT(cause[k], end.cause);
        expect_event(KC_EVT_CAL_MOVE_TIMEOUT, (int32_t)input[k], SETTLE_US + MOVE_US + 1.0, 0.0);
    }
}
